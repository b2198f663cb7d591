# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A frame that is refused alone is restored with the water of the frames before it."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np
import pytest

from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.series.filter import WaterFilter
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame
from uw_visibility_lab.simulation.transect import Transect
from uw_visibility_lab.simulation.water import WaterEffects

CAMERA = StereoCamera(240, 180, 225.0, 0.12)


class Series(NamedTuple):
    """Three frames, the last of them refused, and the water after the first two."""

    pipeline: Pipeline
    frames: list[RenderedFrame]
    results: list[FrameResult]
    known: WaterEstimate


@pytest.fixture(scope="module")
def series() -> Series:
    """Nearly straight down: sway takes away the spread of ranges."""
    plan = Transect(
        frames=12, rate=1.0, speed=0.05, depth=(4.0, 4.0), attenuation=(0.3, 0.3), tilt=84.0,
        seed=3, camera=CAMERA, water_effects=WaterEffects(veil=(0.5, 0.5, 0.5)))
    frames = [each.frame for each in islice(plan.render(), 4, 7)]
    pipeline = Pipeline(CAMERA.rig)
    water_filter = WaterFilter(pipeline.config)
    results = []
    for number, frame in enumerate(frames):
        if number == 2:
            assert water_filter.known is not None
            known = water_filter.known.at(2.0)
        results.append(pipeline.process(frame.left, frame.right, known_water=asked_by_nobody
                                        if number < 2 else None))
        water_filter.update(results[-1].water, float(number))
    assert known is not None
    return Series(pipeline, frames, results, known)


def asked_by_nobody() -> None:
    raise AssertionError


def means(image: np.ndarray) -> np.ndarray:
    return image.reshape(18, 10, 24, 10, 3).astype(float).mean(axis=(1, 3))


def change(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(np.mean((means(one) - means(other)) ** 2)))


def test_a_refused_frame_looks_like_those_before_it(series: Series) -> None:
    frame, alone = series.frames[2], series.results[2]
    assert alone.status is Status.RANGE_SPREAD_TOO_SMALL
    np.testing.assert_array_equal(alone.left_enhanced, frame.left)
    found = series.pipeline.process(frame.left, frame.right, known_water=lambda: series.known)
    before = [result.left_enhanced for result in series.results]
    usual = change(before[0], before[1])
    assert change(before[1], before[2]) > 2.0 * usual
    assert change(before[1], found.left_enhanced) < 1.2 * usual
    assert change(found.right_enhanced, frame.right) > 2.0 * usual
    # The estimate is that of the frame alone.
    assert found.status is alone.status
    assert np.isnan(found.visibility.distance)


@pytest.mark.parametrize("lost", ["all", "red"])
def test_water_that_is_not_known_either_leaves_the_image_as_it_is(
    series: Series, lost: str
) -> None:
    without_red = replace(
        series.known, attenuation=np.where([True, False, False], np.nan, series.known.attenuation))
    known = None if lost == "all" else without_red
    frame = series.frames[2]
    found = series.pipeline.process(frame.left, frame.right, known_water=lambda: known)
    np.testing.assert_array_equal(found.left_enhanced, frame.left)


def test_nobody_asks_where_a_frame_tells_its_water_or_refutes_it_or_no_image_is_wanted(
    series: Series
) -> None:
    refused = series.frames[2]
    series.pipeline.process(refused.left, refused.right, enhance=(), known_water=asked_by_nobody)
    told = series.frames[0]
    grey = (np.repeat(image[..., 1:2], 3, axis=2) for image in (told.left, told.right))
    found = series.pipeline.process(*grey, known_water=asked_by_nobody)
    assert found.status is Status.NO_COLOUR


def test_an_overexposed_frame_is_not_restored_with_the_light_of_another_exposure(
    series: Series
) -> None:
    told = series.frames[0]
    bright = [np.minimum(4 * image.astype(int), 255).astype(np.uint8)
              for image in (told.left, told.right)]
    found = series.pipeline.process(*bright, known_water=asked_by_nobody)
    assert Status.SATURATED in found.water.channel_status
    np.testing.assert_array_equal(found.left_enhanced, bright[0])
