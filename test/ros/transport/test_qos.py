# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A subscription follows what its publishers offer: nothing twice, and nothing lost between."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage

from uw_visibility.ros.transport.qos import AdaptiveReliabilitySubscription

BEST_EFFORT, RELIABLE = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE


class World:
    """A node that subscribes and one that publishes."""

    def __init__(self, *arguments: str) -> None:
        self.context = rclpy.Context()
        rclpy.init(args=list(arguments), context=self.context)
        self.listener = Node("listener", context=self.context)
        self.speaker = Node("speaker", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.listener)
        self.stamps: list[int] = []
        self.subscription = AdaptiveReliabilitySubscription(
            self.listener, CameraInfo, "info", lambda m: self.stamps.append(m.header.stamp.sec),
            depth=3,
        )

    def publisher(self, reliability: ReliabilityPolicy) -> Any:
        before = self.listener.count_publishers("info")
        publisher = self.speaker.create_publisher(
            CameraInfo, "info", QoSProfile(depth=10, reliability=reliability)
        )
        self.until(lambda: self.listener.count_publishers("info") == before + 1)
        return publisher

    def heard(self) -> Any:
        """Make a publisher that is heard by a reliable subscription alone."""
        publisher = self.publisher(RELIABLE)
        self.adapt("reliable")
        self.until(lambda: publisher.get_subscription_count() == 1)
        return publisher

    def until(self, done: Callable[[], bool]) -> None:
        end = time.monotonic() + 20
        while not done():
            assert time.monotonic() < end
            self.executor.spin_once(timeout_sec=0.01)

    def readers(self) -> int:
        return len(self.listener.get_subscriptions_info_by_topic("info"))

    def send(self, publisher: Any, *stamps: int) -> None:
        for stamp in stamps:
            message = CameraInfo()
            message.header.stamp.sec = stamp
            publisher.publish(message)

    def adapt(self, reliability: str) -> None:
        self.subscription.update_qos()
        self.until(
            lambda: self.subscription.update_qos() or self.subscription.reliability == reliability)
        self.until(lambda: self.readers() == 1)


@pytest.fixture
def make_world(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., World]]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    worlds: list[World] = []

    def make(*arguments: str) -> World:
        worlds.append(World(*arguments))
        return worlds[-1]

    yield make
    for world in worlds:
        world.subscription.destroy()
        assert world.readers() == 0
        world.executor.shutdown()
        for node in (world.listener, world.speaker):
            node.destroy_node()
        world.context.try_shutdown()


def test_messages_that_find_no_room_are_counted(make_world: Callable[..., World]) -> None:
    world = make_world()
    publisher = world.heard()
    world.send(publisher, 1)
    world.until(lambda: world.stamps == [1])
    # Of these as many wait as the queue is deep.
    world.send(publisher, *range(2, 10))
    time.sleep(0.2)
    world.send(publisher, 10)
    world.until(lambda: world.stamps[-1] == 10)
    assert len(world.stamps) + world.subscription.lost == 10
    assert world.subscription.lost >= 5
    # Another publisher begins its numbers anew, and two cannot be told apart.
    lost = world.subscription.lost
    other = world.publisher(RELIABLE)
    world.until(lambda: other.get_subscription_count() == 1)
    for stamp, each in ((11, other), (12, publisher), (13, other)):
        world.send(each, stamp)
        world.until(lambda s=stamp: world.stamps[-1] == s)
    assert world.subscription.lost == lost


def test_it_is_reliable_while_all_publishers_are(make_world: Callable[..., World]) -> None:
    world = make_world()
    assert world.subscription.reliability == "best effort"
    reliable = world.heard()
    world.send(reliable, 1)
    world.until(lambda: world.stamps == [1])
    # A reliable subscription would not hear this one.
    other = world.publisher(BEST_EFFORT)
    world.adapt("best effort")
    for publisher in (reliable, other):
        world.until(lambda p=publisher: p.get_subscription_count() == 1)
    world.send(other, 2)
    world.until(lambda: world.stamps == [1, 2])
    world.send(reliable, 3)
    world.until(lambda: world.stamps == [1, 2, 3])
    world.speaker.destroy_publisher(other)
    world.until(lambda: world.listener.count_publishers("info") == 1)
    world.adapt("reliable")
    # Where nobody publishes, nobody knows who comes.
    world.speaker.destroy_publisher(reliable)
    world.until(lambda: world.listener.count_publishers("info") == 0)
    world.adapt("best effort")


def test_change_loses_nothing_and_delivers_nothing_twice(
    make_world: Callable[..., World]
) -> None:
    world = make_world()
    publisher = world.publisher(RELIABLE)
    world.until(lambda: publisher.get_subscription_count() == 1)
    world.send(publisher, 1)
    world.until(lambda: world.stamps == [1])
    world.subscription.update_qos()
    # Both subscriptions receive what follows.
    world.until(lambda: publisher.get_subscription_count() == 2)
    assert world.subscription.reliability == "best effort"
    world.send(publisher, 2, 3, 4)
    world.until(lambda: publisher.get_subscription_count() == 1 and 4 in world.stamps)
    assert world.subscription.reliability == "reliable"
    world.send(publisher, 5)
    world.until(lambda: 5 in world.stamps)
    assert world.stamps == [1, 2, 3, 4, 5]


def test_stamps_that_a_publisher_repeats_are_passed_on(make_world: Callable[..., World]) -> None:
    # To say so is the synchronizer's.
    world = make_world()
    publisher = world.heard()
    world.send(publisher, 0, 0)
    world.until(lambda: len(world.stamps) == 2)
    world.send(publisher, 7, 7)
    world.until(lambda: world.stamps == [0, 0, 7, 7])


def test_recording_that_is_played_again_is_delivered_again(
    make_world: Callable[..., World]
) -> None:
    world = make_world()
    for times in (1, 2, 3):
        publisher = world.heard()
        world.send(publisher, 1, 2, 3)
        world.until(lambda n=times: len(world.stamps) == 3 * n)
        world.speaker.destroy_publisher(publisher)
        world.until(lambda: world.listener.count_publishers("info") == 0)
        world.adapt("best effort")
    assert world.stamps == 3 * [1, 2, 3]


def test_publisher_that_is_not_heard_is_named_with_its_reason(
    make_world: Callable[..., World]
) -> None:
    world = make_world("--ros-args", "-p", "qos_overrides./info.subscription.reliability:=reliable")
    assert world.subscription.describe_publishers() == "/info has no publisher"
    publisher = world.publisher(RELIABLE)
    assert "/info has 1 publisher, from which nothing" in world.subscription.describe_publishers()
    world.speaker.destroy_publisher(publisher)
    world.until(lambda: world.listener.count_publishers("info") == 0)
    world.publisher(BEST_EFFORT)
    said = world.subscription.describe_publishers()
    assert said == (
        "/info has 1 publisher, the QoS of /speaker is not compatible: "
        "Best effort publisher and reliable subscription"
    )


def test_topics_that_are_exchanged_by_remapping_are_not_mixed_up(
    make_world: Callable[..., World]
) -> None:
    world = make_world("--ros-args", "-r", "listener:info:=other", "-r", "listener:other:=info")
    world.speaker.create_publisher(CameraInfo, "other", QoSProfile(depth=10, reliability=RELIABLE))
    world.until(lambda: world.subscription.describe_publishers() == (
        "/other has 1 publisher, from which nothing arrives"))
    world.adapt("reliable")


def test_publisher_of_another_type_is_named_and_not_followed(
    make_world: Callable[..., World]
) -> None:
    world = make_world()
    # Fast DDS allows one type for a topic in a context.
    context = rclpy.Context()
    rclpy.init(context=context)
    stranger = Node("stranger", context=context)
    stranger.create_publisher(CompressedImage, "info", QoSProfile(depth=1, reliability=BEST_EFFORT))
    # Its name may become known after it.
    world.until(lambda: world.subscription.describe_publishers() == (
        "/info has 1 publisher, /stranger publishes sensor_msgs/msg/CompressedImage, "
        "expected sensor_msgs/msg/CameraInfo: remap the topic, or set image_transport"
    ))
    world.publisher(RELIABLE)
    world.adapt("reliable")
    stranger.destroy_node()
    context.try_shutdown()


@pytest.mark.parametrize("asked, there, transport", [
    ("camera", "camera/compressed", "compressed"), ("camera/compressed", "camera", "raw")])
def test_images_that_come_in_the_other_transport_are_named(
    make_world: Callable[..., World], asked: str, there: str, transport: str
) -> None:
    world = make_world("--ros-args", "-r", f"info:={asked}")
    world.speaker.create_publisher(CompressedImage, there, 10)
    world.until(lambda: world.listener.count_publishers(there) == 1)
    assert world.subscription.describe_publishers().startswith(
        f"/{asked} has no publisher, but /{there} has: set image_transport to {transport},")


@pytest.mark.parametrize("wish", ["best_effort", "reliable"])
def test_what_the_user_asks_for_stays(make_world: Callable[..., World], wish: str) -> None:
    world = make_world(
        "--ros-args", "-p", f"qos_overrides./info.subscription.reliability:={wish}"
    )
    for reliability in (RELIABLE, BEST_EFFORT):
        world.publisher(reliability)
        world.subscription.update_qos()
        assert (world.readers(), world.subscription.reliability) == (1, wish.replace("_", " "))


def test_only_the_newest_of_a_burst_wait(make_world: Callable[..., World]) -> None:
    world = make_world()
    publisher = world.heard()
    world.send(publisher, *range(1, 9))
    time.sleep(0.3)
    world.until(lambda: 8 in world.stamps)
    assert world.stamps == [6, 7, 8]
