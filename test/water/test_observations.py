# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Envelopes against quantiles taken one by one."""

import numpy as np
import pytest

from uw_visibility.images.view import View
from uw_visibility.water import observations
from uw_visibility.water.observations import PIXELS_READ_WHOLE, accumulate, levels
from uw_visibility.water.observations import observe as observe_samples

SETTINGS = {
    "transfer": "linear", "bins": 10, "min_pixels": 20, "edge_tolerance": 10.0,
    "dark_quantile": 0.1, "fewest_dark": 0.5, "bright_quantile": 0.9,
    "plain": True,
}


def observe(image, distance, mask, *, transfer, **settings):
    return observe_samples(View.of(image, transfer).colour, distance, mask, **settings)


def view(dtype=np.uint8, size=(100, 120), seed=0):
    rng = np.random.default_rng(seed)
    top = np.iinfo(dtype).max
    image = rng.integers(1, top, (*size, 3)).astype(dtype)
    distance = np.tile(np.linspace(2, 4, size[1], dtype=np.float32), (size[0], 1))
    return image, distance


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.uint8, 1 / 255), (np.uint16, 32 / 65535)])
def test_envelopes_are_the_quantiles_of_each_bin(dtype, tolerance):
    image, distance = view(dtype)
    seen = observe(image, distance, None, **SETTINGS)
    assert len(seen.range) == 10
    edges = np.linspace(2, 4, 11)
    top = np.iinfo(dtype).max
    for at in range(1, 9):
        # Away from the outermost bins, which the quantiles of range trim.
        inside = np.abs(distance - seen.range[at]) < 0.07
        for channel in range(3):
            values = image[..., channel][inside] / top
            assert seen.dark[channel, at] == pytest.approx(np.quantile(values, 0.1), abs=0.03)
            assert seen.bright[channel, at] == pytest.approx(np.quantile(values, 0.9), abs=0.03)
        assert edges[at] < seen.range[at] < edges[at + 1]
    assert seen.step == pytest.approx(1 / top)
    one = observe(image, np.full_like(distance, 3), None, **SETTINGS)
    for channel in range(3):
        values = image[..., channel] / top
        assert one.dark[channel, 0] == pytest.approx(np.quantile(values, 0.1), abs=tolerance)
        assert one.bright[channel, 0] == pytest.approx(np.quantile(values, 0.9), abs=tolerance)


def test_srgb_levels_are_irradiance():
    image, distance = view()
    linear = observe(image, distance, None, **SETTINGS)
    srgb = observe(image, distance, None, **{**SETTINGS, "transfer": "srgb"})
    expected = ((linear.dark + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(srgb.dark, expected, atol=0.002)
    assert levels("srgb", np.uint8).step[200] > 4 * levels("srgb", np.uint8).step[20]


def test_a_sharp_dark_end_is_its_level_and_a_smooth_one_is_interpolated():
    distance = np.full((100, 100), 3, dtype=np.float32)
    image = np.full((100, 100, 3), 40, dtype=np.uint8)
    image[..., 0] = 41
    seen = observe(image, distance, None, **SETTINGS)
    np.testing.assert_allclose(seen.dark[:, 0] * 255, [41, 40, 40], atol=1e-9)
    image[..., 1] = np.tile(np.repeat([37, 38, 39, 40], 25), (100, 1))
    smooth = observe(image, distance, None, **{**SETTINGS, "dark_quantile": 0.3})
    assert smooth.dark[1, 0] * 255 == pytest.approx(37.5 + 5 / 25)


def test_saturated_and_padded_pixels_do_not_count():
    image, distance = view()
    distance = np.full_like(distance, 3)
    clean = observe(image, distance, None, **SETTINGS)
    marred = np.concatenate((image, np.zeros_like(image), np.full_like(image, 255)))
    seen = observe(marred, np.concatenate((distance,) * 3), None, **SETTINGS)
    np.testing.assert_allclose(seen.dark, clean.dark, atol=1e-9)
    np.testing.assert_allclose(seen.bright, clean.bright, atol=1e-9)
    assert seen.saturated == pytest.approx([0.5] * 3)
    assert clean.saturated == pytest.approx([0] * 3)


def test_pixels_without_a_range_or_outside_the_mask_do_not_count():
    image, distance = view()
    marred = distance.copy()
    marred[:30] = np.nan
    marred[30:40] = -1
    mask = np.ones(distance.shape, dtype=bool)
    mask[40:60] = False
    image[:60] = 255
    seen = observe(image, marred, mask, **SETTINGS)
    clean = observe(image[60:].copy(), distance[60:].copy(), None, **SETTINGS)
    np.testing.assert_allclose(seen.dark, clean.dark)
    assert seen.pixels == clean.pixels


def edge_view():
    distance = np.full((60, 60), 2, dtype=np.float32)
    distance[:, 30:] = 4
    image = np.full((60, 60, 3), 100, dtype=np.uint8)
    # Coarse stripes, so that the border of what is painted over them is no noise.
    image[:, np.arange(60) // 10 % 2 == 1] += 1
    image[..., 0] += 1
    return image, distance


ROBUST = {**SETTINGS, "plain": False, "edge_tolerance": 0.1}


@pytest.mark.parametrize(("range_error", "margin"), [(0.0, 2), (0.01, 6)])
def test_pixels_beside_a_jump_of_range_do_not_count(range_error, margin):
    image, distance = edge_view()
    image[:, 30 - margin:30 + margin] = 7
    seen = observe(image, distance, None, **ROBUST, range_error=range_error)
    assert seen.dark[1] == pytest.approx(100 / 255)
    assert seen.pixels == (60 - 2 * margin) * (60 - 4 * margin)


def test_pixels_beside_unknown_ranges_do_not_count():
    image, distance = edge_view()
    distance[:, 30:34] = np.nan
    image[:, 24:40] = 7
    seen = observe(image, distance, None, **ROBUST, range_error=0.01)
    assert seen.dark[1] == pytest.approx(100 / 255)


def test_a_plane_seen_at_an_angle_has_no_edge():
    image, _ = view(size=(100, 120))
    distance = np.tile(1 / np.linspace(0.5, 0.2, 120, dtype=np.float32), (100, 1))
    seen = observe(image, distance, None, **{**ROBUST, "edge_tolerance": 0.01})
    assert seen.pixels > 0.9 * 96 * 116
    grazing = np.tile(1 / np.linspace(0.5, 0.01, 120, dtype=np.float32), (100, 1))
    far = observe(image, grazing, None, **{**ROBUST, "edge_tolerance": 0.01}, range_error=1e-3)
    assert far.range[-1] < 5


def test_bins_are_of_equal_ratio_and_know_where_their_darkest_pixels_are():
    image, _ = view(size=(200, 400))
    distance = np.tile(np.geomspace(1, 16, 400, dtype=np.float32), (200, 1))
    image[:] = 100
    image[..., 0] = 101
    # Light grows with range: the darkest pixels of a bin are its nearest.
    image[..., 1] = (50 * distance**0.5).astype(np.uint8)
    seen = observe(image, distance, None, **ROBUST)
    ratio = seen.range[1:] / seen.range[:-1]
    np.testing.assert_allclose(ratio, 16 ** 0.1, rtol=0.03)
    assert (seen.dark_range[1] < seen.range * 0.95).all()
    np.testing.assert_allclose(seen.dark[1] * 255, 50 * seen.dark_range[1] ** 0.5, atol=3)
    np.testing.assert_allclose(seen.dark_range[0], seen.range, rtol=0.01)


def test_noise_is_taken_out_of_both_envelopes():
    rng = np.random.default_rng(0)
    image = np.clip(100 + rng.normal(0, 2, (300, 300, 3)) + 0.5, 0, 255).astype(np.uint8)
    distance = np.full((300, 300), 3, dtype=np.float32)
    distance[150:] = 4
    settings = {**ROBUST, "dark_quantile": 2e-4, "fewest_dark": 5, "bright_quantile": 0.99}
    seen = observe(image, distance, None, **settings)
    assert seen.noise == pytest.approx([2, 2, 2], abs=0.3)
    np.testing.assert_allclose(seen.dark * 255, 100, atol=1)
    np.testing.assert_allclose(seen.bright * 255, 100, atol=1)
    plain = observe(image, distance, None, **{**settings, "plain": True})
    assert (plain.dark * 255 < 96).all()


def test_bins_with_too_few_pixels_are_left_out():
    image, distance = view()
    distance[:, 30:60] = np.nan
    seen = observe(image, distance, None, **SETTINGS)
    assert not ((seen.range > 2.6) & (seen.range < 2.9)).any()
    assert (seen.count >= 20).all()
    none = observe(image, distance, None, **{**SETTINGS, "min_pixels": 10**6})
    assert len(none.range) == 0


@pytest.mark.parametrize("value", [np.nan, 0.0, -3.0, np.inf])
def test_a_map_without_any_range_gives_no_bin(value):
    image, distance = view()
    seen = observe(image, np.full_like(distance, value), None, **SETTINGS)
    assert seen.pixels == 0
    assert len(seen.range) == 0
    assert not seen.grey


def test_colour_is_noticed():
    image, distance = view()
    assert not observe(image, distance, None, **SETTINGS).grey
    grey = np.repeat(image[..., :1], 3, axis=2)
    assert observe(grey, distance, None, **SETTINGS).grey


def test_large_images_are_read_in_part():
    image, distance = view(size=(1000, 600))
    seen = observe(image, distance, None, **SETTINGS)
    assert PIXELS_READ_WHOLE < seen.pixels < 4 * PIXELS_READ_WHOLE
    stride = round(image[..., 0].size / seen.pixels)
    part = observe(
        image[(stride - 1) // 2::stride].copy(), distance[::stride].copy(), None, **SETTINGS)
    np.testing.assert_allclose(seen.dark, part.dark, atol=0.01)


def test_noisy_images_compile_nothing_more(monkeypatch):
    """A kernel is compiled apart for arrays that can be written to, in flight."""
    seen = []

    def record(image, *arguments):
        seen.append(image.flags.writeable)
        return accumulate(image, *arguments)

    monkeypatch.setattr(observations, "accumulate", record)
    distance = view()[1]
    noise = np.random.default_rng(3).normal(0.0, 12.0, (*distance.shape, 3))
    for shown in (np.full(noise.shape, 100, np.uint8), (100 + noise).astype(np.uint8)):
        shown.flags.writeable = False
        observe(shown, distance, None, **ROBUST)
    assert seen == [False, False]
