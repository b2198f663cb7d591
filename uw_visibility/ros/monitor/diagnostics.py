# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the node says of itself on /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE,
)


@dataclass(frozen=True)
class Finding:
    """State of a part of the node: level, one sentence, and numbers."""

    level: bytes
    message: str
    values: Mapping[str, Any] = field(default_factory=dict)


class DiagnosticsPublisher:
    """Publishes findings as diagnostic_updater does, under the node's name.

    Parameters
    ----------
    node : rclpy.node.Node
        The publisher is made on it.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def publish(self, findings: Mapping[str, Finding]) -> None:
        """Publish findings by the part of the node that they are about."""
        prefix = self._node.get_fully_qualified_name().lstrip("/")
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=finding.level,
                name=f"{prefix}: {part}",
                message=finding.message,
                hardware_id="none",
                values=[KeyValue(key=k, value=str(v)) for k, v in finding.values.items()],
            )
            for part, finding in findings.items()
        ]
        self._publisher.publish(message)

    def destroy(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)
