# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Exceptions of callbacks: counted and reported, never the end of the node."""

from __future__ import annotations

import time
import traceback
from typing import Any

from rclpy.node import Node

from uw_visibility.ros.monitor.finding import ERROR, OK, WARN, Finding
from uw_visibility.ros.monitor.reasons import ReasonLog

# How long a fault is the callbacks' present state, s.
RECENT = 10.0
SHOWN_REASONS = 10


class FaultLog:
    """Log of exceptions that callbacks and timers raised, with their counts.

    Safe to use from several threads. Once the node's context has ended, which rclpy's own
    handlers of signals do while callbacks run, whatever uses it fails: that is no fault.

    Parameters
    ----------
    node : rclpy.node.Node
        Whose log tells of them.
    """

    def __init__(self, node: Node) -> None:
        log = node.get_logger()
        self._context = node.context
        self._reasons = ReasonLog(lambda line: log.error(line))
        self._last: tuple[float, str] | None = None

    def add(self, error: BaseException) -> None:
        """Count an exception; its traceback is logged the first time."""
        if not self._context.ok():
            return
        reason = describe_fault(error)
        self._last = time.monotonic(), reason
        details = "".join(traceback.format_exception(error))
        self._reasons.add(f"a callback failed with {reason}", f"\n{details}")

    def diagnose(self) -> Finding:
        """Return level, message and numbers."""
        values: dict[str, Any] = {"failed callbacks": self._reasons.total}
        values |= {
            f"problem: {reason}": count
            for reason, count in self._reasons.selection(SHOWN_REASONS).items()
        }
        if self._last is None:
            return Finding(OK, "no callback has failed", values)
        when, reason = self._last
        level = ERROR if time.monotonic() - when <= RECENT else WARN
        return Finding(level, f"a callback failed with {reason}", values)


def describe_fault(error: BaseException) -> str:
    """Return an exception's type and the line that raised it."""
    places = traceback.extract_tb(error.__traceback__)
    name = type(error).__name__
    return f"{name} at {places[-1].filename}:{places[-1].lineno}" if places else name
