# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Plausibility test of the depth sensor in the node: subscription, NIS, diagnostics."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from typing import Any

from rclpy.node import Node

from uw_visibility.errors import InputError
from uw_visibility.messages.depth_sensor import SENSOR_TYPES, read_depth
from uw_visibility.messages.estimates import NIS_TOPICS, nis_messages
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.plausibility.comparison import Comparison, DepthSample, Report, Verdict
from uw_visibility.plausibility.monitor import DepthMonitor
from uw_visibility.ros.monitor import ERROR, OK, STALE, WARN, Finding, ReasonLog
from uw_visibility.ros.parameters import NodeParameters
from uw_visibility.ros.transport.factory import make_message, message_type
from uw_visibility.ros.transport.qos import describe_publishers, publish_on, subscribe_to

SENSOR_TOPIC = "depth_sensor"

LEVELS = {
    Verdict.OK: OK, Verdict.LEARNING: OK, Verdict.WARN: WARN, Verdict.ERROR: ERROR,
    Verdict.STALE: STALE, Verdict.NOT_ASSESSABLE: WARN,
}


class DepthCheck:
    """Plausibility test, fed from the sensor's callback and the pipeline's thread.

    Parameters
    ----------
    node : rclpy.node.Node
        Subscription and publisher are made on it.
    parameters : NodeParameters
        Type of the sensor, and what the monitor is told.
    """

    def __init__(self, node: Node, parameters: NodeParameters) -> None:
        self._node = node
        self._parameters = parameters
        self._monitor = DepthMonitor(parameters.settings.node.plausibility)
        self._lock = threading.Lock()
        log = node.get_logger()
        self._refusals = ReasonLog(lambda line: log.warning(line))
        self._verdicts = ReasonLog(lambda line: log.warning(line))
        self._refused: tuple[float, str] | None = None
        self._subscription: Any = None
        self._publishers: dict[str, Any] = {}
        with ExitStack() as made:
            self._make(made)
            self._made = made.pop_all()

    def _make(self, made: ExitStack) -> None:
        node = self._node
        for topic, name in NIS_TOPICS.items():
            publisher = self._publishers[topic] = publish_on(node, message_type(name), topic)
            made.callback(node.destroy_publisher, publisher)
        kind = self._parameters.settings.node.plausibility.sensor_type
        if kind in SENSOR_TYPES:
            self._subscription = subscribe_to(
                node, message_type(SENSOR_TYPES[kind]), SENSOR_TOPIC, self._on_sensor
            )
            made.callback(node.destroy_subscription, self._subscription)

    def destroy(self) -> None:
        """Destroy subscription and publishers."""
        self._made.close()

    @property
    def wanted(self) -> bool:
        """Whether somebody subscribes to what it publishes."""
        publishers = self._publishers.values()
        return any(publisher.get_subscription_count() > 0 for publisher in publishers)

    def reset(self) -> None:
        """Forget everything: time has jumped."""
        with self._lock:
            self._monitor.reset()

    def add_result(self, stamp: Any, result: FrameResult) -> None:
        """Take the depth that the pipeline found at an image's stamp."""
        if self._subscription is None:
            return
        visibility = result.visibility
        sample = DepthSample(
            stamp_to_nanoseconds(stamp), visibility.depth, visibility.depth_precision**2
        )
        with self._lock:
            comparisons = self._updated_monitor().add_estimate(
                sample, visibility.depth_status, time.monotonic()
            )
        self._publish(comparisons)

    def diagnose(self) -> Finding:
        """Return level, message and numbers."""
        if self._subscription is None:
            return Finding(OK, "switched off: plausibility.sensor_type is none")
        now = time.monotonic()
        with self._lock:
            report = self._updated_monitor().report(now)
        values = _values(report) | {"refused sensor messages": self._refusals.total}
        refused, timeout = self._refused, self._monitor.config.timeout
        if refused is not None and now - refused[0] <= timeout:
            return Finding(WARN, refused[1], values)
        if report.verdict in (Verdict.WARN, Verdict.ERROR):
            self._verdicts.add(
                f"depth sensor and estimate do not agree ({report.verdict})", f": {report.reason}"
            )
        message = f"{report.verdict}: {report.reason}"
        if report.reason.startswith("no depth_sensor"):
            message += f", {describe_publishers(self._node, self._subscription)}"
        return Finding(LEVELS[report.verdict], message, values)

    def _on_sensor(self, message: Any) -> None:
        config = self._parameters.settings.node.plausibility
        try:
            sample = read_depth(message, config, self._node.get_clock().now().nanoseconds)
        except InputError as error:
            self._refused = time.monotonic(), str(error)
            self._refusals.add(str(error))
            return
        with self._lock:
            comparisons = self._updated_monitor().add_sensor(sample, time.monotonic())
        self._publish(comparisons)

    def _updated_monitor(self) -> DepthMonitor:
        self._monitor.config = self._parameters.settings.node.plausibility
        return self._monitor

    def _publish(self, comparisons: list[Comparison]) -> None:
        frame = self._parameters.settings.node.depth_frame
        for comparison in comparisons:
            for topic, message in nis_messages(make_message, comparison, frame):
                self._publishers[topic].publish(message)


def _values(report: Report) -> dict[str, Any]:
    values: dict[str, Any] = {
        "verdict": report.verdict,
        "comparisons": report.compared,
        "beyond the gate": report.failed,
        "beyond the gate in a row": report.consecutive,
        "too uncertain to judge": report.inconclusive,
        "estimates without a sensor value": report.unmatched,
        "learned from": report.learned,
        "learned bias (m)": _number(report.bias),
        "learned bias stddev (m)": _number(report.bias_stddev),
    }
    last = report.last
    if last is not None:
        values |= {
            "estimated depth (m)": _number(last.estimate.depth),
            "estimated depth stddev (m)": _number(last.estimate.depth_stddev),
            "sensor depth (m)": _number(last.sensor.depth),
            "sensor depth stddev (m)": _number(last.sensor.depth_stddev),
            "innovation (m)": _number(last.innovation),
            "innovation variance (m^2)": _number(last.variance),
            "nis": _number(last.nis),
            "gate (m)": _number(last.gate),
        }
    return values


def _number(value: float) -> str:
    # A quantity that is not known has no number.
    return f"{value:.4f}" if value == value else ""
