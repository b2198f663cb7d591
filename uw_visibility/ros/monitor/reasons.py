# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Throttled log of the reasons why frames were lost, with their counts."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable

from uw_visibility.errors import LONGEST_MESSAGE, printable

# Reasons carry numbers of the input, so a bad publisher can make many of them.
MAX_REASONS = 100
# Lines in one period, of whatever reasons.
MAX_LINES = 20
FURTHER = "further reasons"


class ReasonLog:
    """Logs a reason when it is new, and again at most once per period, with its count.

    Of many reasons those that occurred last are kept.

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
        How often each of the latest reasons occurred, the last one last.
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
        self._lines: deque[float] = deque(maxlen=MAX_LINES)
        self._lock = threading.Lock()

    def selection(self, number: int) -> dict[str, int]:
        """Return the latest and the most frequent reasons, so many of each, and all others as one.

        Parameters
        ----------
        number : int
            How many of either.

        Returns
        -------
        dict of str to int
            How often each occurred.
        """
        with self._lock:
            shown = dict([*self.counts.items()][-number:]) | dict(self.counts.most_common(number))
            rest = self.total - sum(shown.values())
        return shown | ({FURTHER: rest} if rest else {})

    def add(self, reason: str, details: str = "") -> None:
        """Count a reason; details are added the first time it is logged."""
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
