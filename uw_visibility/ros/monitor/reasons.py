# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Throttled log of the reasons why frames were lost, with their counts."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable

# Reasons carry numbers of the input, so a bad publisher can make many of them.
MAX_REASONS = 100


class ReasonLog:
    """Logs a reason when it is new, and again at most once per period, with its count.

    Safe to use from several threads.

    Parameters
    ----------
    log : callable
        Takes the line to log.
    period : float
        Shortest time between two lines for one reason, s.
    clock : callable
        Returns a time in s.

    Attributes
    ----------
    counts : Counter of str
        How often each reason occurred; the first ones, once there are many.
    total : int
        How often any reason occurred.
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
        self._lock = threading.Lock()

    def most_common(self, number: int) -> list[tuple[str, int]]:
        """Return the most frequent reasons with their counts."""
        with self._lock:
            return self.counts.most_common(number)

    def add(self, reason: str, details: str = "") -> None:
        """Count a reason; details are added the first time it is logged."""
        with self._lock:
            self.total += 1
            if reason not in self.counts and len(self.counts) >= MAX_REASONS:
                reason, details = "further reasons", ""
            self.counts[reason] += 1
            count, now = self.counts[reason], self._clock()
            if count > 1 and now - self._logged[reason] < self._period:
                return
            self._logged[reason] = now
        times = f" ({count} times so far)" if count > 1 else details
        self._log(f"{reason}{times}")
