# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the stereo input says of two cameras: late, lossy, of another period."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

import rclpy
from builtin_interfaces.msg import Time
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image

from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.ros import inputs as module
from uw_visibility.ros.inputs import StereoInput
from uw_visibility.ros.monitor import ERROR, OK, WARN, Finding
from uw_visibility.ros.parameters import NodeParameters

SIDES = "left", "right"
# Of both cameras, ms.
PERIOD = 100


class World:
    """A node with the input, and two cameras."""

    def __init__(self, **given: Any) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
        overrides = [
            Parameter(name.replace("__", "."), value=value) for name, value in given.items()]
        self.node = Node(
            "uw_visibility", namespace="/inputs", context=self.context,
            parameter_overrides=overrides)
        self.frames: list[Any] = []
        self.input = StereoInput(
            self.node, NodeParameters(self.node), self.frames.append, lambda: None)
        self.input.rest(False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.publishers = {
            topic: self.node.create_publisher(kind, topic, 10)
            for side in SIDES
            for topic, kind in ((f"{side}/image_rect", Image), (f"{side}/camera_info", CameraInfo))
        }

    def until(self, done: Callable[[], bool]) -> None:
        end = time.monotonic() + 20
        while not done():
            assert time.monotonic() < end, self.input.diagnose()
            self.executor.spin_once(timeout_sec=0.01)

    def set(self, **values: Any) -> None:
        self.node.set_parameters(
            [Parameter(name.replace("__", "."), value=value) for name, value in values.items()])

    def connect(self) -> None:
        """Let the node hear the cameras, and know their CameraInfo."""
        def reliable() -> bool:
            self.input.update_qos()
            values = self.input.diagnose().values
            return {values[f"reliability of {side}/image_rect"] for side in SIDES} == {"reliable"}

        self.until(reliable)
        self.until(
            lambda: {p.get_subscription_count() for p in self.publishers.values()} == {1})
        for side in SIDES:
            self.publishers[f"{side}/camera_info"].publish(CameraInfo())
        self.until(lambda: self.count("left info received", "right info received") == 2)

    def count(self, *names: str) -> int:
        values = self.input.diagnose().values
        return sum(values[name] for name in names)

    def image(self, side: str, number: int) -> None:
        """Take an image, and wait until the input has it."""
        before = self.count(f"{side} received")
        self.publish(side, number)
        self.until(lambda: self.count(f"{side} received") == before + 1)

    def pair(self, number: int) -> None:
        for side in SIDES:
            self.image(side, number)

    def publish(self, side: str, number: int) -> None:
        message = Image()
        message.header.stamp.sec = 100 + number * PERIOD // 1000
        message.header.stamp.nanosec = number * PERIOD % 1000 * 1_000_000
        self.publishers[f"{side}/image_rect"].publish(message)

    @property
    def gaps(self) -> list[int]:
        """Gaps of the frames, ms."""
        stamps = [
            [stamp_to_nanoseconds(message.header.stamp) for message in frame[:2]]
            for frame in self.frames]
        return [(left - right) // 1_000_000 for left, right in stamps]

    def said(self) -> Finding:
        return self.input.diagnose()


@pytest.fixture
def make_world(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., World]]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    worlds: list[World] = []

    def make(active: bool = True, **given: Any) -> World:
        world = World(**given)
        worlds.append(world)
        if active:
            world.input.activate()
        world.connect()
        return world

    yield make
    for world in worlds:
        world.executor.shutdown()
        world.node.destroy_node()
        world.context.try_shutdown()


@pytest.mark.parametrize(("later", "earlier", "tolerance"), [
    ("right", "left", 0.0), ("left", "right", 0.05),
])
def test_camera_that_is_later_than_the_queue_is_long_is_told_with_the_remedy(
    make_world: Callable[..., World], monkeypatch: pytest.MonkeyPatch, later: str, earlier: str,
    tolerance: float,
) -> None:
    monkeypatch.setattr(module, "SILENCE", 1.0)
    world = make_world(synchronization__queue_size=3, synchronization__tolerance=tolerance)
    for number in range(20):
        world.image(earlier, number)
        if number in (17, 18):
            time.sleep(0.6)
        if number >= 8:
            world.image(later, number - 8)
    assert world.frames == []
    finding = world.said()
    assert (finding.level, finding.message) == (ERROR, (
        f"{later} images arrive 8 images after the {earlier} ones: "
        "raise synchronization.queue_size, which is 3"
    ))
    world.set(synchronization__queue_size=9)
    for number in range(20, 30):
        world.image(earlier, number)
        world.image(later, number - 8)
    assert len(world.frames) >= 5
    assert set(world.gaps) == {0}


def test_pairs_of_different_moments_are_told(make_world: Callable[..., World]) -> None:
    world = make_world(synchronization__tolerance=0.15)
    for number in range(4):
        world.pair(number)
    assert world.said().level == OK
    assert world.said().values["stamp gap (s)"] == "0.000000"
    # The left image 4 is lost.
    for side, number in (("right", 4), ("left", 5), ("right", 5)):
        world.image(side, number)
    finding = world.said()
    assert (finding.level, finding.values["stamp gap (s)"]) == (WARN, "0.100000")
    assert finding.message == (
        "left and right images are paired 0.1 s apart, more than half of their period: trigger "
        "both cameras together, and set synchronization.tolerance below 0.05 s"
    )
    for number in range(6, 16):
        world.pair(number)
    assert world.gaps == [0, 0, 0, 0, 100, *10 * [0]]
    assert "dropped right image unmatched" in world.said().message


def test_frames_are_not_missed_before_they_are_due(
    make_world: Callable[..., World], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SILENCE", 0.5)
    world = make_world()

    world.pair(0)
    world.input.active = False
    # The cameras go on meanwhile; a node that is not active takes no images.
    time.sleep(0.6)
    for side in SIDES:
        world.publish(side, 1)
    world.until(lambda: " any more" not in world.input.silence())
    world.input.activate()
    assert world.input.silence() == ""
    world.pair(2)
    assert len(world.frames) == 2
    # Both pause, and one comes back first.
    time.sleep(0.6)
    world.image("left", 3)
    assert "no right/image_rect any more" in world.input.silence()
    world.image("right", 4)
    assert world.input.silence() == ""


def test_slow_camera_is_not_silent_before_its_next_image(
    make_world: Callable[..., World], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SILENCE", 1.0)
    world = make_world()
    for number in (0, 10, 20):
        world.pair(number)
        for _ in range(7):
            assert world.input.silence() == ""
            time.sleep(0.1)
        monkeypatch.setattr(module, "SILENCE", 0.1)
    time.sleep(1.0)
    assert "no left/image_rect any more" in world.input.silence()


def test_simulated_time_without_a_clock_is_told(make_world: Callable[..., World]) -> None:
    world = make_world(use_sim_time=True)

    world.pair(0)
    finding = world.said()
    assert finding.level == WARN
    assert finding.message == (
        "use_sim_time is true, but nothing arrives on /clock: start what publishes it")
    clock = world.node.create_publisher(Clock, "/clock", 10)
    world.until(lambda: clock.get_subscription_count() == 1)
    clock.publish(Clock(clock=Time(sec=100)))
    world.until(lambda: world.said().level == OK)


def test_camera_info_of_before_a_rest_is_used(make_world: Callable[..., World]) -> None:
    world = make_world()
    for number in (0, 1):
        world.pair(number)
        assert (len(world.frames), world.input.silence()) == (number + 1, "")
        world.input.rest(True)
        world.input.rest(False)
        assert "no left/image_rect yet" in world.input.silence()
        world.until(lambda: world.input.update_qos() or all(
            world.publishers[f"{side}/image_rect"].get_subscription_count() == 1
            for side in SIDES))


def test_camera_info_that_was_sent_before_and_kept_is_received(
    make_world: Callable[..., World]
) -> None:
    world = make_world()
    world.input.rest(True)
    infos = [f"{side}/camera_info" for side in SIDES]

    def received(kept: bool, before: int) -> bool:
        world.input.update_qos()
        for topic in [] if kept else infos:
            world.publishers[topic].publish(CameraInfo())
        return world.count("left info received", "right info received") >= before + 2

    for durability in (DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE):
        before = world.count("left info received", "right info received")
        for topic in infos:
            world.node.destroy_publisher(world.publishers[topic])
            profile = QoSProfile(depth=1, durability=durability)
            world.publishers[topic] = world.node.create_publisher(CameraInfo, topic, profile)
            world.publishers[topic].publish(CameraInfo())
        world.input.rest(False)
        kept = durability is DurabilityPolicy.TRANSIENT_LOCAL
        world.until(lambda kept=kept, before=before: received(kept, before))
