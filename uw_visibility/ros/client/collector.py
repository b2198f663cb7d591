# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Collector of another node's messages, with the times of their arrival."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from uw_visibility.messages.stamps import header_stamp
from uw_visibility.ros.transport.factory import message_type

UNSTAMPED = ("std_msgs/msg/Float64",)


class Arrival(NamedTuple):
    """Received message with the time of its arrival.

    Attributes
    ----------
    time : int
        When it came, in ns since 1970.
    data : bytes
        The serialised message.
    """

    time: int
    data: bytes


class Collector:
    """Collector: subscribes to topics and keeps every message with the time of its arrival.

    Messages stay serialised while they come in: that takes no time from the
    node that is being measured.

    Parameters
    ----------
    node : rclpy.node.Node
        Subscriptions are made on it; somebody has to spin it.
    topics : mapping of str to str
        Type of message by topic.
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

        Parameters
        ----------
        topic : str
            A topic whose messages have headers.
        stamp : int
            Stamp in ns.
        timeout : float
            In s.
        """
        def arrived() -> bool:
            return any(header_stamp(a.data) >= stamp for a in self._arrivals[topic])

        with self._news:
            return self._news.wait_for(arrived, timeout)

    def by_stamp(self) -> dict[int, dict[str, Arrival]]:
        """Return the arrivals by stamp (ns), then topic.

        A message without a header belongs to the frame whose messages came in
        nearest to it: the node publishes a frame's messages in one go.
        """
        with self._news:
            arrivals = {topic: list(kept) for topic, kept in self._arrivals.items()}
        frames: dict[int, dict[str, Arrival]] = {}
        unstamped = [t for t, name in self._topics.items() if name in UNSTAMPED]
        for topic in self._topics.keys() - set(unstamped):
            for arrival in arrivals[topic]:
                frames.setdefault(header_stamp(arrival.data), {})[topic] = arrival
        moments = [(a.time, stamp) for stamp, frame in frames.items() for a in frame.values()]
        for topic in unstamped:
            for arrival in arrivals[topic]:
                near = [(abs(moment - arrival.time), stamp) for moment, stamp in moments]
                if near:
                    frames[min(near)[1]][topic] = arrival
        return frames

    def read(self, topic: str, arrival: Arrival) -> Any:
        """Return the message of an arrival."""
        return deserialize_message(arrival.data, message_type(self._topics[topic]))

    def _keep(self, topic: str, data: bytes) -> None:
        now = time.time_ns()
        with self._news:
            self._arrivals[topic].append(Arrival(now, data))
            self._news.notify_all()
