# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rates of counters over the last seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping


class RecentCounts:
    """Differences of counters over the last seconds.

    Parameters
    ----------
    window : float
        How far back the differences reach, s.

    Attributes
    ----------
    duration : float
        How far back they reach so far, s.
    """

    def __init__(self, window: float) -> None:
        self.duration = 0.0
        self._window = window
        self._snapshots: deque[tuple[float, dict[str, int]]] = deque()

    def update(self, now: float, counts: Mapping[str, int]) -> dict[str, int]:
        """Return the counts over the last seconds.

        Parameters
        ----------
        now : float
            Time, s.
        counts : mapping of str to int
            Counters, which only grow.

        Returns
        -------
        dict of str to int
            What each counter grew by; those that did not grow are absent.
        """
        self._snapshots.append((now, dict(counts)))
        while len(self._snapshots) > 2 and now - self._snapshots[1][0] >= self._window:
            self._snapshots.popleft()
        begin, before = self._snapshots[0]
        self.duration = now - begin
        growth = {name: count - before.get(name, 0) for name, count in counts.items()}
        return {name: number for name, number in growth.items() if number}
