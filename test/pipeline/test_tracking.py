# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The filter over frames behind the pipeline, on rendered frames with noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from uw_visibility import FrameResult, Pipeline, PipelineConfig
from uw_visibility.status import Status
from uw_visibility.water.series.filter import FilteredWater, WaterFilter
from uw_visibility.water.series.tracking import TrackingEvent
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.frame import Effects
from uw_visibility_lab.simulation.transect import Transect

CAMERA = StereoCamera(192, 144, 180.0, 0.12)
RIG = CAMERA.rig
FRAMES = 16
PERIOD = 0.5


def pipeline(**changes) -> Pipeline:
    return Pipeline(RIG, PipelineConfig.from_parameters({"threads": 2, **changes}))


@pytest.fixture(scope="module")
def frames():
    transect = Transect(
        frames=FRAMES, rate=1 / PERIOD, depth=(3.0, 3.5), attenuation=(0.15, 0.18),
        exposure=1.2, camera=CAMERA, effects=Effects(marine_snow=0.01, caustics=0.2), seed=3,
    )
    return [frame for _, frame in transect.render()]


class Filtered(NamedTuple):
    frame: FrameResult
    filtered: FilteredWater | None


@pytest.fixture(scope="module")
def results(frames) -> list[Filtered]:
    """Results of the frames, whose exposure is halved from the middle on."""
    alone, water_filter = pipeline(), WaterFilter(PipelineConfig())
    out = []
    for index, frame in enumerate(frames):
        left, right = frame.left, frame.right
        if index >= FRAMES // 2:
            left, right = ((0.5 * image + 0.5).astype(np.uint8) for image in (left, right))
        result = alone.process(left, right)
        out.append(Filtered(result, water_filter.update(result.water, index * PERIOD)))
    return out


def errors(frames, visibilities):
    return np.array([
        v.mean_attenuation - f.mean_attenuation
        for v, f in zip(visibilities, frames, strict=True)])


def test_filtered_attenuation_changes_less_than_half_as_much_from_frame_to_frame(frames, results):
    """And the halved exposure in the middle does not show."""
    raw = errors(frames, [r.frame.visibility for r in results])
    filtered = errors(frames, [r.filtered.visibility for r in results])
    assert np.isfinite(filtered).all()
    assert results[0].filtered.event is TrackingEvent.STARTED
    steps = [np.sqrt(np.nanmean(np.diff(e[3:]) ** 2)) for e in (raw, filtered)]
    assert steps[1] < 0.5 * steps[0]
    assert abs(np.nanmean(filtered[3:]) - np.nanmean(raw[3:])) < 0.012


def test_filtered_light_follows_the_exposure_at_once(results):
    middle = FRAMES // 2
    before, after = (results[k].filtered.water.ambient_light for k in (middle - 1, middle))
    np.testing.assert_allclose(after / before, 0.5, rtol=0.15)


def test_a_frame_s_own_result_does_not_depend_on_the_frames_before(frames, results):
    """Replay processes frames in parallel, and must tell what the node tells."""
    alone = pipeline().process(frames[5].left, frames[5].right)
    np.testing.assert_array_equal(results[5].frame.water.attenuation, alone.water.attenuation)
    np.testing.assert_array_equal(results[5].frame.left_enhanced, alone.left_enhanced)


def test_a_frame_without_colour_has_no_filtered_value(frames):
    """A camera that changes to mono does not go on with what colour told before."""
    alone, water_filter = pipeline(), WaterFilter(PipelineConfig())
    water_filter.update(alone.process(frames[0].left, frames[0].right).water, 0.0)
    grey = [np.repeat(image[..., 1:2], 3, axis=2) for image in (frames[1].left, frames[1].right)]
    result = alone.process(*grey)
    filtered = water_filter.update(result.water, PERIOD)
    assert result.status is Status.NO_COLOUR
    assert np.isnan(result.visibility.mean_attenuation)
    assert filtered.event is TrackingEvent.NOT_ASSESSABLE
    assert np.isnan(filtered.visibility.mean_attenuation)
