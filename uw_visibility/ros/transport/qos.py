# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""QoS of publishers and subscriptions, which parameters can override."""

from __future__ import annotations

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
    qos_profile_sensor_data,
)
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from uw_visibility.errors import InputError, printable

QOS_PREFIX = "qos_overrides."
OUTPUT_DEPTH = 10
# Small messages, of which some come at high rates.
INPUT_DEPTH = 10
# A reliable subscription keeps back what follows an image whose missing part it waits for:
# the newest ones wait as long as the queue is deep. Then the incomplete one is given up.
IMAGE_DEPTH = 5
POLICIES = (
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY,
)


def publish_on(node: Node, kind: type, topic: str) -> Any:
    """Create a reliable publisher.

    Raises
    ------
    InputError
        If a parameter under ``qos_overrides`` cannot be used.
    """
    qos = QoSProfile(depth=OUTPUT_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
    return _with_overrides(node.create_publisher, kind, topic, qos)


def subscribe_to(
    node: Node, kind: type, topic: str, callback: Callable[[Any], None],
    available: ReliabilityPolicy | None = None,
    depth: int = INPUT_DEPTH,
) -> Any:
    """Create a subscription for sensor data.

    Parameters
    ----------
    node : rclpy.node.Node
        The subscription is made on it.
    kind : type
        Class of the messages.
    topic : str
        Its name, to be resolved by the node.
    callback : callable
        Takes each message.
    available : ReliabilityPolicy, optional
        What the best reliability is that the publishers allow. It is taken unless
        ``qos_overrides`` asks for one; without it, best effort is.
    depth : int
        How many messages wait to be taken, unless ``qos_overrides`` says otherwise.

    Raises
    ------
    InputError
        If a parameter under ``qos_overrides`` cannot be used.
    """
    # Overrides are written into the profile.
    qos = QoSProfile(
        depth=depth,
        **{
            name: getattr(qos_profile_sensor_data, name)
            for name in ("history", "reliability", "durability")
        },
    )
    if available is not None:
        qos.reliability = ReliabilityPolicy.BEST_AVAILABLE

    def settle(overridden: QoSProfile) -> SetParametersResult:
        if available is not None and overridden.reliability is ReliabilityPolicy.BEST_AVAILABLE:
            overridden.reliability = available
        return SetParametersResult(successful=True)

    return _with_overrides(node.create_subscription, kind, topic, callback, qos, settle=settle)


def reliability_is_open(node: Node, subscription: Any) -> bool:
    """Return whether ``qos_overrides`` leaves the reliability of a subscription open."""
    name = f"{QOS_PREFIX}{subscription.topic_name}.subscription.reliability"
    best_available: str = ReliabilityPolicy.BEST_AVAILABLE.name.lower()
    return bool(node.get_parameter(name).value == best_available)


def describe_publishers(node: Node, subscription: Any) -> str:
    """Describe the publishers of a subscription's topic, and any mismatch of QoS.

    Parameters
    ----------
    node : rclpy.node.Node
        Owner of the subscription.
    subscription : rclpy.subscription.Subscription
        Whose topic is silent.
    """
    name = subscription.topic_name
    publishers = node.get_publishers_info_by_topic(name)
    if not publishers:
        return f"{name} has no publisher"
    said = f"{name} has {len(publishers)} publisher{'s' * (len(publishers) > 1)}"
    for info in publishers:
        compatibility, reason = qos_check_compatible(info.qos_profile, subscription.qos_profile)
        if compatibility == QoSCompatibility.ERROR:
            publisher = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            why = reason.removeprefix("ERROR: ").rstrip("; ")
            return printable(f"{said}, the QoS of {publisher} is not compatible: {why}")
    return f"{said}, of which nothing arrives"


def _with_overrides(
    create: Callable[..., Any],
    *arguments: Any,
    settle: Callable[[QoSProfile], SetParametersResult] | None = None,
) -> Any:
    options = QoSOverridingOptions(POLICIES, callback=settle)
    try:
        return create(*arguments, qos_overriding_options=options)
    except (InvalidQosOverridesError, InvalidParameterTypeException, RuntimeError) as error:
        raise InputError(f"a parameter under qos_overrides cannot be used: {error}") from error
