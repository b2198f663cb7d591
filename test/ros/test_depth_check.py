# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The depth sensor's part of the node: its topic, its parameters, and what is said of it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import pytest

from uw_visibility.status import Status

pytest.importorskip("rclpy", reason="ROS is not installed")

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from uw_visibility.ros.core import DepthCheck
from uw_visibility.ros.parameters import NodeParameters

DEPTH = 5.0


class World:
    """A node with the check, and a sensor."""

    def __init__(self, kind: type = PoseWithCovarianceStamped) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
        self.node = Node("uw_visibility", namespace="/depth", context=self.context)
        self.made = ExitStack()
        self.check = DepthCheck(self.node, NodeParameters(self.node), self.made)
        # Fast DDS allows one type for a topic in a context.
        self.other_context = rclpy.Context()
        rclpy.init(context=self.other_context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
        self.sensor = Node("sensor", namespace="/depth", context=self.other_context)
        self.publisher = self.sensor.create_publisher(kind, "depth_sensor", 10)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.until(lambda: self.node.count_publishers("depth_sensor") == 1)

    def until(self, done: Callable[[], bool]) -> None:
        end = time.monotonic() + 20
        while not done():
            assert time.monotonic() < end, self.check.diagnose()
            self.executor.spin_once(timeout_sec=0.01)

    def connect(self) -> None:
        self.until(lambda: self.publisher.get_subscription_count() == 1)

    def sense(self, seconds: int, depth: float) -> None:
        message = PoseWithCovarianceStamped()
        message.header.stamp.sec = seconds
        message.pose.pose.position.z = -depth
        message.pose.covariance[14] = 0.01
        self.publisher.publish(message)

    def estimate(self, seconds: int) -> None:
        """Let the camera say its depth."""
        visibility = SimpleNamespace(
            depth=DEPTH, depth_stddev=2.5, depth_precision=0.1, depth_status=Status.OK)
        self.check.add_result(Time(sec=seconds), SimpleNamespace(visibility=visibility))

    def frame(self, seconds: int, depth: float) -> None:
        """Compare sensor and camera at a stamp."""
        before = self.value("comparisons")
        self.estimate(seconds)
        self.sense(seconds, depth)
        self.until(lambda: self.value("comparisons") == before + 1)

    def value(self, name: str) -> Any:
        return self.check.diagnose().values[name]

    def set(self, **values: Any) -> None:
        results = self.node.set_parameters(
            [Parameter(name.replace("__", "."), value=value) for name, value in values.items()])
        assert all(result.successful for result in results), results


@pytest.fixture
def make_world(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., World]]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    worlds: list[World] = []

    def make(*arguments: Any) -> World:
        worlds.append(World(*arguments))
        return worlds[-1]

    yield make
    for world in worlds:
        world.executor.shutdown()
        world.made.close()
        for node in (world.node, world.sensor):
            node.destroy_node()
        world.context.try_shutdown()
        world.other_context.try_shutdown()


@pytest.mark.parametrize(("name", "value"), [
    ("sensor_offset", -4.0), ("sensor_sign", "down"), ("density", 1000.0),
    ("surface_pressure", 100000.0),
])
def test_sensor_that_is_read_otherwise_is_learned_anew(
    make_world: Callable[..., World], name: str, value: Any
) -> None:
    world = make_world()
    world.connect()
    for seconds in range(100, 110):
        world.frame(seconds, 9.0)
    assert float(world.value("learned bias (m)")) == pytest.approx(4.0, abs=0.1)
    world.set(plausibility__max_gate=3.0)
    assert world.value("comparisons") == 10
    world.set(**{f"plausibility__{name}": value})
    assert (world.value("comparisons"), world.value("learned bias (m)")) == (0, "")
    # What it says now is no jump.
    for seconds in range(110, 120):
        world.frame(seconds, -9.0 if name == "sensor_sign" else 9.0)
    assert world.value("verdict") == "ok"
    learned = 0.0 if name == "sensor_offset" else 4.0
    assert float(world.value("learned bias (m)")) == pytest.approx(learned, abs=0.1)


def test_sensor_of_another_type_is_told_with_the_parameter(
    make_world: Callable[..., World]
) -> None:
    world = make_world(PointStamped)
    # Its name may become known after it.
    world.until(lambda: world.check.diagnose().message == (
        "stale: no depth_sensor yet, /depth/depth_sensor has 1 publisher, "
        "/depth/sensor publishes geometry_msgs/msg/PointStamped, "
        "expected geometry_msgs/msg/PoseWithCovarianceStamped: set plausibility.sensor_type"
    ))


def test_sensor_on_another_clock_is_not_called_silent(make_world: Callable[..., World]) -> None:
    world = make_world()
    world.connect()
    world.until(lambda: "1 publisher, from which nothing" in world.check.diagnose().message)
    for seconds in range(100, 103):
        world.estimate(seconds)
        world.sense(seconds + 10**9, DEPTH)
    world.until(lambda: world.value("estimates without a sensor value") == 3)
    assert world.check.diagnose().message == (
        "stale: no depth_sensor value at the stamps of the images: are both on one clock?"
    )
    # Its stamp stands still.
    world.sense(102 + 10**9, DEPTH)
    world.until(lambda: world.value("sensor values with a repeated or older stamp") == 1)
