# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""QoS of publishers and subscriptions, which parameters can override.

Subscriptions to images are reliable if all publishers of the topic are.
"""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.qos import (
    QoSCompatibility,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from uw_visibility.errors import LONGEST_MESSAGE, printable, refusing
from uw_visibility.messages.images import stamp_to_nanoseconds

QOS_PREFIX = "qos_overrides."
OUTPUT_DEPTH = 10
# For small messages, some at high rates.
INPUT_DEPTH = 10
# A reliable subscription holds images back behind an incomplete one until the queue is full,
# and then gives the incomplete one up: this depth limits the delay.
IMAGE_DEPTH = 5
POLICIES = (
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY,
)
# Messages that are remembered, to detect those that two subscriptions have both received.
REMEMBERED = 20


def publish_on(node: Node, kind: type, topic: str) -> Any:
    """Create a reliable publisher.

    Raises `InputError` if a parameter under ``qos_overrides`` cannot be used.
    """
    qos = QoSProfile(depth=OUTPUT_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
    return _with_overrides(node.create_publisher, kind, topic, qos)


def subscribe_to(
    node: Node, kind: type, topic: str, callback: Callable[[Any], None],
    depth: int = INPUT_DEPTH,
    **adapted: Any,
) -> Any:
    """Create a subscription for sensor data.

    depth: depth of the queue, unless ``qos_overrides`` sets it.
    **adapted: reliability or durability that the publishers allow; those in ``qos_overrides`` take
        precedence.
    """
    # rclpy writes overrides into the profile.
    qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
    for name, policy in adapted.items():
        setattr(qos, name, type(policy).BEST_AVAILABLE)

    def settle(overridden: QoSProfile) -> SetParametersResult:
        for name, policy in adapted.items():
            if getattr(overridden, name) is type(policy).BEST_AVAILABLE:
                setattr(overridden, name, policy)
        return SetParametersResult(successful=True)

    return _with_overrides(node.create_subscription, kind, topic, callback, qos, settle=settle)


def offered(node: Node, topic: str, kind: type) -> list[QoSProfile]:
    """Return the QoS of a topic's publishers of a type; from others nothing arrives.

    topic: name before remapping, which rclpy applies to it.
    """
    publishers = node.get_publishers_info_by_topic(topic)
    return [info.qos_profile for info in publishers if info.topic_type == type_name(kind)]


def describe_publishers(
    node: Node, topic: str, subscription: Any, remedy: str = "remap the topic"
) -> str:
    """Describe the publishers of a subscription's topic, and any mismatch of type or QoS.

    topic: name before remapping, which rclpy applies to it.
    remedy: what to do if messages have another type.
    """
    name = subscription.topic_name
    publishers = node.get_publishers_info_by_topic(topic)
    if not publishers:
        return f"{name} has no publisher"
    text = f"{name} has {len(publishers)} publisher{'s' * (len(publishers) > 1)}"
    expected = type_name(subscription.msg_type)
    for info in publishers:
        publisher = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        if info.topic_type != expected:
            other = f"{publisher} publishes {info.topic_type}, expected {expected}: {remedy}"
            return printable(f"{text}, {other}", LONGEST_MESSAGE)
        compatibility, reason = qos_check_compatible(info.qos_profile, subscription.qos_profile)
        if compatibility == QoSCompatibility.ERROR:
            why = reason.removeprefix("ERROR: ").rstrip("; ")
            return printable(f"{text}, the QoS of {publisher} is not compatible: {why}")
    return f"{text}, from which nothing arrives"


def type_name(kind: type) -> str:
    """Return the name of a message's type, such as ``sensor_msgs/msg/Image``."""
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


def _with_overrides(
    create: Callable[..., Any],
    *arguments: Any,
    settle: Callable[[QoSProfile], SetParametersResult] | None = None,
) -> Any:
    options = QoSOverridingOptions(POLICIES, callback=settle)
    with refusing(
        f"topic {arguments[1]} cannot be made with its qos_overrides and remapping",
        InvalidQosOverridesError, InvalidParameterTypeException, RuntimeError,
    ):
        return create(*arguments, qos_overriding_options=options)


class AdaptiveReliabilitySubscription:
    """Subscription that is reliable if all publishers of the topic are, otherwise best effort.

    Middleware cuts images into fragments, and a best-effort subscription loses the
    whole image with any of them; a reliable one receives nothing from best-effort
    publishers. When the publishers change, a second subscription is made beside the
    present one and replaces it at the first message that it receives, so that there is
    no gap between the two and no message is delivered by both. A reliability in
    ``qos_overrides`` is kept.

    kind: class of the messages, which have a header.
    depth: depth of the queue.
    lost: messages that were published but not delivered, by the sequence numbers of a single
        publisher; 0 with middleware without these.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, callback: Callable[[Any], None],
        depth: int,
    ) -> None:
        self._node = node
        self._kind = kind
        self._topic = topic
        self._callback = callback
        self._depth = depth
        self.lost = 0
        self._made = 0
        # Number of the subscription and sequence number of the last message.
        self._last: tuple[int, int | None] = (0, None)
        # Number of the subscription, stamp and time of publication of the last messages.
        self._delivered: deque[tuple[int, tuple[int, int]]] = deque(maxlen=REMEMBERED)
        # Subscriptions by their number: the present one, then its successor.
        self._subscriptions: dict[int, Any] = {}
        self._subscribe(ReliabilityPolicy.BEST_EFFORT)
        name = f"{QOS_PREFIX}{self._present.topic_name}.subscription.reliability"
        best_available = ReliabilityPolicy.BEST_AVAILABLE.name.lower()
        # Whether no parameter sets the reliability.
        self._adaptive = node.get_parameter(name).value == best_available

    @property
    def reliability(self) -> str:
        """Reliability of the present subscription, in words."""
        return str(self._present.qos_profile.reliability.name).lower().replace("_", " ")

    def update_qos(self) -> None:
        """Adapt the reliability to the publishers; called by a timer."""
        if not self._adaptive:
            return
        found = {qos.reliability for qos in offered(self._node, self._topic, self._kind)}
        best = ReliabilityPolicy.BEST_EFFORT
        if found == {ReliabilityPolicy.RELIABLE}:
            best = ReliabilityPolicy.RELIABLE
        newest = max(self._subscriptions)
        if self._subscriptions[newest].qos_profile.reliability is not best:
            self._subscribe(best)
        elif not found or self._subscriptions[newest].get_publisher_count() > 0:
            # It had the time since the last call to connect, and messages may be rare.
            self._take_over(newest)

    def describe_publishers(self) -> str:
        """Describe the topic's publishers, or that the images come raw or compressed instead."""
        text = describe_publishers(
            self._node, self._topic, self._present, "remap the topic, or set image_transport")
        name = self._present.topic_name
        raw = name.removesuffix("/compressed")
        other, transport = (f"{raw}/compressed", "compressed") if name == raw else (raw, "raw")
        if self._node.count_publishers(name) == 0 < self._node.count_publishers(other):
            return (
                f"{text}, but {other} has: set image_transport to {transport}, or, if the cameras "
                "differ, convert the images of one with `ros2 run image_transport republish`")
        return text

    def destroy(self) -> None:
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.popitem()[1])

    @property
    def _present(self) -> Any:
        return self._subscriptions[min(self._subscriptions)]

    def _subscribe(self, reliability: ReliabilityPolicy) -> None:
        # A successor that has not taken over yet is replaced.
        while len(self._subscriptions) > 1:
            self._node.destroy_subscription(self._subscriptions.popitem()[1])
        self._made += 1
        self._subscriptions[self._made] = subscribe_to(
            self._node, self._kind, self._topic,
            functools.partial(self._deliver, self._made), self._depth, reliability=reliability,
        )

    def _take_over(self, number: int) -> None:
        for other in [other for other in self._subscriptions if other < number]:
            self._node.destroy_subscription(self._subscriptions.pop(other))

    def _deliver(self, number: int, message: Any, info: dict[str, Any]) -> None:
        if number not in self._subscriptions:
            # The subscription was destroyed while a message was ready.
            return
        self._take_over(number)
        self._count_lost(number, info["publication_sequence_number"])
        published = stamp_to_nanoseconds(message.header.stamp), int(info["source_timestamp"])
        if any(p == published and n != number for n, p in self._delivered):
            return
        self._delivered.append((number, published))
        self._callback(message)

    def _count_lost(self, number: int, sequence: int | None) -> None:
        """Count messages lost between two deliveries of one subscription to a single publisher."""
        last_number, before = self._last
        if last_number == number and before is not None and sequence is not None and (
            sequence > before + 1 and self._subscriptions[number].get_publisher_count() == 1
        ):
            self.lost += sequence - before - 1
        self._last = number, sequence
