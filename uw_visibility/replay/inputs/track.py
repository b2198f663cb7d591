# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Track of what a sensor says, around the frames that wait for it."""

from __future__ import annotations

from collections import deque
from typing import Generic

from uw_visibility.plausibility.comparison import Value, neighbours


class Track(Generic[Value]):
    """Buffer of values by rising stamp, between which frames are placed.

    Parameters
    ----------
    longest_gap : float
        Values further apart than this are not neighbours, s.
    """

    def __init__(self, longest_gap: float) -> None:
        self._longest = longest_gap
        self._values: deque[Value] = deque()

    def add(self, value: Value) -> None:
        """Take a value; a stamp that goes back begins anew."""
        if self._values and value.stamp < self._values[-1].stamp:
            self._values.clear()
        self._values.append(value)

    def reaches(self, stamp: int) -> bool:
        """Tell whether values go as far as a stamp."""
        return bool(self._values) and self._values[-1].stamp >= stamp

    def follows(self, stamp: int) -> bool:
        """Tell whether values begin after a stamp, or there are none."""
        return not self._values or self._values[0].stamp > stamp

    def forget_before(self, stamp: int) -> None:
        """Drop what is not needed for stamps from this one on."""
        while len(self._values) > 1 and self._values[1].stamp <= stamp:
            self._values.popleft()

    def around(self, stamp: int) -> tuple[Value, Value, float] | None:
        """Return the neighbours of a stamp, and which part of the way it is; None without any."""
        return neighbours(self._values, stamp, self._longest)
