# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the node asks of the pipeline, and what a failure inside costs."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uw_visibility.config.schema import NodeConfig
from uw_visibility.errors import InputError
from uw_visibility.images.network import NetworkError
from uw_visibility.messages.estimates import ImageHeader
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.outputs import all_topics
from uw_visibility.pipeline.result import EnhancedImages, FrameResult, StereoResult
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility

pytest.importorskip("rclpy", reason="ROS is not installed")


import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Float64

from uw_visibility.ros import core as module
from uw_visibility.ros.core import PipelineState
from uw_visibility.ros.monitor import ERROR, OK, WARN, ReasonLog
from uw_visibility.ros.parameters import NodeParameters
from uw_visibility.water.series.filter import FilteredWater
from uw_visibility.water.series.survey import SurveyEstimate
from uw_visibility.water.series.tracking import TrackingEvent

TOPICS = all_topics(NodeConfig())
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
        self.calibrations, self.pair = 0, SimpleNamespace(rig=None)
        self.asked: list[set[str]] = []
        self.used: list[Any] = []
        self.failure: Exception | None = None
        self.header = ImageHeader(1, 0, "camera")

    def begin(self, frame: Any, pipeline: Any, lane: int) -> Any:
        self.used.append(pipeline)
        return self

    def assess(self, topics: Any, **known: Any) -> Any:
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
    with running(monkeypatch) as core:
        yield core


@contextmanager
def running(monkeypatch: pytest.MonkeyPatch, **given: Any) -> Iterator[Any]:
    """Core of a node that was started with these parameters."""
    monkeypatch.setattr(module, "FrameProcessor", Processor)
    # Compiling is of no matter here.
    monkeypatch.setattr(module, "warm_up", lambda *arguments, **options: None)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    overrides = [Parameter(name.replace("__", "."), value=value) for name, value in given.items()]
    node = Node(
        "uw_visibility", namespace="/core", context=context, parameter_overrides=overrides)
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


@pytest.mark.parametrize("at_once", [1, 2])
def test_as_many_frames_are_under_way_as_told_and_reach_the_filter_in_their_order(
    monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    hold, order = threading.Event(), []

    def assess(topics: Any, **known: Any) -> Any:
        order.append("begun")
        first = len(order) == 1
        assert not first or hold.wait(20)
        return replace(RESULT, timing_ms={"total": 1.0 if first else 2.0})

    def add(result: Any, *others: Any) -> None:
        order.append(result.timing_ms["total"])

    with running(monkeypatch, frames_at_once=at_once) as core:
        monkeypatch.setattr(core._processor, "assess", assess)
        monkeypatch.setattr(core.state, "add", add)
        core.worker.offer(FRAME)
        wait(lambda: len(order) == 1)
        core.worker.offer(FRAME)
        # The second has long ended, if it was begun.
        time.sleep(0.05)
        hold.set()
        wait(lambda: len(order) == 4)
    assert order == (["begun", 1.0, "begun", 2.0], ["begun", "begun", 1.0, 2.0])[at_once - 1]


def test_a_frame_asks_for_the_water_when_all_before_it_are_answered(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be begun before: the answer is that of one frame at a time."""
    hold, order = threading.Event(), []

    def assess(topics: Any, *, known_water: Any, **known: Any) -> Any:
        order.append("begun")
        if order.count("begun") == 1:
            assert hold.wait(20)
        else:
            hold.set()
            order.append(known_water())
        return RESULT

    with running(monkeypatch, frames_at_once=2) as core:
        filtered = core._filter_for(core._parameters.settings)
        # The update of a frame sets it, too.
        told = property(lambda self: len(order), lambda self, water: None)
        monkeypatch.setattr(type(filtered), "known", told, raising=False)
        monkeypatch.setattr(core._processor, "assess", assess)
        monkeypatch.setattr(core.state, "add", lambda *arguments: order.append("answered"))
        core.worker.offer(FRAME)
        wait(lambda: order == ["begun"])
        core.worker.offer(FRAME)
        wait(lambda: len(order) == 5)
    assert order == ["begun", "begun", "answered", 3, "answered"]


@pytest.mark.parametrize("given, encoding, times", [
    ({}, "rgb8", 1), ({}, "bayer_rggb8", 0), ({"camera__transfer": "linear"}, "rgb8", 0)])
def test_images_like_video_are_asked_about_once_where_no_transfer_is_told(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], given: dict[str, Any],
    encoding: str, times: int,
) -> None:
    image = Image(encoding=encoding)
    with running(monkeypatch, **given) as core:
        for count in (1, 2):
            core.worker.offer(FRAME._replace(left=image, right=image))
            wait(lambda count=count: core.state.processed == count)
    assert "".join(capfd.readouterr()).count("transfer is not set: give --transfer srgb") == times


@pytest.mark.parametrize("failure", [None, ZeroDivisionError("inside")])
def test_frames_that_a_deactivation_takes_are_counted(
    core: Any, monkeypatch: pytest.MonkeyPatch, failure: Exception | None
) -> None:
    begun, hold = threading.Event(), threading.Event()

    def assess(topics: Any, **known: Any) -> Any:
        begun.set()
        assert hold.wait(20)
        if failure is not None:
            raise failure
        return RESULT

    monkeypatch.setattr(core._processor, "assess", assess)
    core.worker.offer(FRAME)
    assert begun.wait(20)
    # One waits meanwhile.
    core.worker.offer(FRAME)
    core.deactivate()
    hold.set()
    wait(lambda: core.state.discarded == 2)
    values = core.diagnose()["pipeline"].values
    assert values["frames discarded (not active)"] == 2
    assert sum(values[f"frames {name}"] for name in ("processed", "refused", "failed")) == 0


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


def test_a_network_that_fails_three_times_in_a_row_is_replaced(
    core: Any, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    settings = core._parameters.settings
    mine = replace(settings.pipeline, stereo=replace(settings.pipeline.stereo, matcher="onnx"))
    monkeypatch.setattr(core._parameters, "settings", replace(settings, pipeline=mine))
    lost = NetworkError("stereo.model: the network mine.onnx failed: no memory")
    outcomes = [lost, lost, None, lost, lost, lost, None]
    for count, failure in enumerate(outcomes, 1):
        core._processor.failure = failure
        core.worker.offer(FRAME)
        wait(lambda count=count: core.state.processed + core.state.failed == count)
    matchers = [used.stereo.matcher for used in core._processor.used]
    assert matchers == ["onnx"] * 6 + ["elas"]
    assert (core.state.processed, core.state.failed) == (2, 5)
    for _ in range(2):
        finding = core.state.diagnose("", 0)
        assert finding.level == ERROR
    assert "stand in until a parameter changes: stereo.model: the network mine" in finding.message
    # Other parameters are a new try.
    other = replace(mine, stereo=replace(mine.stereo, model="other.onnx"))
    monkeypatch.setattr(core._parameters, "settings", replace(settings, pipeline=other))
    core.worker.offer(FRAME)
    wait(lambda: core.state.processed == 3)
    assert core._processor.used[-1] == other
    assert "stand in" not in core.state.diagnose("", 0).message
    assert "".join(capfd.readouterr()).count("failed 3 times in a row") == 1


@pytest.mark.parametrize("side", ["left", "right"])
def test_images_that_memory_has_no_room_for_are_refused_before_they_are_read(
    core: Any, side: str
) -> None:
    core.worker.offer(FRAME._replace(**{f"{side}_info": CameraInfo(width=30000, height=30000)}))
    wait(lambda: core.state.refused == 1)
    (reason,) = core.state.failures.counts
    assert "30000x30000 pixels, more than max_megapixels, which is 8" in reason
    assert core._processor.used == []


FLAT = Status.RANGE_SPREAD_TOO_SMALL
VISIBILITY = Visibility(FLAT, FLAT)


def result(status: Status, distance: Status | None = None) -> Any:
    return SimpleNamespace(
        status=status, visibility=Visibility(distance or status, FLAT), timing_ms={},
        stereo=SimpleNamespace(support_points=100, coverage=0.5, matched_fraction=0.5),
    )


def state() -> PipelineState:
    return PipelineState(ReasonLog(lambda _: None))


def test_rejected_frames_are_counted() -> None:
    kept = state()
    water = WaterEstimate.not_assessable(FLAT)
    kept.add(result(Status.OK), 0.1, 1.0, FilteredWater(
        water, VISIBILITY, TrackingEvent.OUTLIER, 200, 3, 1))
    finding = kept.diagnose("", 0)
    assert finding.level == OK
    assert finding.values["rejected by the filter"] == "3 of 200 frames"
    assert finding.values["rejected by the filter in a row"] == 1
    assert str(finding.values["filter"]) == "outlier"


def test_a_survey_says_over_what_it_rests() -> None:
    kept = state()
    water = WaterEstimate.not_assessable(FLAT)
    kept.add(result(FLAT), 0.1, 1.0)
    assert kept.diagnose("", 0).level == WARN
    survey = SurveyEstimate(water, 60, 59.0, 1.65, 2.34)
    kept.add(result(FLAT), 0.1, 1.0, FilteredWater(
        water, VISIBILITY, TrackingEvent.SURVEYED, 0, 0, 0, survey))
    finding = kept.diagnose("", 0)
    assert finding.level == OK
    assert "60 frames in 59 s, ranges from 1.65 to 2.34 m" in finding.message


def test_a_distance_that_is_not_told_has_its_reason() -> None:
    kept = state()
    kept.add(result(Status.OK, FLAT), 0.1, 1.0)
    finding = kept.diagnose("", 0)
    assert finding.level == WARN
    assert finding.message == f"the visibility distance is not assessable: {FLAT}"


def test_frames_that_were_lost_do_not_hide_why_there_is_no_water() -> None:
    kept = state()
    kept.diagnose("", 0)
    kept.refuse("dropped a frame: left image: too dark")
    assert kept.diagnose("", 0).message == "dropped a frame: left image: too dark"
    kept.add(result(FLAT), 0.1, 1.0)
    finding = kept.diagnose("", 0)
    assert finding.level == WARN
    lost = "lately dropped a frame: left image: too dark"
    assert finding.message == f"the water is not assessable: {FLAT}; {lost}"
    kept.add(result(Status.OK), 0.1, 1.0)
    assert kept.diagnose("", 0).message == lost


def test_first_frame_after_a_pause_is_no_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uw_visibility.ros.core.SILENCE", -1.0)
    kept = state()
    assert kept.silence() == "no frame was processed yet"
    kept.add(result(Status.OK), 0.1, 1.0)
    assert kept.silence() == ""


def test_frames_skipped_by_the_most_are_a_warning_with_their_share() -> None:
    kept = state()
    kept.diagnose("", 0)
    kept.add(result(Status.OK), 0.1, 1.0)
    assert kept.diagnose("", 1).level == OK
    finding = kept.diagnose("", 3)
    assert finding.level == WARN
    assert "75% of the frames are skipped" in finding.message
