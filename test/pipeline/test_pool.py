# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames that overlap tell what they tell alone."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest
from scenes import ReefView

from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.pipeline.pool import PipelinePool
from uw_visibility.simulation.camera import Pose, StereoCamera
from uw_visibility.simulation.frame import RenderedFrame
from uw_visibility.simulation.water import Water

CAMERA = StereoCamera(200, 150, 200.0, 0.12)
RIG = StereoRig(CAMERA.focal_length, CAMERA.baseline, (99.5, 74.5))
CONFIG = PipelineConfig.from_parameters({"stereo.max_disparity": 40, "threads": 2})


@pytest.fixture(scope="module")
def frames() -> list[RenderedFrame]:
    return [
        ReefView(CAMERA, pose=Pose((0.3 * i, 0.0, 1.5), tilt=0.3), water=Water(0.15, 3.0)).frame()
        for i in range(4)
    ]


def test_overlapping_frames_tell_what_they_tell_alone(frames: list[RenderedFrame]) -> None:
    pool = PipelinePool(RIG, CONFIG)
    alone = Pipeline(RIG, CONFIG)
    both = Barrier(2, timeout=30)

    def process(frame: RenderedFrame):
        with pool.pipeline() as pipeline:
            both.wait()
            return pipeline, pipeline.process(frame.left, frame.right)

    with ThreadPoolExecutor(2) as threads:
        for _ in range(3):
            used, found = zip(*threads.map(process, frames), strict=True)
            assert len({id(pipeline) for pipeline in used}) == 2
            for frame, result in zip(frames, found, strict=True):
                expected = alone.process(frame.left, frame.right)
                np.testing.assert_array_equal(result.disparity, expected.disparity)
                np.testing.assert_array_equal(result.left_enhanced, expected.left_enhanced)
                np.testing.assert_array_equal(result.water.covariance, expected.water.covariance)


def test_a_pipeline_comes_back_after_a_frame_that_fails() -> None:
    pool = PipelinePool(RIG, CONFIG)
    with pytest.raises(ZeroDivisionError), pool.pipeline() as first:
        raise ZeroDivisionError
    with pool.pipeline() as second:
        assert second is first
