# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Light of lamps over frames, for those that are worked on before the last ones are answered."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from uw_visibility.water.estimate import LampLight


class LightHistory:
    """Light after each of the frames that are answered.

    A frame gets the light up to so many frames before it: as many as several processes may be
    at beside it, so that it does not depend on which of them is fast.

    Parameters
    ----------
    ahead : int
        Frames that may be unanswered when a task is given.
    """

    def __init__(self, ahead: int) -> None:
        self._ahead = ahead
        self._lights: deque[LampLight | None] = deque([None])
        self._given = 0

    def add(self, light: LampLight | None) -> None:
        """Take in the light after the next frame that is answered."""
        # What it was estimated from is long, and restores nothing.
        self._lights.append(None if light is None else replace(light, cells=None, ground=None))

    def next(self) -> LampLight | None:
        """Light for the next frame; None before any is known."""
        if self._given > self._ahead:
            self._lights.popleft()
        self._given += 1
        return self._lights[0]
