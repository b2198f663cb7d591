# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The depth test on what the pipeline finds of a rendered transect: honest, jump and drift."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from uw_visibility.config.schema import PipelineConfig, PlausibilityConfig
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.plausibility.comparison import DepthSample, Verdict
from uw_visibility.plausibility.monitor import DepthMonitor
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.transect import Transect

SECOND = 1_000_000_000
RATE = 2.0
TRANSECT = Transect(
    frames=16, rate=RATE, depth=(2.5, 6.0), attenuation=(0.1, 0.25), seed=4,
    camera=StereoCamera(240, 180, 225.0, 0.12),
)
LENGTH = 500


@pytest.fixture(scope="module")
def swum() -> list[tuple[float, FrameResult]]:
    """Return the true depth and the result of each frame, there and back for 500 frames."""
    camera = TRANSECT.camera
    rig = camera.rig
    config = PipelineConfig.from_parameters({"stereo.max_disparity": 48})
    pipeline = Pipeline(rig, config)
    there = [
        (frame.depth, pipeline.process(frame.left, frame.right, enhance=()))
        for _, frame in TRANSECT.render()
    ]
    once = there + there[::-1]
    return (once * (LENGTH // len(once) + 1))[:LENGTH]


def verdicts(
    swum: list[tuple[float, FrameResult]], fault: Callable[[float], float] = lambda time: 0.0
) -> list[Verdict]:
    """Return the verdict after each frame, with a sensor of 5 cm that has a fault (m)."""
    random = np.random.default_rng(1)
    monitor, found = DepthMonitor(PlausibilityConfig()), []
    for index, (depth, result) in enumerate(swum):
        time = (index + 1) / RATE
        stamp = round(time * SECOND)
        said = depth + fault(time) + 0.05 * random.standard_normal()
        monitor.add_sensor(DepthSample(stamp, said, 0.05**2), time)
        visibility = result.visibility
        estimate = DepthSample.estimated(
            stamp, visibility.depth, visibility.depth_stddev, visibility.depth_precision)
        monitor.add_estimate(estimate, visibility.depth_status, time)
        found.append(monitor.report(time).verdict)
    return found


def test_honest_sensor_is_never_accused(swum: list[tuple[float, FrameResult]]) -> None:
    found = verdicts(swum)
    assert Verdict.ERROR not in found
    # To say nothing would not be wrong either, but of no use.
    assert found.count(Verdict.OK) > 0.9 * LENGTH


@pytest.mark.parametrize("size", [3.0, -3.0])
@pytest.mark.parametrize("moment", [20.0, 77.0, 130.0])
def test_jump_is_an_error_within_ten_frames(
    swum: list[tuple[float, FrameResult]], size: float, moment: float
) -> None:
    found = verdicts(swum, lambda time: size if time > moment else 0.0)
    jump = round(moment * RATE)
    assert Verdict.ERROR not in found[:jump]
    assert Verdict.ERROR in found[jump : jump + 10]


@pytest.mark.parametrize("rate", [0.01, -0.01])
def test_slow_drift_is_an_error_soon_after_a_metre_and_a_half(
    swum: list[tuple[float, FrameResult]], rate: float
) -> None:
    # 1 cm/s from 60 s on: a metre and a half at 210 s.
    found = verdicts(swum, lambda time: rate * max(time - 60.0, 0.0))
    beyond = round(210.0 * RATE)
    assert Verdict.ERROR not in found[: round(60.0 * RATE)]
    assert Verdict.ERROR in found[: beyond + 10]
    # Evidence is bounded by the limit, so that less than it is a warning again.
    assert set(found[beyond + 10 :]) <= {Verdict.WARN, Verdict.ERROR}
