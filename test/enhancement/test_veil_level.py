# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Veil for which radiance is even over range."""

import numpy as np
import pytest

from uw_visibility.enhancement.veil_level import level_veil
from uw_visibility.optics.light_model import irradiance_of, radiance_of, transmission

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
    level = level_veil(
        irradiance, distance, BETA, factor * VEIL, factor * VEIL, STDDEV, ERROR)
    before = far_error(irradiance, distance, factor * VEIL, factor * VEIL)
    assert before > 0.5
    assert far_error(irradiance, distance, level, level) < 0.4 * before


def test_light_brighter_than_the_veil_is_allowed_for():
    light = 2.5 * VEIL
    irradiance, distance = seen(0, light=light)
    level = level_veil(
        irradiance, distance, BETA, 1.05 * VEIL, 1.05 * light, STDDEV, ERROR)
    before = far_error(irradiance, distance, 1.05 * VEIL, 1.05 * light, light)
    assert far_error(irradiance, distance, level, 2.5 * level, light) < 0.6 * before


def test_a_veil_that_is_known_stays():
    irradiance, distance = seen(0, change=0.5)
    level = level_veil(irradiance, distance, BETA, VEIL, VEIL, 1e-5 * VEIL, ERROR)
    np.testing.assert_allclose(level, VEIL, rtol=1e-3)


def test_what_is_near_tells_nothing_of_the_veil():
    # Objects that differ with range change its estimate by a part of its deviation.
    irradiance, distance = seen(0, change=0.5, farthest=3.0)
    level = level_veil(irradiance, distance, BETA, VEIL, VEIL, STDDEV, ERROR)
    assert (np.abs(level - VEIL) < STDDEV).all()


@pytest.mark.parametrize("stddev", [np.nan, 0.0])
def test_without_deviation_or_ranges_it_stays(stddev):
    irradiance, distance = seen(0)
    one = np.full(distance.size, 3.0)
    for ranges in (distance, one):
        level = level_veil(
            irradiance, ranges, BETA, VEIL, VEIL, np.full(3, stddev), ERROR)
        np.testing.assert_allclose(level, VEIL, rtol=1e-3)


def test_what_no_light_comes_from_tells_nothing():
    irradiance, distance = seen(0)
    distance[-200:] = 1e6
    level = level_veil(irradiance, distance, BETA, VEIL, VEIL, STDDEV, ERROR)
    assert (np.abs(level - VEIL) < STDDEV).all()
