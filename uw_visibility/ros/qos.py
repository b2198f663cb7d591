# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Publishers and subscriptions whose QoS can be overridden by parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from uw_visibility.errors import InputError

OUTPUT_DEPTH = 10
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


def subscribe_to(node: Node, kind: type, topic: str, callback: Callable[[Any], None]) -> Any:
    """Create a subscription for sensor data.

    Raises
    ------
    InputError
        If a parameter under ``qos_overrides`` cannot be used.
    """
    # Overrides are written into the profile.
    qos = QoSProfile(**{
        name: getattr(qos_profile_sensor_data, name)
        for name in ("history", "depth", "reliability", "durability")
    })
    return _with_overrides(node.create_subscription, kind, topic, callback, qos)


def _with_overrides(create: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return create(*arguments, qos_overriding_options=QoSOverridingOptions(POLICIES))
    except (InvalidQosOverridesError, InvalidParameterTypeException, RuntimeError) as error:
        raise InputError(f"a parameter under qos_overrides cannot be used: {error}") from error
