# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Client of the node: sends messages to it at their times, and collects its answers."""

from __future__ import annotations

import functools
import math
import struct
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from uw_visibility.messages.stamps import CDR_STAMP, SECOND, header_stamp, stamp_format
from uw_visibility.ros.transport.factory import message_type
from uw_visibility_lab.demonstration.node_process import NodeDied

Check = Callable[[], None]
"""Called repeatedly; raises an exception to stop the work."""

ANSWER = "disparity"
"""Topic of the node's answer to every frame, whether the water is assessable or not."""

START_TIMEOUT = 900.0
"""Limit of the node's start in s: it may have to compile its kernels, on a busy machine."""

PROBE_INTERVAL = 10.0
DRAIN_TIMEOUT = 15.0
POLL = 0.2


class Player:
    """Publisher of serialised messages.

    topics: type of message by topic. Every type begins with a header.
    reliability: by default reliable, so that an image of many packets arrives completely.
    """

    def __init__(
        self,
        node: Node,
        topics: Mapping[str, str],
        reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE,
    ) -> None:
        self._node = node
        # Deep enough for both images while a slow machine sends them.
        qos = QoSProfile(depth=10, reliability=reliability)
        self._publishers = {
            topic: node.create_publisher(message_type(name), topic, qos)
            for topic, name in topics.items()
        }

    def unheard(self) -> list[str]:
        """Return the topics without subscribers."""
        return [t for t, p in self._publishers.items() if p.get_subscription_count() == 0]

    def publish(self, messages: Mapping[str, bytes]) -> int:
        """Publish messages of one instant, stamped with the present time.

        Returns the stamp in ns, the same for all.
        """
        stamp = time.time_ns()
        for topic, data in messages.items():
            self._publishers[topic].publish(with_stamp(data, stamp))
        return stamp


def with_stamp(data: bytes, stamp: int) -> bytes:
    """Return a message with its header stamp replaced, ns."""
    changed = bytearray(data)
    struct.pack_into(stamp_format(data), changed, CDR_STAMP, *divmod(stamp, SECOND))
    return bytes(changed)


class Answer(NamedTuple):
    """The node's answer to one frame."""

    messages: Mapping[str, Any]  # by topic; empty if the node did not answer
    latency: float  # from the stamp to the arrival of the last of them in ms


class Collector:
    """Subscriber that keeps every message with the time of its arrival.

    Every type begins with a header.
    Messages are deserialised later, to take no time from the node that is being
    measured.
    """

    def __init__(self, node: Node, topics: Mapping[str, str]) -> None:
        self._topics = dict(topics)
        # Times of arrival (ns since 1970) and serialised messages, by stamp and topic.
        self._arrivals: dict[int, dict[str, tuple[int, bytes]]] = defaultdict(dict)
        self._news = threading.Condition()
        qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        for topic, name in topics.items():
            node.create_subscription(
                message_type(name), topic, functools.partial(self._keep, topic), qos, raw=True
            )

    def wait(self, topic: str, stamp: int, timeout: float) -> bool:
        """Wait for a topic's message of that stamp or a later one; False if none comes.

        stamp: stamp in ns.
        timeout: in s.
        """
        def arrived() -> bool:
            return any(
                topic in found for given, found in self._arrivals.items() if given >= stamp)

        with self._news:
            return self._news.wait_for(arrived, timeout)

    def answer(self, stamp: int) -> Answer:
        """Return the answer that has arrived for a stamp in ns."""
        with self._news:
            arrivals = dict(self._arrivals[stamp])
        last = max((time for time, _ in arrivals.values()), default=None)
        return Answer(
            {topic: deserialize_message(data, message_type(self._topics[topic]))
             for topic, (_, data) in arrivals.items()},
            math.nan if last is None else (last - stamp) * 1e-6)

    def _keep(self, topic: str, data: bytes) -> None:
        now = time.time_ns()
        with self._news:
            self._arrivals[header_stamp(data)][topic] = (now, data)
            self._news.notify_all()


def wait_until_ready(
    check: Check, player: Player, collector: Collector, probe: Mapping[str, bytes]
) -> None:
    """Wait until the node has answered a first frame, which does not count."""
    end = time.monotonic() + START_TIMEOUT

    def go_on(what: str) -> None:
        check()
        if time.monotonic() > end:
            raise NodeDied(f"the node has not {what} within {START_TIMEOUT:.0f} s")

    while {"/left/image_rect", "/right/image_rect"} & set(player.unheard()):
        go_on("subscribed to the images")
        time.sleep(POLL)
    stamp = player.publish(probe)
    sent = time.monotonic()
    while not collector.wait(ANSWER, stamp, POLL):
        go_on("answered a frame")
        if time.monotonic() > sent + PROBE_INTERVAL:
            # The node's best-effort subscriptions may have missed the one before.
            player.publish(probe)
            sent = time.monotonic()
    # Wait for the answer to a later probe, too, before the transect begins.
    collector.wait(ANSWER, stamp + 1, 2.0)


def play(
    check: Check, player: Player, collector: Collector,
    frames: Iterable[tuple[float, Mapping[str, bytes]]],
) -> list[Answer]:
    """Play frames at their times, s; return the node's answers."""
    start = time.monotonic()
    stamps = []
    for due, messages in frames:
        time.sleep(max(start + due - time.monotonic(), 0.0))
        check()
        stamps.append(player.publish(messages))
    collector.wait(ANSWER, stamps[-1], DRAIN_TIMEOUT)
    # Other messages of the last frame arrive on their own topics.
    time.sleep(2 * POLL)
    check()
    return [collector.answer(stamp) for stamp in stamps]


@contextmanager
def open_link(
    domain: int, played: Mapping[str, str], collected: Mapping[str, str]
) -> Iterator[tuple[Player, Collector]]:
    """Join a ROS domain with a player and a collector while the context lasts.

    played, collected: types of message by topic.
    Yields the player and the collector, which receives in a thread of its own.
    """
    context = rclpy.Context()
    # The command handles signals, since Ctrl-C must end more than ROS.
    rclpy.init(
        args=[], context=context, domain_id=domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    node = rclpy.create_node("uw_visibility_demo", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    ending = Future()
    thread = threading.Thread(
        target=executor.spin_until_future_complete, args=(ending,), name="collector", daemon=True
    )
    try:
        player, collector = Player(node, played), Collector(node, collected)
        thread.start()
        yield player, collector
    finally:
        # The thread must end before the executor is destroyed.
        ending.set_result(None)
        if thread.is_alive():
            thread.join()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
