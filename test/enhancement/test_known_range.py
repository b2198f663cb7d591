# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What is known of ranges: matches with texture; neither open water nor what nothing surrounds."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scenes import restored_water

from uw_visibility.enhancement.known_range import known_range
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility_lab.posterior.pictures import gain_steps

SHAPE = (240, 320)
ATTENUATION = np.array([0.4, 0.2, 0.25])
# That of 0.3 px at a focal length of 300 px and a baseline of 0.1 m.
ERROR = 0.01


def view(texture: float = 40.0, seed: int = 0) -> np.ndarray:
    """Texture of patches of 8 px on the left, and light that rises evenly on the right."""
    rng = np.random.default_rng(seed)
    patches = rng.normal(0.0, texture, (30, 40)).repeat(8, 0).repeat(8, 1)
    patches[:, 160:] = np.linspace(-30, 30, 160)
    grey = 110.0 + patches + rng.normal(0.0, 1.0, SHAPE)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., np.newaxis].repeat(3, axis=2)


def found(
    image: np.ndarray, ranges: np.ndarray, matched: np.ndarray,
    attenuation: np.ndarray = ATTENUATION,
) -> tuple[np.ndarray, np.ndarray]:
    result = known_range(image, ranges, matched, np.ones(3), attenuation, ERROR, 40)
    assert result.range_map.shape == result.known.shape == matched.shape
    assert result.range_map.dtype == result.known.dtype == np.float32
    assert np.isfinite(result.range_map).all() and (result.range_map > 0).all()
    assert (result.known >= 0).all() and (result.known <= 1).all()
    return result


ALL = np.ones(SHAPE, bool)
FLAT = np.full(SHAPE, 4.0, np.float32)


def test_matches_with_texture_are_known_and_those_of_even_light_are_not() -> None:
    ranges = FLAT.copy()
    ranges[:, 160:] = 20.0
    smooth, known = found(view(), ranges, ALL)
    assert known[:, :100].min() > 0.9
    assert known[:, 250:].max() < 0.4
    np.testing.assert_allclose(smooth[:, :130], 4.0, rtol=0.02)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
def test_steps_of_rounding_are_no_texture(noise: float) -> None:
    rng = np.random.default_rng(0)
    # Light of open water rises by a code in some 12 px.
    light = 110.0 + np.linspace(0.0, 13.0, 160) + np.linspace(0.0, 9.0, 240)[:, np.newaxis]
    image = view(20.0)
    image[:, 160:] = np.rint(light + rng.normal(0.0, noise, light.shape))[..., np.newaxis]
    matched = ALL.copy()
    matched[:, 160:] = False
    known = known_range(
        image, FLAT, matched, np.full(3, noise), ATTENUATION, ERROR, 40).known
    assert known[:, :130].mean() > 0.9 > 0.05 > known[:, 200:].mean()


def test_a_smooth_face_is_known_by_the_matches_around_it() -> None:
    image = view()
    image[80:160, 40:120] = 90
    assert found(image, FLAT, ALL).known[90:150, 50:110].min() > 0.9


def test_what_is_near_is_known_without_texture() -> None:
    ranges = np.full(SHAPE, 0.5, np.float32)
    assert found(view(), ranges, ALL).known[:, 180:].min() > 0.6


def test_nothing_steps_at_the_border_of_a_guess() -> None:
    image = np.full((*SHAPE, 3), 110, np.uint8)
    image[::16], image[:, ::16] = 60, 160
    matched = ALL.copy()
    matched[60:180, 100:220] = False
    ranges = np.where(matched, 4.0, 12.0).astype(np.float32)
    water = restored_water(attenuation=ATTENUATION, ambient_light=np.full(3, 0.5))
    along = found(image, ranges, matched)
    steps = [
        np.quantile(gain_steps(image, Restorer().restore(image, r, water, np.ones(3), k)[0]), 0.999)
        for r, k in (along, (ranges, np.ones(SHAPE, np.float32)))]
    assert steps[0] <= 8.0 < 20.0 < steps[1]


def test_rows_of_a_gap_do_not_step_where_the_image_is_even() -> None:
    image = view()
    image[60:180, 100:140] = 60
    matched = ALL.copy()
    matched[60:180, 100:140] = False
    ranges = np.full(SHAPE, 3.0, np.float32)
    # Each row of a gap is filled by its own neighbours, beside a near object.
    ranges[60:180, 100:140] = np.where(np.arange(120) % 12 < 6, 2.9, 3.1)[:, np.newaxis]
    ranges[:, 140:] = 1.5
    smooth, known = found(image, ranges, matched, 0.2 * ATTENUATION)
    gap = smooth[64:176, 102:138]
    assert known[64:176, 102:138].min() > 0.95
    assert np.abs(np.diff(gap, axis=0)).max() < 0.03
    np.testing.assert_allclose(gap, 3.0, rtol=0.1)
    np.testing.assert_allclose(smooth[64:176, 144:150], 1.5, rtol=0.02)


def test_edges_of_the_scene_stay_sharp() -> None:
    ranges = FLAT.copy()
    ranges[:, 80:] = 2.0
    smooth, _ = found(view(), ranges, ALL)
    np.testing.assert_allclose(smooth[:, :76], 4.0, rtol=0.05)
    np.testing.assert_allclose(smooth[:, 84:120], 2.0, rtol=0.05)


def test_a_gap_is_known_as_well_as_what_surrounds_it_agrees() -> None:
    matched = ALL.copy()
    matched[100:140, 60:100] = False
    uneven = FLAT.copy()
    uneven[:, 80:] = 12.0
    even, unsure = (
        found(view(), ranges, matched, 3.0 * ATTENUATION).known[110:130, 65:75]
        for ranges in (FLAT, uneven))
    assert even.min() > 0.9 > 0.75 > unsure.max()


def test_clearer_water_is_known_farther() -> None:
    ranges = np.full(SHAPE, 10.0, np.float32)
    clear, turbid = (
        found(view(), ranges, ALL, a * ATTENUATION).known[:, :130].mean() for a in (0.3, 4.0))
    assert clear > 0.9 > 0.6 > turbid


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (7, 40), (241, 319)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_any_size_and_any_range(shape: tuple[int, int], dtype: type) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, np.iinfo(dtype).max, (*shape, 3)).astype(dtype)
    ranges = rng.choice((np.nan, np.inf, 1e-30, 1.0, 1e30), shape).astype(np.float32)
    matched = rng.random(shape) < 0.5
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found(image, ranges, matched)
        found(image, ranges, np.zeros(shape, bool))
        nothing = found(image, ranges, matched, np.full(3, np.nan))
        grey = known_range(
            image[..., 0].copy(), ranges, matched, np.ones(1), np.array([0.2]), ERROR, 40)
    assert not nothing.known.any()
    assert grey.known.shape == shape


def test_the_clearest_channel_that_is_assessable_counts() -> None:
    ranges = np.full(SHAPE, 8.0, np.float32)
    whole, part = (
        found(view(), ranges, ALL, np.array(a)).known
        for a in ((0.4, 0.2, 0.25), (np.nan, 0.2, np.nan)))
    np.testing.assert_array_equal(whole, part)
