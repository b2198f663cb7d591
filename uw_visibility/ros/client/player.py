# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Player of recorded messages, stamped with the present time."""

from __future__ import annotations

import time
from collections.abc import Mapping

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from uw_visibility.messages.stamps import with_stamp
from uw_visibility.ros.transport.factory import message_type


class Player:
    """Publisher of serialised messages.

    Parameters
    ----------
    node : rclpy.node.Node
        Publishers are made on it.
    topics : mapping of str to str
        Type of message by topic. Every type begins with a header.
    reliability : ReliabilityPolicy
        By default reliable, so that an image of many packets arrives whole.
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

        Returns
        -------
        int
            The stamp in ns, the same for all.
        """
        stamp = time.time_ns()
        for topic, data in messages.items():
            self._publishers[topic].publish(with_stamp(data, stamp))
        return stamp
