# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images that are grey on average, as automatic white balance makes them, tell no depth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import in_water, texture

from uw_visibility import PipelineConfig
from uw_visibility.images.view import View
from uw_visibility.status import Status
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.daylight.grey_average import ColourBalance, GreyFrames, colour_balance
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility.water.series.filter import WaterFilter


def frame(grey: bool, red: float = 0.1) -> WaterEstimate:
    """Water with veil and light apart, as of daylight a few metres down."""
    covariance = np.diag([0.01**2, 0.002**2] * 3)
    light = np.array([red, 0.4, 0.5])
    return WaterEstimate(
        Status.OK, np.array([0.5, 0.2, 0.15]), light, covariance, 9, 30, (Status.OK,) * 3,
        light=light, light_covariance=0.05**2 * np.eye(3), grey_on_average=grey)


@pytest.mark.parametrize(("gain", "grey"), [
    ((1.0, 1.0, 1.0), True), ((1.07, 1.0, 0.94), True), ((0.9, 1.0, 1.0), False),
    ((1.0, 1.0, 1.1), False), ((0.0, 1.0, 1.0), False),
])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_channels_of_one_mean_are_grey(gain, grey, kind):
    top = np.iinfo(kind).max
    image = 0.5 * top * np.random.default_rng(1).uniform(0.2, 1.0, (90, 120, 1)) * gain
    assert colour_balance(image.astype(kind)).grey is grey


@pytest.mark.parametrize(("gain", "alike"), [
    ((0.7, 1.0, 1.0), True), ((0.7, 1.0, 1.01), False), ((1.3, 1.0, 1.0), False),
])
def test_green_and_blue_of_one_mean_are_told(gain, alike):
    image = 127 * np.random.default_rng(1).uniform(0.2, 1.0, (90, 120, 1)) * gain
    assert colour_balance(image.astype(np.uint8)) == (False, alike)


def test_water_takes_red_unless_the_camera_gives_it_back():
    ranges = np.tile(np.linspace(1.0, 8.0, 240, dtype=np.float32)[:, np.newaxis], (1, 320))
    scene = texture((240, 320, 3), 4, (2, 6))
    raw = in_water(scene, ranges, [0.5, 0.2, 0.15], [0.3, 0.6, 0.7])
    mean = raw.mean(axis=(0, 1))
    balanced = np.clip(np.round(raw * (100.0 / mean)), 0, 255).astype(np.uint8)
    estimator = WaterEstimator(PipelineConfig().water, np.array([0.3, 0.06, 0.03]))
    found = [estimator.estimate_view(View.of(i), ranges, range_error=0.0) for i in (raw, balanced)]
    assert [estimate.grey_on_average for estimate in found] == [False, True]
    # Attenuation is a ratio within a channel: the balance leaves it.
    for estimate in found:
        np.testing.assert_array_less(
            np.abs(estimate.attenuation - [0.5, 0.2, 0.15]), 3 * estimate.attenuation_stddev)


def test_depth_alone_is_refused_and_only_where_the_white_is_not_measured():
    plain = Assessor(PipelineConfig())
    seen, grey = plain.assess(frame(False)), plain.assess(frame(True))
    assert seen.depth_status is Status.OK and seen.depth > 1.0
    assert grey.depth_status is Status.GREY_ON_AVERAGE and math.isnan(grey.depth)
    assert (grey.status, grey.distance) == (Status.OK, seen.distance)
    one_light = replace(frame(True), light=None, light_covariance=None)
    assert plain.assess(one_light).depth_status is Status.GREY_ON_AVERAGE
    calibrated = Assessor(
        PipelineConfig.from_parameters({"camera.white_reference": [0.9, 1.0, 1.1]}))
    assert calibrated.assess(frame(True)).depth_status is Status.OK


def test_the_filter_goes_by_most_frames_of_late():
    water_filter = WaterFilter(PipelineConfig())
    statuses = []
    for number, grey in enumerate([True] * 6 + [False] + [True] * 3 + [False] * 8):
        found = water_filter.update(frame(grey), float(number))
        assert found is not None
        statuses.append(found.visibility.depth_status)
    assert statuses[:10] == [Status.GREY_ON_AVERAGE] * 10
    assert statuses[-1] is Status.OK


def test_green_and_blue_alike_in_most_frames_are_a_balance_whose_gain_of_red_ends_too_early():
    for pattern, told in (([True] * 4, [False, False, True, True]),
                          ([True, False, False, True, False, False], [False] * 6)):
        grey = GreyFrames()
        assert [grey.add(ColourBalance(False, alike)) for alike in pattern] == told
