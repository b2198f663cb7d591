# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Node diagnostics: findings on the node's state, rates, logs of reasons and faults."""

from __future__ import annotations

import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from uw_visibility.errors import LONGEST_MESSAGE, printable

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE,
)

# Reasons that are remembered; they contain numbers of the input, so there may be many.
MAX_REASONS = 100
# Log lines per period, over all reasons.
MAX_LINES = 20
FURTHER = "further reasons"
SHOWN_REASONS = 10
# Time for which a fault is reported as an error, then as a warning, s.
RECENT = 10.0
# Period of the diagnostics, s.
PERIOD = 1.0


@dataclass(frozen=True)
class Finding:
    """State of a part of the node: level, one sentence, and values."""

    level: bytes
    message: str
    values: Mapping[str, Any] = field(default_factory=dict)


class RecentCounts:
    """Increments of counters over a sliding window, s; `duration`, s, is what the last cover."""

    def __init__(self, window: float) -> None:
        self.duration = 0.0
        self._window = window
        self._snapshots: deque[tuple[float, dict[str, int]]] = deque()

    def update(self, now: float, counts: Mapping[str, int]) -> dict[str, int]:
        """Return the increments of counters by name, without zeros; `now` is a time, s."""
        self._snapshots.append((now, dict(counts)))
        while len(self._snapshots) > 2 and now - self._snapshots[1][0] >= self._window:
            self._snapshots.popleft()
        begin, before = self._snapshots[0]
        self.duration = now - begin
        growth = {name: count - before.get(name, 0) for name, count in counts.items()}
        return {name: number for name, number in growth.items() if number}


class ReasonLog:
    """Logs a reason when it is new, and again at most once per period, s, with its count.

    It remembers the latest `MAX_REASONS` reasons, with their `counts`, and the `total` of all.
    Thread-safe.
    """

    def __init__(
        self,
        log: Callable[[str], None],
        period: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self.total = 0
        self._log = log
        self._period = period
        self._clock = clock
        self._logged: dict[str, float] = {}
        self._lines: deque[float] = deque(maxlen=MAX_LINES)
        self._lock = threading.Lock()

    def problems(self, number: int = SHOWN_REASONS) -> dict[str, int]:
        """Return occurrences of the latest and the most frequent reasons, and of all others."""
        with self._lock:
            shown = dict([*self.counts.items()][-number:]) | dict(self.counts.most_common(number))
            rest = self.total - sum(shown.values())
        shown |= {FURTHER: rest} if rest else {}
        return {f"problem: {reason}": count for reason, count in shown.items()}

    def add(self, reason: str, details: str = "") -> None:
        """Count a reason and log it; details are logged at its first occurrence only."""
        reason = printable(reason, LONGEST_MESSAGE)
        with self._lock:
            self.total += 1
            count = self.counts.pop(reason, 0) + 1
            self.counts[reason] = count
            if len(self.counts) > MAX_REASONS:
                oldest = next(iter(self.counts))
                del self.counts[oldest]
                self._logged.pop(oldest, None)
            now = self._clock()
            last = self._logged.get(reason)
            if last is not None and now - last < self._period:
                return
            if len(self._lines) == MAX_LINES and now - self._lines[0] < self._period:
                return
            self._logged[reason] = now
            self._lines.append(now)
        lines = "\n".join(printable(line, LONGEST_MESSAGE) for line in details.split("\n"))
        self._log(reason + (f" ({count} times so far)" if count > 1 else lines))


class FaultLog:
    """Log of exceptions that callbacks and timers raised, with their counts.

    Thread-safe. Exceptions after the end of the node's context are ignored: rclpy's own signal
    handlers end it while callbacks run, and all further use of it fails.
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
        values = {"failed callbacks": self._reasons.total, **self._reasons.problems()}
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


def publish_diagnostics(
    node: Node, find: Callable[[], Mapping[str, Finding]], faults: FaultLog
) -> None:
    """Publish findings once a second under the node's name, as diagnostic_updater does.

    `find` returns them by part of the node; `faults` has its exceptions, and is a part, too.
    """
    publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def publish() -> None:
        try:
            findings = dict(find())
        except Exception as error:
            # The failure itself is reported, as one of a callback.
            faults.add(error)
            findings = {}
        findings["callbacks"] = faults.diagnose()
        prefix = node.get_fully_qualified_name().lstrip("/")
        message = DiagnosticArray()
        message.header.stamp = node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=finding.level,
                name=f"{prefix}: {part}",
                # It may contain text from messages of other nodes.
                message=printable(finding.message, LONGEST_MESSAGE),
                hardware_id="none",
                values=[
                    KeyValue(key=printable(key, LONGEST_MESSAGE), value=printable(value))
                    for key, value in finding.values.items()
                ],
            )
            for part, finding in findings.items()
        ]
        publisher.publish(message)

    # Steady clock: the period does not follow simulated time.
    node.create_timer(PERIOD, publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
