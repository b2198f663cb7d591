# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Client of the node: plays messages into it, and collects its outputs."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from uw_visibility.messages.stamps import header_stamp, with_stamp
from uw_visibility.ros.transport.factory import message_type


class Player:
    """Publisher of serialised messages.

    topics: type of message by topic. Every type begins with a header.
    reliability: by default reliable, so that an image of many packets arrives whole.
    """

    def __init__(
        self,
        node: Node,
        topics: Mapping[str, str],
        reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE,
    ) -> None:
        self._node = node
        # Deep enough to hold both images while a slow machine sends them.
        qos = QoSProfile(depth=10, reliability=reliability)
        self._publishers = {
            topic: node.create_publisher(message_type(name), topic, qos)
            for topic, name in topics.items()
        }

    def unheard(self) -> list[str]:
        """Return the topics that nobody subscribes to yet."""
        return [t for t, p in self._publishers.items() if p.get_subscription_count() == 0]

    def publish(self, messages: Mapping[str, bytes]) -> int:
        """Publish messages of one instant, stamped with the present time.

        Returns the stamp in ns, the same for all.
        """
        stamp = time.time_ns()
        for topic, data in messages.items():
            self._publishers[topic].publish(with_stamp(data, stamp))
        return stamp


class Arrival(NamedTuple):
    """Received message with the time of its arrival."""

    time: int  # when it came, in ns since 1970
    data: bytes  # the serialised message


class Collector:
    """Collector: subscribes to topics and keeps every message with the time of its arrival.

    Every type begins with a header.
    Messages stay serialised while they come in: that takes no time from the
    node that is being measured.
    """

    def __init__(self, node: Node, topics: Mapping[str, str]) -> None:
        self._topics = dict(topics)
        self._arrivals: dict[str, list[Arrival]] = {topic: [] for topic in topics}
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
            return any(header_stamp(a.data) >= stamp for a in self._arrivals[topic])

        with self._news:
            return self._news.wait_for(arrived, timeout)

    def by_stamp(self) -> dict[int, dict[str, Arrival]]:
        """Return the arrivals by stamp (ns), then topic."""
        frames: dict[int, dict[str, Arrival]] = {}
        with self._news:
            for topic, arrivals in self._arrivals.items():
                for arrival in arrivals:
                    frames.setdefault(header_stamp(arrival.data), {})[topic] = arrival
        return frames

    def read(self, topic: str, arrival: Arrival) -> Any:
        """Return the message of an arrival."""
        return deserialize_message(arrival.data, message_type(self._topics[topic]))

    def _keep(self, topic: str, data: bytes) -> None:
        now = time.time_ns()
        with self._news:
            self._arrivals[topic].append(Arrival(now, data))
            self._news.notify_all()


@contextmanager
def open_link(
    domain: int, played: Mapping[str, str], collected: Mapping[str, str]
) -> Iterator[tuple[Player, Collector]]:
    """Join a ROS domain with a player and a collector, as long as the context lasts.

    played, collected: types of message by topic.
    Yields `player`, player; `collector`, receives in a thread of its own.
    """
    context = rclpy.Context()
    # The command handles signals: Ctrl-C ends more than ROS.
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
