# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A channel that the water took: what the others say stands, and it stays black."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes import water_view

from uw_visibility import StereoRig, estimate_water
from uw_visibility.enhancement.white_balance import RestorationWater, restoration_water
from uw_visibility.status import Status
from uw_visibility.water.estimate import overall_status

RIG = StereoRig(focal_length=600.0, baseline=0.2, principal_point=(200.0, 150.0))


def lost(image, channels, rng):
    """The image without the light of some channels, or with noise of a code in its place."""
    image = image.copy()
    image[..., channels] = 0 if rng is None else rng.integers(0, 2, image[..., channels].shape)
    return image


@pytest.mark.parametrize(("noisy", "open_rows"), [(False, 0), (True, 60)])
def test_frames_without_red_tell_what_they_tell_with_it(noisy, open_rows):
    rng = np.random.default_rng(4) if noisy else None
    told = []
    for alpha in (0.05, 0.1, 0.2, 0.3):
        for depth in (1.0, 4.0):
            view = water_view(alpha=alpha, depth=depth)
            image = view.codes()
            ranges = view.range.copy()
            if open_rows:
                image[:open_rows] = np.round(255 * view.ambient_light)
                ranges[:open_rows] = np.nan
            disparity = (RIG.focal_length * RIG.baseline / ranges).astype(np.float32)
            whole = estimate_water(image, disparity, RIG, disparity_stddev=0.0)
            part = estimate_water(lost(image, [0], rng), disparity, RIG, disparity_stddev=0.0)
            there = math.isfinite(whole.visibility.distance)
            told.append((there, math.isfinite(part.visibility.distance)))
            if not all(told[-1]):
                continue
            assert part.status is Status.OK
            assert part.visibility.channels == "GB"
            assert np.isnan(part.water.attenuation[0])
            away = abs(part.visibility.distance - whole.visibility.distance)
            assert away < np.hypot(
                part.visibility.distance_stddev, whole.visibility.distance_stddev)
            np.testing.assert_allclose(
                part.visibility.mean_attenuation,
                np.mean((part.water.attenuation - part.clear_water_attenuation)[1:]))
    whole, part = np.sum(told, axis=0)
    assert whole >= 6
    assert part >= 0.9 * whole


def test_red_that_only_a_broken_camera_loses_tells_no_depth_or_hardly_any():
    """At a metre of depth daylight has red."""
    view = water_view(alpha=0.2, depth=1.0)
    disparity = (RIG.focal_length * RIG.baseline / view.range).astype(np.float32)
    found = estimate_water(lost(view.codes(), [0], None), disparity, RIG, disparity_stddev=0.0)
    assert found.status is Status.OK
    seen = found.visibility
    if seen.depth_status is not Status.NO_DAYLIGHT_COLOUR:
        assert abs(seen.depth - 1.0) < 3.0 * seen.depth_stddev and seen.depth_stddev > 2.0


@pytest.mark.parametrize("channels", [[1], [2], [0, 1], [0, 2]])
def test_any_channels_may_be_lost(channels):
    view = water_view(alpha=0.2, depth=2.0)
    disparity = (RIG.focal_length * RIG.baseline / view.range).astype(np.float32)
    found = estimate_water(lost(view.codes(), channels, None), disparity, RIG, disparity_stddev=0.0)
    assert found.status is Status.OK
    kept = [c for c in range(3) if c not in channels]
    assert np.flatnonzero(np.isfinite(found.water.attenuation)).tolist() == kept
    np.testing.assert_allclose(
        found.water.attenuation[kept], view.attenuation[kept],
        atol=3 * found.water.attenuation_stddev[kept].max())
    if len(kept) == 1:
        assert found.visibility.depth_status is Status.NO_COLOUR


def test_a_frame_without_any_light_is_too_dark():
    view = water_view()
    disparity = (RIG.focal_length * RIG.baseline / view.range).astype(np.float32)
    found = estimate_water(np.zeros_like(view.codes()), disparity, RIG)
    assert found.status is Status.TOO_DARK


def test_the_status_of_channels_together():
    dark, well, full = Status.TOO_DARK, Status.OK, Status.SATURATED
    assert overall_status([dark, well, well]) is well
    assert overall_status([dark, dark, dark]) is dark
    assert overall_status([dark, well, full]) is full
    assert overall_status([well, well, well]) is well


def test_the_others_are_restored_as_without_the_lost_one():
    view = water_view(alpha=0.2)
    measured = np.ones(view.range.shape, bool)
    water = RestorationWater(view.attenuation, view.ambient_light, view.ambient_light)
    without = RestorationWater(*(
        np.where((True, False, False), np.nan, values) for values in water[:3]))
    part = restoration_water(view.codes(), view.range, measured, without, "linear")
    alone = restoration_water(
        view.codes()[..., 1:], view.range, measured,
        RestorationWater(*(values[1:] for values in water[:3])), "linear")
    np.testing.assert_array_equal(part.scene_light[1:], alone.scene_light)
    assert np.isnan(part.scene_light[0])
