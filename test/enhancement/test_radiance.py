# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Restoration: the light model's inverse, its limits, tables, threads."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scenes import in_water

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.errors import InputError
from uw_visibility.optics.light_model import attenuate
from uw_visibility.optics.transfer import from_linear
from uw_visibility_lab.evaluation.degrade import recover_radiance

WATER = SimpleNamespace(
    attenuation=np.array([0.43, 0.27, 0.22]), ambient_light=np.array([0.4, 0.6, 0.65])
)
SHAPE = (60, 70)

# The images below are texture from pixel to pixel, which counts as noise.
ANY_NOISE = EnhancementConfig(max_noise=10.0)


def scene(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return (
        random.random((*SHAPE, 3)).astype(np.float32),
        random.uniform(0.3, 7, SHAPE).astype(np.float32),
    )


def seen(radiance: np.ndarray, distance: np.ndarray, transfer: str, dtype: type) -> np.ndarray:
    return in_water(
        radiance, distance, WATER.attenuation, WATER.ambient_light, dtype=dtype, transfer=transfer)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_inverts_the_light_model_within_quantisation(dtype: type, transfer: str) -> None:
    radiance, distance = scene()
    image = seen(radiance, distance, transfer, dtype)
    enhanced, limited = Restorer(ANY_NOISE, transfer).restore(image, distance, WATER)
    assert enhanced.dtype == dtype
    assert not limited.any()
    top = np.iinfo(dtype).max
    gain = np.exp(WATER.attenuation * distance[..., np.newaxis]) / WATER.ambient_light
    if transfer == "linear":
        error = np.abs(enhanced / top - radiance)
        assert np.all(error <= (0.5 * gain + 0.75) / top)
    else:
        found = recover_radiance(enhanced, distance * 0, _clear(), transfer)
        assert np.abs(found - radiance).max() < 12 / top * gain.max()


@settings(max_examples=25, deadline=None)
@example([0.0, 0.0, 1.175494351e-38], [1.0, 1.0, 1.0], 55.0, "linear", 0)
@given(
    st.lists(st.floats(0, 2), min_size=3, max_size=3),
    st.lists(st.floats(0.02, 1), min_size=3, max_size=3),
    st.floats(1.5, 1000),
    st.sampled_from(["linear", "srgb"]),
    st.integers(0, 1000),
)
def test_table_free_kernel_is_within_a_quarter_grey_level_of_equation_8(
    attenuation: list[float], ambient: list[float], max_gain: float, transfer: str, seed: int
) -> None:
    random = np.random.default_rng(seed)
    image = random.integers(0, 256, (7, 40, 3)).astype(np.uint8)
    distance = random.uniform(0, 20, (7, 40)).astype(np.float32)
    water = SimpleNamespace(attenuation=np.array(attenuation), ambient_light=np.array(ambient))
    config = EnhancementConfig(max_gain=max_gain, max_noise=10.0)
    enhanced, limited = Restorer(config, transfer).restore(image, distance, water)
    exact = np.clip(recover_radiance(image, distance, water, transfer, max_gain), 0, 1)
    if transfer == "srgb":
        curve = 1.055 * exact ** (1 / 2.4) - 0.055
        exact = np.where(exact <= 0.0031308, 12.92 * exact, curve)
    assert np.abs(enhanced - 255 * exact)[~limited].max(initial=0) < 0.75


@pytest.mark.parametrize("unknown", [np.nan, np.inf, -1.0, 1e9])
def test_unknown_range_is_taken_as_far_and_marked(unknown: float) -> None:
    image = np.full((2, 3, 3), 120, np.uint8)
    distance = np.full((2, 3), 2, np.float32)
    distance[1, 2] = unknown
    config = EnhancementConfig(max_gain=10, max_noise=10.0)
    enhanced, limited = Restorer(config).restore(image, distance, WATER)
    assert limited.tolist() == [[False] * 3, [False, False, True]]
    expected = 1 + (120 / 255 / WATER.ambient_light - 1) * 10
    np.testing.assert_allclose(enhanced[1, 2], np.clip(expected, 0, 1) * 255, atol=0.51)


def test_limited_marks_where_one_channel_exceeds_the_gain() -> None:
    distance = np.linspace(0.1, 12, 200, dtype=np.float32)[np.newaxis]
    image = np.full((1, 200, 3), 100, np.uint8)
    config = EnhancementConfig(max_gain=8, max_noise=10.0)
    _, limited = Restorer(config).restore(image, distance, WATER)
    np.testing.assert_array_equal(limited[0], distance[0] > np.log(8) / 0.43)


def test_open_water_becomes_white() -> None:
    image = from_linear(np.broadcast_to(WATER.ambient_light, (4, 5, 3)), "linear", np.uint16)
    enhanced, _ = Restorer().restore(image, np.full((4, 5), 3, np.float32), WATER)
    assert enhanced.min() > 65500


def test_channel_that_is_not_assessable_is_handed_on() -> None:
    radiance, distance = scene(1)
    image = seen(radiance, distance, "linear", np.uint8)
    water = SimpleNamespace(
        attenuation=np.array([np.nan, 0.27, 0.22]), ambient_light=np.array([0.4, 0.6, 0.65])
    )
    full, _ = Restorer(ANY_NOISE).restore(image, distance, WATER)
    part, _ = Restorer(ANY_NOISE).restore(image, distance, water)
    np.testing.assert_array_equal(part[..., 0], image[..., 0])
    np.testing.assert_array_equal(part[..., 1:], full[..., 1:])


def test_nothing_assessable_returns_the_image_unmarked() -> None:
    radiance, distance = scene(2)
    image = seen(radiance, distance, "linear", np.uint8)
    distance[0, 0] = np.nan
    nothing = SimpleNamespace(attenuation=np.full(3, np.nan), ambient_light=np.full(3, np.nan))
    enhanced, limited = Restorer().restore(image, distance, nothing)
    np.testing.assert_array_equal(enhanced, image)
    assert not limited.any()


def test_grey_image_with_one_channel_of_water() -> None:
    radiance, distance = scene(3)
    image = seen(radiance, distance, "linear", np.uint8)
    one = SimpleNamespace(attenuation=np.array([0.27]), ambient_light=np.float64(0.6))
    grey, _ = Restorer(ANY_NOISE).restore(np.ascontiguousarray(image[..., 1]), distance, one)
    colour, _ = Restorer(ANY_NOISE).restore(image, distance, WATER)
    assert grey.shape == SHAPE
    np.testing.assert_array_equal(grey, colour[..., 1])


def test_misfits_are_refused() -> None:
    image = np.zeros((4, 5, 3), np.uint8)
    distance = np.ones((4, 5), np.float32)
    with pytest.raises(InputError, match="channels"):
        Restorer().restore(image[..., 0], distance, WATER)
    with pytest.raises(InputError, match="range map"):
        Restorer().restore(image, distance[:3], WATER)
    with pytest.raises(InputError, match="8 or 16 bit"):
        Restorer().restore(image.astype(np.int32), distance, WATER)


def test_same_bits_for_any_number_of_threads() -> None:
    radiance, distance = scene(4)
    image = seen(radiance, distance, "linear", np.uint8)
    one = Restorer(workers=Workers(1)).restore(image, distance, WATER)
    three = Restorer(workers=Workers(3)).restore(image, distance, WATER)
    np.testing.assert_array_equal(one[0], three[0])
    np.testing.assert_array_equal(one[1], three[1])


def _clear() -> SimpleNamespace:
    return SimpleNamespace(attenuation=np.zeros(3), ambient_light=np.ones(3))


def test_noise_limits_the_gain_and_the_result_keeps_to_it():
    """Far open water with noise: restored noise is at most what the parameter says."""
    rng = np.random.default_rng(0)
    distance = np.full((120, 160), 9, np.float32)
    distance[:, :80] = 1
    ambient = np.asarray(WATER.ambient_light)
    light = np.broadcast_to(ambient * 0.7, (120, 160, 3)) * 255
    image = np.clip(np.round(light + rng.normal(0, 1.5, light.shape)), 0, 255).astype(np.uint8)
    config = EnhancementConfig(max_gain=1e3, max_noise=0.1)
    enhanced, limited = Restorer(config).restore(image, distance, WATER)
    assert limited[:, 80:].all()
    assert not limited[:, :80].any()
    gain = 0.1 * ambient / (1.5 / 255)
    expected = np.clip(1 + (0.7 - 1) * np.minimum(gain, np.exp(9 * WATER.attenuation)), 0, 1)
    np.testing.assert_allclose(enhanced[:, 80:].mean((0, 1)) / 255, expected, atol=0.12)


def test_a_wrong_veil_does_not_colour_a_far_wall() -> None:
    """Red of 2 % too bright a veil: what is near is restored, what is far is not made cyan."""
    distance = np.full(SHAPE, 8.0, np.float32)
    distance[:, :35] = 1.0
    radiance = np.full((*SHAPE, 3), 0.7, np.float32)
    image = seen(radiance, distance, "linear", np.uint16)
    wrong = {
        "attenuation": WATER.attenuation, "ambient_light": WATER.ambient_light * [1.02, 1.0, 1.0]}
    stddev = 0.02 * WATER.ambient_light
    restorer = Restorer(ANY_NOISE)
    (exact, _), (limited, marked) = (
        restorer.restore(
            image, distance, SimpleNamespace(**wrong, veil_stddev=known), np.zeros(3))
        for known in (None, stddev))
    assert np.array_equal(limited[:, :35], exact[:, :35])
    assert marked[:, 35:].all()
    assert not marked[:, :35].any()
    far = [image[:, 35:].mean(axis=(0, 1)) / 65535.0 for image in (exact, limited)]
    assert far[0][0] == pytest.approx(0.7 - 0.02 * (np.exp(0.43 * 8.0) - 1.0), abs=0.02)
    # The veil is off by one standard deviation, which is half of white at most.
    assert far[1][1:].min() - far[1][0] < 0.55


def test_a_grey_surface_stays_grey_beyond_the_limit_of_red() -> None:
    """Red is limited first: without help from the others all that is far would turn red."""
    water = SimpleNamespace(
        attenuation=np.array([0.6, 0.2, 0.2]), ambient_light=np.array([0.4, 0.6, 0.65])
    )
    distance = np.full((4, 6), 9, np.float32)
    radiance = np.full((4, 6, 3), 0.3, np.float32)
    light = attenuate(radiance, distance, water.attenuation, water.ambient_light)
    image = np.round(light * 65535).astype(np.uint16)
    config = EnhancementConfig(max_gain=10, max_noise=10.0)
    enhanced, limited = Restorer(config).restore(image, distance, water)
    assert limited.all()
    red, green, blue = enhanced[0, 0] / 65535
    assert abs(green - 0.3) < 0.01
    assert abs(blue - 0.3) < 0.01
    assert abs(red - green) < 0.15


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_veil_and_light_apart_are_inverted_within_quantisation(dtype: type) -> None:
    radiance, distance = scene(5)
    veil, light = np.array([0.1, 0.25, 0.3]), np.array([0.5, 0.7, 0.8])
    transmission = np.exp(-WATER.attenuation * distance[..., np.newaxis])
    irradiance = light * radiance * transmission + veil * (1 - transmission)
    image = from_linear(irradiance.astype(np.float32), "linear", dtype)
    water = SimpleNamespace(
        attenuation=WATER.attenuation, ambient_light=veil, scene_light=light
    )
    enhanced, _ = Restorer(ANY_NOISE).restore(image, distance, water)
    top = np.iinfo(dtype).max
    error = np.abs(enhanced / top - radiance)
    assert np.all(error <= (0.5 / (light * transmission) + 0.75) / top)
    exact = recover_radiance(image, distance, water)
    assert np.all(np.abs(exact - radiance) <= 0.51 / (light * transmission) / top)


def test_open_water_keeps_the_colour_of_the_veil() -> None:
    veil, light = np.array([0.1, 0.25, 0.3]), np.array([0.5, 0.7, 0.8])
    water = SimpleNamespace(
        attenuation=WATER.attenuation, ambient_light=veil, scene_light=light
    )
    image = from_linear(np.broadcast_to(veil, (4, 5, 3)), "linear", np.uint16)
    enhanced, _ = Restorer().restore(image, np.full((4, 5), 30, np.float32), water)
    expected = np.broadcast_to(veil / light, (4, 5, 3))
    np.testing.assert_allclose(enhanced / 65535, expected, atol=2e-3)
