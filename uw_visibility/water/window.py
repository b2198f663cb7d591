# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames of the last minutes, thinned out to a number of them."""

from __future__ import annotations

import math
from collections import deque
from typing import Generic, TypeVar

import numpy as np

from uw_visibility.config.schema import SurveyConfig

Item = TypeVar("Item")


class FrameWindow(Generic[Item]):
    """What is kept of the frames of a window of time.

    Parameters
    ----------
    config : SurveyConfig
        Length of the window, s, and the most frames in it.
    """

    def __init__(self, config: SurveyConfig) -> None:
        self._config = config
        self._frames: deque[tuple[float, Item]] = deque()

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def items(self) -> list[Item]:
        """What is kept, the oldest first."""
        return [item for _, item in self._frames]

    @property
    def newest(self) -> float:
        """Time of the newest frame, s; NaN without any."""
        return self._frames[-1][0] if self._frames else math.nan

    @property
    def duration(self) -> float:
        """Time from the oldest to the newest frame, s."""
        return self._frames[-1][0] - self._frames[0][0] if self._frames else 0.0

    def clear(self) -> None:
        """Forget all frames."""
        self._frames.clear()

    def continued_by(self, stamp_seconds: float) -> bool:
        """Whether a frame of a time would be the newest."""
        return not stamp_seconds <= self.newest

    def add(self, item: Item | None, stamp_seconds: float) -> None:
        """Take in a frame, and forget those that have left the window.

        Parameters
        ----------
        item : Item or None
            What to keep of the frame, if anything.
        stamp_seconds : float
            Time of the frame, s, later than all before.
        """
        while self._frames and self._frames[0][0] < stamp_seconds - self._config.window:
            self._frames.popleft()
        if item is not None:
            self._frames.append((stamp_seconds, item))
        if len(self._frames) > self._config.max_frames:
            self._thin_out()

    def _thin_out(self) -> None:
        """Leave out the frame whose neighbours are closest to one another in time."""
        stamps = np.array([stamp for stamp, _ in self._frames])
        del self._frames[1 + int(np.argmin(stamps[2:] - stamps[:-2]))]
