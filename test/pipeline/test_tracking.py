# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The recursion over frames in the pipeline, on rendered frames with noise."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility import FrameResult, Pipeline, PipelineConfig, StereoRig
from uw_visibility.simulation.camera import StereoCamera
from uw_visibility.simulation.frame import Effects
from uw_visibility.simulation.transect import Transect
from uw_visibility.status import Status
from uw_visibility.water.tracking import TrackingEvent

CAMERA = StereoCamera(192, 144, 180.0, 0.12)
RIG = StereoRig(CAMERA.focal_length, CAMERA.baseline, CAMERA.principal_point)
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


@pytest.fixture(scope="module")
def results(frames) -> list[FrameResult]:
    """Results of the frames, whose exposure is halved from the middle on."""
    tracking = pipeline()
    out = []
    for index, frame in enumerate(frames):
        left, right = frame.left, frame.right
        if index >= FRAMES // 2:
            left, right = ((0.5 * image + 0.5).astype(np.uint8) for image in (left, right))
        out.append(tracking.process(left, right, stamp=index * PERIOD))
    return out


def errors(frames, results, filtered):
    seen = [r.tracked_visibility if filtered else r.visibility for r in results]
    return np.array([
        v.mean_attenuation - f.mean_attenuation for v, f in zip(seen, frames, strict=True)])


def test_filtered_attenuation_changes_less_than_half_as_much_from_frame_to_frame(frames, results):
    """And the halved exposure in the middle does not show."""
    raw, filtered = errors(frames, results, False), errors(frames, results, True)
    assert np.isfinite(filtered).all()
    assert results[0].tracking is TrackingEvent.STARTED
    steps = [np.sqrt(np.nanmean(np.diff(e[3:]) ** 2)) for e in (raw, filtered)]
    assert steps[1] < 0.5 * steps[0]
    assert abs(np.nanmean(filtered[3:]) - np.nanmean(raw[3:])) < 0.01


def test_filtered_light_follows_the_exposure_at_once(results):
    middle = FRAMES // 2
    before, after = (results[k].tracked.ambient_light for k in (middle - 1, middle))
    np.testing.assert_allclose(after / before, 0.5, rtol=0.15)


def test_frames_without_a_stamp_are_neither_filtered_nor_remembered(frames):
    first, second = pipeline(), pipeline()
    first.process(frames[0].left, frames[0].right, stamp=0.0)
    second.process(frames[0].left, frames[0].right, stamp=0.0)
    between = first.process(frames[9].left, frames[9].right)
    assert between.tracked is between.tracked_visibility is between.tracking is None
    a = first.process(frames[1].left, frames[1].right, stamp=PERIOD)
    b = second.process(frames[1].left, frames[1].right, stamp=PERIOD)
    np.testing.assert_array_equal(a.tracked.attenuation, b.tracked.attenuation)
    alone = pipeline().process(frames[9].left, frames[9].right)
    np.testing.assert_array_equal(alone.water.attenuation, between.water.attenuation)
    np.testing.assert_array_equal(alone.disparity, between.disparity)


def test_a_frame_s_own_result_does_not_depend_on_the_frames_before(frames, results):
    """Replay processes frames in parallel, and must tell what the node tells."""
    alone = pipeline().process(frames[5].left, frames[5].right)
    np.testing.assert_array_equal(results[5].water.attenuation, alone.water.attenuation)
    np.testing.assert_array_equal(results[5].left_enhanced, alone.left_enhanced)


def test_tracking_can_be_turned_off_and_begun_anew(frames):
    off = pipeline(**{"tracking.enabled": False})
    assert off.process(frames[0].left, frames[0].right, stamp=0.0).tracked is None
    off.reset_tracking()
    on = pipeline()
    on.process(frames[0].left, frames[0].right, stamp=0.0)
    on.reset_tracking()
    result = on.process(frames[1].left, frames[1].right, stamp=PERIOD)
    assert result.tracking is TrackingEvent.STARTED
    np.testing.assert_allclose(result.tracked.attenuation, result.water.attenuation)


def test_a_frame_that_shows_no_water_is_bridged(frames):
    tracking = pipeline()
    first = tracking.process(frames[0].left, frames[0].right, stamp=0.0)
    grey = [np.repeat(image[..., 1:2], 3, axis=2) for image in (frames[1].left, frames[1].right)]
    second = tracking.process(*grey, stamp=PERIOD)
    assert second.status is Status.NO_COLOUR
    assert np.isnan(second.visibility.mean_attenuation)
    assert second.tracking is TrackingEvent.PREDICTED
    assert second.tracked.status is Status.OK
    assert second.tracked_visibility.mean_attenuation == pytest.approx(
        first.tracked_visibility.mean_attenuation)
    assert (second.tracked_visibility.mean_attenuation_stddev
            > first.tracked_visibility.mean_attenuation_stddev)
