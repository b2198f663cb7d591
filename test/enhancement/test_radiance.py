# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Restoration: the light model's inverse, its limits, tables, threads."""


import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scenes import in_water, restored_water

from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.grain import find_grain
from uw_visibility.enhancement.radiance import RestorationWater, Restorer
from uw_visibility.errors import InputError
from uw_visibility.optics.light_model import attenuate
from uw_visibility.optics.transfer import from_linear, linear_table, to_linear

WATER = restored_water(
    attenuation=np.array([0.43, 0.27, 0.22]), ambient_light=np.array([0.4, 0.6, 0.65])
)
SHAPE = (60, 70)

# The images below are texture from pixel to pixel, which counts as noise if it is measured.
ANY_GAIN = EnhancementConfig(max_gain=1000.0)
NO_NOISE = np.zeros(3)


def scene(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return (
        random.random((*SHAPE, 3)).astype(np.float32),
        random.uniform(0.3, 7, SHAPE).astype(np.float32),
    )


def seen(radiance: np.ndarray, distance: np.ndarray, transfer: str, dtype: type) -> np.ndarray:
    return in_water(
        radiance, distance, WATER.attenuation, WATER.ambient_light, dtype=dtype, transfer=transfer)


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_inverts_the_light_model_where_nothing_is_unsure(transfer: str) -> None:
    radiance, distance = scene()
    image = seen(radiance, distance, transfer, np.uint16)
    restorer = Restorer(ANY_GAIN, transfer)
    enhanced, limited = restorer.restore(image, distance, WATER, NO_NOISE)
    assert enhanced.dtype == np.uint16
    assert not limited.any()
    assert np.abs(to_linear(enhanced, transfer) - radiance).max() < 0.01


def expected(
    image: np.ndarray, distance: np.ndarray, known: np.ndarray, water: RestorationWater,
    config: EnhancementConfig, noise: np.ndarray,
) -> np.ndarray:
    """What `Restorer` says it does with linear images, in double precision."""
    grain = find_grain(image, noise, linear_table("linear", image.dtype))
    light, veil, white = image / 255.0 - grain, water.ambient_light, water.scene_light
    gain = np.exp(np.minimum(
        water.attenuation * distance[..., np.newaxis], np.log(64.0 * config.max_gain)))
    restored = np.clip(veil / white + (light - veil) / white * gain, 0.0, 1.0)
    error = np.sqrt((noise / 0.2) ** 2 + 1.0 / 12.0) / 255.0 / white
    least = np.minimum((error / 2.0 / config.max_noise) ** 2, 0.25) + (0.5 / config.max_gain) ** 2
    unsure = (water.veil_stddev / (0.5 * white)) ** 2
    part = known[..., np.newaxis] / (1.0 + least * gain**2 + unsure * (gain - 1.0) ** 2)
    mean = (part * restored).sum(-1, keepdims=True) / (part.sum(-1, keepdims=True) + 1e-6)
    best = part.max(-1, keepdims=True)
    return light + part * (restored - light) + (best - part) * (mean - light) + grain


@settings(max_examples=25, deadline=None)
@example([0.0, 0.0, 1.175494351e-38], [1.0, 1.0, 1.0], 55.0, 0.0, 0)
@given(
    st.lists(st.floats(0, 2), min_size=3, max_size=3),
    st.lists(st.floats(0.02, 1), min_size=3, max_size=3),
    st.floats(1.5, 1000),
    st.floats(0, 3),
    st.integers(0, 1000),
)
def test_kernel_is_within_a_quarter_grey_level_of_what_it_says(
    attenuation: list[float], veil: list[float], max_gain: float, noise: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    image = random.integers(0, 256, (7, 40, 3)).astype(np.uint8)
    distance = random.uniform(0, 20, (7, 40)).astype(np.float32)
    known = random.uniform(0, 1, (7, 40)).astype(np.float32)
    water = restored_water(
        attenuation=np.array(attenuation), ambient_light=np.array(veil),
        scene_light=random.uniform(0.1, 1.0, 3), veil_stddev=random.uniform(0, 0.1, 3))
    config = EnhancementConfig(max_gain=max_gain)
    enhanced, _ = Restorer(config).restore(image, distance, water, np.full(3, noise), known)
    exact = expected(image, distance, known, water, config, np.full(3, noise))
    assert np.abs(enhanced - 255 * exact).max() < 0.75


def test_an_image_of_several_bands_has_no_seam() -> None:
    random = np.random.default_rng(0)
    smooth = np.linspace(60.0, 180.0, 300)[:, np.newaxis, np.newaxis]
    image = np.rint(smooth + random.normal(0.0, 2.0, (300, 40, 3))).astype(np.uint8)
    distance = random.uniform(0, 6, (300, 40)).astype(np.float32)
    known = random.uniform(0, 1, (300, 40)).astype(np.float32)
    water = restored_water(
        attenuation=WATER.attenuation, ambient_light=WATER.ambient_light,
        scene_light=np.full(3, 0.8), veil_stddev=np.full(3, 0.05))
    noise = np.full(3, 2.0)
    enhanced, _ = Restorer().restore(image, distance, water, noise, known)
    exact = expected(image, distance, known, water, EnhancementConfig(), noise)
    assert np.abs(enhanced - 255 * exact).max() < 0.75


@pytest.mark.parametrize("unknown", [np.nan, np.inf, -1.0, 1e9])
def test_what_has_no_range_keeps_its_look_and_is_marked(unknown: float) -> None:
    image = np.full((2, 3, 3), 120, np.uint8)
    distance = np.full((2, 3), 2, np.float32)
    distance[1, 2] = unknown
    enhanced, limited = Restorer().restore(image, distance, WATER)
    assert limited.tolist() == [[False] * 3, [False, False, True]]
    np.testing.assert_array_equal(enhanced[1, 2], image[1, 2])
    assert np.abs(enhanced[0, 0].astype(int) - image[0, 0]).min() > 10


def test_a_range_beyond_all_numbers_is_as_one_beyond_the_largest_gain() -> None:
    """Its thickness overflows, which is no warning of NumPy's: those are errors in tests."""
    turbid = restored_water(
        attenuation=np.array([3.0, 2.0, 1.5]), ambient_light=np.array([0.3, 0.5, 0.5]))
    image = np.full((1, 2, 3), 120, np.uint8)
    distance = np.array([[3e38, 1e6]], np.float32)
    enhanced, limited = Restorer().restore(image, distance, turbid, NO_NOISE)
    np.testing.assert_array_equal(enhanced[0, 0], enhanced[0, 1])
    assert limited.all()


def test_restoration_fades_with_what_is_known() -> None:
    image = np.full((1, 101, 3), 120, np.uint8)
    known = np.linspace(0, 1, 101, dtype=np.float32)[np.newaxis]
    distance = np.full((1, 101), 2, np.float32)
    enhanced, limited = Restorer().restore(image, distance, WATER, NO_NOISE, known)
    whole, _ = Restorer().restore(image, distance, WATER, NO_NOISE)
    fade = 120 + known[..., np.newaxis] * (whole.astype(float) - 120)
    assert np.abs(enhanced - fade).max() <= 1.0
    assert np.abs(np.diff(enhanced.astype(int), axis=1)).max() <= 2
    assert limited[0, :49].all() and not limited[0, 60:].any()


def test_limited_marks_where_one_channel_is_restored_by_less_than_half() -> None:
    distance = np.linspace(0.1, 12, 200, dtype=np.float32)[np.newaxis]
    image = np.full((1, 200, 3), 30000, np.uint16)
    _, limited = Restorer(EnhancementConfig(max_gain=4)).restore(image, distance, WATER, NO_NOISE)
    # The part is 1 / (1 + (gain / 8)²), but for 16 bits' rounding.
    np.testing.assert_array_equal(limited[0], distance[0] > np.log(8) / 0.43)


def test_channel_that_is_not_assessable_is_handed_on() -> None:
    radiance, distance = scene(1)
    image = seen(radiance, distance, "linear", np.uint8)
    water = restored_water(
        attenuation=np.array([np.nan, 0.27, 0.22]), ambient_light=np.array([0.4, 0.6, 0.65])
    )
    full, _ = Restorer(ANY_GAIN).restore(image, distance, WATER, NO_NOISE)
    part, _ = Restorer(ANY_GAIN).restore(image, distance, water, NO_NOISE)
    np.testing.assert_array_equal(part[..., 0], image[..., 0])
    assert np.abs(part[..., 1:].astype(int) - full[..., 1:]).max() <= 2


def test_nothing_assessable_returns_the_image_unmarked() -> None:
    radiance, distance = scene(2)
    image = seen(radiance, distance, "linear", np.uint8)
    distance[0, 0] = np.nan
    nothing = restored_water(attenuation=np.full(3, np.nan), ambient_light=np.full(3, np.nan))
    enhanced, limited = Restorer().restore(image, distance, nothing)
    np.testing.assert_array_equal(enhanced, image)
    assert not limited.any()


def test_grey_image_with_one_channel_of_water() -> None:
    radiance, distance = scene(3)
    image = seen(radiance, distance, "linear", np.uint8)
    one = restored_water(attenuation=np.array([0.27]), ambient_light=np.array([0.6]))
    grey, _ = Restorer().restore(
        np.ascontiguousarray(image[..., 1]), distance, one, np.zeros(1))
    water = restored_water(
        attenuation=np.full(3, 0.27), ambient_light=np.full(3, 0.6))
    colour, _ = Restorer().restore(image[..., [1, 1, 1]].copy(), distance, water, NO_NOISE)
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


def test_noise_limits_the_gain_and_the_result_keeps_to_it() -> None:
    """Far scene whose detail is three times the noise: both are at most what the parameter says."""
    rng = np.random.default_rng(0)
    water = restored_water(attenuation=np.full(3, 0.3), ambient_light=np.full(3, 0.6))
    light = np.full((120, 160, 3), 0.97 * 0.6 * 255)
    image = np.clip(np.round(light + rng.normal(0, 4.5, light.shape)), 0, 255).astype(np.uint8)
    for distance in (1.0, 3.0, 5.0, 7.0, 9.0):
        ranges = np.full((120, 160), distance, np.float32)
        enhanced, _ = Restorer(EnhancementConfig(max_noise=0.15)).restore(
            image, ranges, water, np.full(3, 1.5))
        assert enhanced.std(axis=(0, 1)).max() / 255 < 3 * 0.036
        free, _ = Restorer(EnhancementConfig(max_noise=10.0)).restore(
            image, ranges, water, np.full(3, 1.5))
        assert distance < 7.0 or free.std() > 1.5 * enhanced.std()


def test_a_wrong_veil_does_not_colour_a_far_wall() -> None:
    """Red of 2 % too bright a veil: what is near is restored, what is far is not made cyan."""
    distance = np.full(SHAPE, 8.0, np.float32)
    distance[:, :35] = 1.0
    radiance = np.full((*SHAPE, 3), 0.7, np.float32)
    image = seen(radiance, distance, "linear", np.uint16)
    wrong = {
        "attenuation": WATER.attenuation, "ambient_light": WATER.ambient_light * [1.02, 1.0, 1.0]}
    stddev = 0.02 * WATER.ambient_light
    restorer = Restorer(ANY_GAIN)
    (exact, _), (limited, marked) = (
        restorer.restore(
            image, distance, restored_water(**wrong, veil_stddev=known), NO_NOISE)
        for known in (None, stddev))
    assert np.abs(limited[:, :35].astype(int) - exact[:, :35]).max() < 0.001 * 65535
    assert marked[:, 35:].all()
    assert not marked[:, :35].any()
    far = [image[:, 35:].mean(axis=(0, 1)) / 65535.0 for image in (exact, limited)]
    assert far[0][0] < 0.3
    assert np.ptp(far[1]) < np.ptp(far[0]) - 0.1


def test_a_grey_surface_stays_grey_beyond_the_limit_of_red() -> None:
    """Red is limited first: without help from the others all that is far would turn red."""
    water = restored_water(
        attenuation=np.array([0.6, 0.2, 0.2]), ambient_light=np.array([0.4, 0.6, 0.65])
    )
    distance = np.full((4, 6), 9, np.float32)
    radiance = np.full((4, 6, 3), 0.3, np.float32)
    light = attenuate(radiance, distance, water.attenuation, water.ambient_light)
    image = np.round(light * 65535).astype(np.uint16)
    config = EnhancementConfig(max_gain=30)
    enhanced, limited = Restorer(config).restore(image, distance, water, NO_NOISE)
    assert limited.all()
    red, green, blue = enhanced[0, 0] / 65535
    assert abs(green - 0.3) < 0.02
    assert abs(blue - 0.3) < 0.02
    assert abs(red - green) < 0.02


def test_veil_and_light_apart_are_inverted() -> None:
    radiance, distance = scene(5)
    veil, light = np.array([0.1, 0.25, 0.3]), np.array([0.5, 0.7, 0.8])
    transmission = np.exp(-WATER.attenuation * distance[..., np.newaxis])
    irradiance = light * radiance * transmission + veil * (1 - transmission)
    image = from_linear(irradiance.astype(np.float32), "linear", np.uint16)
    water = restored_water(
        attenuation=WATER.attenuation, ambient_light=veil, scene_light=light
    )
    enhanced, _ = Restorer(ANY_GAIN).restore(image, distance, water, NO_NOISE)
    assert np.abs(enhanced / 65535 - radiance).max() < 0.01


def test_open_water_keeps_its_look() -> None:
    """Brighter above than below, as it is: it turns neither white nor black, and has no steps."""
    water = restored_water(
        attenuation=WATER.attenuation, ambient_light=np.array([0.1, 0.25, 0.3]),
        scene_light=np.array([0.2, 0.2, 0.2]), veil_stddev=np.array([0.01, 0.02, 0.03]))
    light = water.ambient_light * np.linspace(2.0, 0.3, 80)[:, np.newaxis, np.newaxis]
    image = from_linear(np.broadcast_to(light, (80, 60, 3)), "linear", np.uint8)
    distance = np.random.default_rng(0).uniform(20.0, 60.0, (80, 60)).astype(np.float32)
    enhanced, limited = Restorer().restore(image, distance, water)
    assert limited.all()
    assert np.abs(enhanced.astype(int) - image).max() <= 3
