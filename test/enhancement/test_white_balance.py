# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The camera's white stays white, and the water's colour is still undone where it is none."""


import numpy as np
import pytest
from scenes import in_water, restored_water

from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.enhancement.white_balance import level_veil, restoration_water
from uw_visibility.optics.light_model import attenuate, irradiance_of, radiance_of, transmission

ATTENUATION = np.array([0.35, 0.2, 0.16])
LIGHT = np.array([0.55, 0.8, 0.9])
SHAPE = (120, 160)
ALL = np.ones(SHAPE, np.bool_)
BOARD = np.s_[30:80, 40:120]


def picture(balance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A white board 0.6 m off before a coloured ground, as a camera with gains sees it."""
    random = np.random.default_rng(3)
    radiance = (0.1 + 0.5 * random.random((*SHAPE, 3)) * [0.9, 0.8, 0.6]).astype(np.float32)
    distance = np.linspace(2.5, 0.8, SHAPE[0], dtype=np.float32)[:, None].repeat(SHAPE[1], 1)
    radiance[BOARD], distance[BOARD] = 0.9, 0.6
    return in_water(radiance, distance, ATTENUATION, LIGHT * balance), distance


def board_of(image: np.ndarray, distance: np.ndarray, water: object) -> np.ndarray:
    enhanced, _ = Restorer(EnhancementConfig(max_gain=1000.0)).restore(image, distance, water)
    return np.median(enhanced[BOARD].reshape(-1, 3), axis=0)


def test_a_board_that_the_camera_has_balanced_stays_white() -> None:
    near = attenuate(np.full((1, 1, 3), 0.9, np.float32), np.full((1, 1), 0.6, np.float32),
                     ATTENUATION, LIGHT)[0, 0]
    image, distance = picture(0.85 * near.mean() / near)
    # An estimate whose light is off in its colour, as without a view of open water.
    wrong = restored_water(attenuation=ATTENUATION, ambient_light=LIGHT * [1.0, 1.1, 1.25])
    before = board_of(image, distance, wrong)
    assert before.max() - before.min() > 15
    water = restoration_water(image, distance, ALL, wrong, "linear")
    after = board_of(image, distance, water)
    assert after.max() - after.min() <= 3
    assert after.mean() == pytest.approx(before.mean(), abs=8)
    assert water.balanced == 1.0


def test_a_picture_that_the_water_has_coloured_is_restored_as_before() -> None:
    image, distance = picture(np.ones(3))
    true = restored_water(attenuation=ATTENUATION, ambient_light=LIGHT)
    water = restoration_water(image, distance, ALL, true, "linear")
    np.testing.assert_array_equal(water.scene_light, LIGHT)
    assert water.balanced == 0.0


def test_a_hundred_pixels_with_a_range_balance_nothing() -> None:
    near = attenuate(np.full((1, 1, 3), 0.9, np.float32), np.full((1, 1), 0.6, np.float32),
                     ATTENUATION, LIGHT)[0, 0]
    image, distance = picture(0.85 * near.mean() / near)
    wrong = restored_water(attenuation=ATTENUATION, ambient_light=LIGHT * [1.0, 1.1, 1.25])
    few = np.zeros(SHAPE, np.bool_)
    few[BOARD][:5, :20] = True
    water = restoration_water(image, distance, few, wrong, "linear")
    np.testing.assert_array_equal(water.scene_light, wrong.ambient_light)
    assert water.balanced == 0.0


def test_nothing_is_overexposed_where_the_light_is_estimated_too_low() -> None:
    image, distance = picture(np.ones(3))
    low = restored_water(
        attenuation=ATTENUATION, ambient_light=0.4 * LIGHT, scene_light=0.4 * LIGHT
    )
    restorer = Restorer(EnhancementConfig(max_gain=1000.0))
    plain, _ = restorer.restore(image, distance, low, np.zeros(3))
    assert np.mean((plain == 255).all(axis=2)) > 0.1
    water = restoration_water(image, distance, ALL, low, "linear")
    enhanced, _ = restorer.restore(image, distance, water, np.zeros(3))
    assert np.mean((enhanced == 255).all(axis=2)) < 0.02
    # The colour is that of the estimate.
    np.testing.assert_allclose(water.scene_light / water.scene_light[0], LIGHT / LIGHT[0])


@pytest.mark.parametrize("missing", [0, 2])
def test_without_an_estimate_of_a_channel_nothing_is_changed(missing: int) -> None:
    image, distance = picture(np.ones(3))
    attenuation = ATTENUATION.copy()
    attenuation[missing] = np.nan
    partly = restored_water(attenuation=attenuation, ambient_light=LIGHT)
    water = restoration_water(image, distance, ALL, partly, "linear")
    np.testing.assert_array_equal(water.scene_light, LIGHT)


def test_saturated_pixels_are_no_white() -> None:
    image, distance = picture(np.ones(3))
    image[:10] = 255
    true = restored_water(attenuation=ATTENUATION, ambient_light=LIGHT)
    assert restoration_water(image, distance, ALL, true, "linear").balanced == 0.0


def test_ranges_without_end_do_not_matter() -> None:
    image, distance = picture(np.ones(3))
    true = restored_water(
        attenuation=ATTENUATION, ambient_light=LIGHT, veil_stddev=0.05 * LIGHT)
    unseen = distance.copy()
    unseen[:20] = np.inf
    found, without = (
        restoration_water(image, ranges, measured, true, "linear")
        for ranges, measured in ((unseen, ALL), (distance, np.isfinite(unseen))))
    np.testing.assert_array_equal(found.ambient_light, without.ambient_light)
    assert np.isfinite(found.ambient_light).all()


BETA = np.array((0.5, 0.3, 0.25))
VEIL = np.array((0.35, 0.48, 0.52))
STDDEV = 0.05 * VEIL
# What 8-bit codes leave in a mean.
ERROR = 1e-3


def seen(seed, change=0.0, light=VEIL, farthest=10.0):
    """Irradiance and range of 8000 pixels of objects at 40 ranges, in water with that veil."""
    rng = np.random.default_rng(seed)
    distance = np.repeat(np.linspace(2.0, farthest, 40), 200)
    radiance = 0.4 + change * (distance - 6.0) / 8.0 + np.repeat(rng.normal(0.0, 0.2, 40), 200)
    radiance = np.clip(radiance + rng.normal(0.0, 0.2, distance.size), 0.0, 1.0)
    left = transmission(BETA[:, np.newaxis], distance)
    return irradiance_of(radiance, left, VEIL[:, np.newaxis], light[:, np.newaxis]), distance


def far_error(irradiance, distance, veil, light, true_light=VEIL):
    """Mean error of what is restored beyond 8 m."""
    far = distance > 8.0
    gain = np.exp(BETA[:, np.newaxis] * distance[far])
    restored, true = (
        radiance_of(irradiance[:, far], gain, v[:, np.newaxis], w[:, np.newaxis])
        for v, w in ((veil, light), (VEIL, true_light)))
    return np.abs((restored - true).mean(axis=1)).max()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_a_veil_that_is_off_is_brought_back(seed, factor):
    irradiance, distance = seen(seed)
    level, stddev = level_veil(
        irradiance, distance, BETA, factor * VEIL, factor * VEIL, STDDEV, ERROR)
    assert (stddev < 0.7 * STDDEV).all()
    assert (np.abs(level - VEIL) < 4.0 * stddev).all()
    before = far_error(irradiance, distance, factor * VEIL, factor * VEIL)
    assert before > 0.5
    assert far_error(irradiance, distance, level, level) < 0.4 * before


def test_light_brighter_than_the_veil_is_allowed_for():
    light = 2.5 * VEIL
    irradiance, distance = seen(0, light=light)
    level, _ = level_veil(
        irradiance, distance, BETA, 1.05 * VEIL, 1.05 * light, STDDEV, ERROR)
    before = far_error(irradiance, distance, 1.05 * VEIL, 1.05 * light, light)
    assert far_error(irradiance, distance, level, 2.5 * level, light) < 0.6 * before


def test_a_veil_that_is_known_stays():
    irradiance, distance = seen(0, change=0.5)
    level, _ = level_veil(irradiance, distance, BETA, VEIL, VEIL, 1e-5 * VEIL, ERROR)
    np.testing.assert_allclose(level, VEIL, rtol=1e-3)


def test_what_is_near_tells_nothing_of_the_veil():
    # Objects that differ with range change its estimate by a part of its deviation.
    irradiance, distance = seen(0, change=0.5, farthest=3.0)
    level, _ = level_veil(irradiance, distance, BETA, VEIL, VEIL, STDDEV, ERROR)
    assert (np.abs(level - VEIL) < STDDEV).all()


@pytest.mark.parametrize("stddev", [np.nan, 0.0])
def test_without_deviation_or_ranges_it_stays(stddev):
    irradiance, distance = seen(0)
    one = np.full(distance.size, 3.0)
    for ranges in (distance, one):
        level, _ = level_veil(
            irradiance, ranges, BETA, VEIL, VEIL, np.full(3, stddev), ERROR)
        np.testing.assert_allclose(level, VEIL, rtol=1e-3)


def test_what_no_light_comes_from_tells_nothing():
    irradiance, distance = seen(0)
    distance[-200:] = 1e6
    level, _ = level_veil(irradiance, distance, BETA, VEIL, VEIL, STDDEV, ERROR)
    assert (np.abs(level - VEIL) < STDDEV).all()


def test_radiance_that_goes_with_range_all_the_same_makes_the_veil_unsure():
    irradiance, distance = seen(0)
    _, even = level_veil(irradiance, distance, BETA, VEIL, VEIL, STDDEV, ERROR)
    # A veil that is brighter at middle ranges, as where the view rises from the floor.
    irradiance[:, (distance > 5.0) & (distance < 7.0)] += 0.2
    _, uneven = level_veil(irradiance, distance, BETA, VEIL, VEIL, STDDEV, ERROR)
    assert (uneven > 2.0 * even).all()
