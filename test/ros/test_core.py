# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the node asks of the pipeline, and what a failure inside costs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility.messages.estimates import ImageHeader
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.outputs import TOPICS
from uw_visibility.pipeline.result import EnhancedImages, FrameResult, StereoResult
from uw_visibility.status import Status
from uw_visibility.water.assessment import Visibility
from uw_visibility.water.estimate import WaterEstimate

pytest.importorskip("rclpy", reason="ROS is not installed")

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Float64

from uw_visibility.ros import core as module
from uw_visibility.ros.parameters import NodeParameters

ESTIMATES = {topic for topic in TOPICS if topic.startswith("visibility/")}


INFO = CameraInfo(width=160, height=120)
FRAME = StereoFrame(Image(), Image(), INFO, INFO)
WATER = WaterEstimate.not_assessable(Status.TOO_DARK)
NOTHING = np.full((1, 1), np.nan, np.float32)
RESULT = FrameResult(
    WATER, WATER, Visibility(Status.TOO_DARK, Status.TOO_DARK), np.zeros(3),
    StereoResult(NOTHING, NOTHING, NOTHING, NOTHING, None, None, 0, 0.5, 0, 32, np.ones(3)),
    EnhancedImages(NOTHING, NOTHING, NOTHING > 0), {"total": 1.0},
)


class Processor:
    """Stands for the pipeline: fails as told, and notes what was asked."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.reader = self
        self.calibrations, self.rig = 0, None
        self.asked: list[set[str]] = []
        self.failure: Exception | None = None
        self.header = ImageHeader(1, 0, "camera")
        self.rig = None

    def begin(self, frame: Any, pipeline: Any) -> Any:
        return self

    def assess(self, topics: Any, *, known_light: Any = None) -> Any:
        self.asked.append(set(topics))
        if self.failure is not None:
            raise self.failure
        return RESULT

    def messages(
        self, result: Any, node: Any, topics: Any, filtered: Any
    ) -> list[tuple[str, Any]]:
        return [("visibility/mean_attenuation", Float64(data=1.0))]


@pytest.fixture
def core(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setattr(module, "FrameProcessor", Processor)
    # Compiling is of no matter here.
    monkeypatch.setattr(module, "warm_up", lambda *arguments, **options: None)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = Node("uw_visibility", namespace="/core", context=context)
    core = module.NodeCore(node, NodeParameters(node))
    core.activate()
    yield core
    assert core.stop(10)
    node.destroy_node()
    context.try_shutdown()


def wait(done: Callable[[], bool]) -> None:
    end = time.monotonic() + 20
    while not done():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_images_are_made_for_subscribers_only_and_estimates_always(core: Any) -> None:
    node = core._node
    core.worker.offer(FRAME)
    wait(lambda: core.state.processed == 1)
    subscription = node.create_subscription(
        module.message_type(TOPICS["disparity"]), "disparity", lambda message: None, 1
    )
    wait(lambda: core._publishers["disparity"].get_subscription_count() == 1)
    core.worker.offer(FRAME)
    wait(lambda: core.state.processed == 2)
    assert core._processor.asked == [ESTIMATES, ESTIMATES | {"disparity"}]
    node.destroy_subscription(subscription)


def test_failure_costs_one_frame_and_tells_its_traceback_once(
    core: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    core._processor.failure = ZeroDivisionError("inside")
    for count in (1, 2, 3):
        core.worker.offer(FRAME)
        wait(lambda count=count: core.state.failures.total == count)
    core._processor.failure = InputError("the frame is odd: make it even")
    core.worker.offer(FRAME)
    wait(lambda: core.state.failures.total == 4)
    core._processor.failure = None
    core.worker.offer(FRAME)
    wait(lambda: core.state.processed == 1)
    assert sorted(core.state.failures.counts.values()) == [1, 3]
    said = "".join(capfd.readouterr())
    assert said.count("Traceback") == 1
    assert "dropped a frame: the frame is odd: make it even" in said


def test_images_that_memory_has_no_room_for_are_refused_before_they_are_read(core: Any) -> None:
    huge = CameraInfo(width=30000, height=30000)
    core.worker.offer(FRAME._replace(left_info=huge, right_info=huge))
    wait(lambda: core.state.refused == 1)
    (reason,) = core.state.failures.counts
    assert "30000x30000 pixels, more than max_megapixels, which is 8" in reason
    assert core._processor.asked == []
