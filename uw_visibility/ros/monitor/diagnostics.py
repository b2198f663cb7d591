# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the node on /diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from uw_visibility.errors import LONGEST_MESSAGE, printable
from uw_visibility.ros.monitor.faults import FaultLog
from uw_visibility.ros.monitor.finding import Finding

PERIOD = 1.0  # s


class DiagnosticsPublisher:
    """Publishes findings as diagnostic_updater does, under the node's name, once a second.

    Parameters
    ----------
    node : rclpy.node.Node
        Publisher and timer are made on it.
    find : callable
        Returns the findings by the part of the node that they are about.
    faults : FaultLog
        Is told if that fails, and reports on the part `callbacks`.
    """

    def __init__(
        self, node: Node, find: Callable[[], Mapping[str, Finding]], faults: FaultLog
    ) -> None:
        self._node = node
        self._find = find
        self._faults = faults
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # Time in the network and in the log is not that of a recording.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD, self._publish, clock=clock)

    def _publish(self) -> None:
        try:
            findings = dict(self._find())
        except Exception as error:
            # Whatever cannot be told, that it cannot is.
            self._faults.add(error)
            findings = {}
        findings["callbacks"] = self._faults.diagnose()
        prefix = self._node.get_fully_qualified_name().lstrip("/")
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=finding.level,
                name=f"{prefix}: {part}",
                # Names and texts of messages are in it.
                message=printable(finding.message, LONGEST_MESSAGE),
                hardware_id="none",
                values=[
                    KeyValue(key=printable(key, LONGEST_MESSAGE), value=printable(value))
                    for key, value in finding.values.items()
                ],
            )
            for part, finding in findings.items()
        ]
        self._publisher.publish(message)
