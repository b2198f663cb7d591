# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filled ranges are no farther than the brightness of their pixels allows."""

from types import SimpleNamespace

import numpy as np

from uw_visibility.enhancement.hole_range import bound_by_veil
from uw_visibility.optics.light_model import attenuate
from uw_visibility.optics.transfer import from_linear

WATER = SimpleNamespace(
    attenuation=np.array([0.5, 0.3, 0.25]), ambient_light=np.array([0.6, 0.7, 0.75])
)
SHAPE = (60, 80)


def dark_thing(distance: float) -> np.ndarray:
    radiance = np.full((*SHAPE, 3), 0.02, np.float32)
    light = attenuate(
        radiance, np.full(SHAPE, distance, np.float32), WATER.attenuation, WATER.ambient_light
    )
    return from_linear(light, "linear", np.uint8)


def test_a_dark_thing_is_not_taken_for_the_far_ground_behind_it() -> None:
    filled = np.full(SHAPE, 6.0, np.float32)
    matched = np.zeros(SHAPE, np.bool_)
    bounded = bound_by_veil(filled, matched, dark_thing(1.0), WATER, "linear")
    np.testing.assert_allclose(bounded, 1.0, atol=0.1)


def test_matched_pixels_and_ranges_that_the_veil_allows_stay() -> None:
    filled = np.full(SHAPE, 6.0, np.float32)
    image = dark_thing(1.0)
    assert bound_by_veil(filled, np.ones(SHAPE, np.bool_), image, WATER, "linear") is filled
    near = np.full(SHAPE, 0.5, np.float32)
    none = np.zeros(SHAPE, np.bool_)
    np.testing.assert_array_equal(bound_by_veil(near, none, image, WATER, "linear"), near)


def test_without_an_estimate_nothing_is_bounded() -> None:
    filled = np.full(SHAPE, 6.0, np.float32)
    unknown = SimpleNamespace(attenuation=np.full(3, np.nan), ambient_light=np.full(3, np.nan))
    none = np.zeros(SHAPE, np.bool_)
    np.testing.assert_array_equal(
        bound_by_veil(filled, none, dark_thing(1.0), unknown, "linear"), filled
    )
