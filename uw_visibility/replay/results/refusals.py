# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Refusals: quantities not assessable, by frames and reason."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.replay.records import FURTHER, MOST_REASONS, JoinedFrame
from uw_visibility.status import Status

WHOLE_FRAME = "the whole frame"
DISTANCE, OTHER_CHANNELS = "visibility distance", "visibility distance of all channels"
OVER_FRAMES = "visibility distance over frames"
PLAUSIBILITY = "plausibility of the depth sensor"
# Status column of each quantity.
STATUS_COLUMNS = {"water": "status", DISTANCE: "visibility_status",
                  "depth by colour": "depth_status"}
# Verdicts that judge the sensor.
JUDGED = {Verdict.OK, Verdict.WARN, Verdict.ERROR}
MOST_RUNS = 8


@dataclass
class Refusal:
    """Quantities that were not assessable in the same frames for the same reason."""

    # what, why: quantities and reason
    what: str
    why: str
    count: int = 0  # frames
    # first and last frame of each run of neighbours in the table; the first runs
    runs: list[list[str]] = field(default_factory=list)
    # shown, last_row: frames in `runs`, and row of the last frame
    shown: int = 0
    last_row: int = -2

    def add(self, row: int, frame: str) -> None:
        """Count a frame in this row of the table."""
        follows = self.last_row == row - 1 and self.shown == self.count
        self.count += 1
        self.last_row = row
        if follows:
            self.runs[-1][1] = frame
        elif len(self.runs) < MOST_RUNS and self.shown == self.count - 1:
            self.runs.append([frame, frame])
        else:
            return
        self.shown += 1

    @property
    def frames(self) -> str:
        """Which frames, as numbers; not all, where they are many."""
        text = ", ".join(first if first == last else f"{first}-{last}" for first, last in self.runs)
        more = self.count - self.shown
        return f"{text} and {more} more" if more else text


class Refusals:
    """Counter of refusals, frame by frame; its size has a bound."""

    def __init__(self) -> None:
        self._refusals: dict[tuple[str, str], Refusal] = {}
        self._rows = 0

    def count(self, joined: JoinedFrame) -> None:
        """Count a frame, the next row of the table."""
        for what, why in _refused(joined):
            reasons = sum(quantity == what for quantity, _ in self._refusals)
            if (what, why) not in self._refusals and reasons >= MOST_REASONS:
                why = FURTHER
            refusal = self._refusals.setdefault((what, why), Refusal(what, why))
            refusal.add(self._rows, str(joined.record.frame))
        self._rows += 1

    def has(self, what: str) -> bool:
        """Tell whether a quantity was not assessable in some frame."""
        return any(quantity == what for quantity, _ in self._refusals)

    def together(self) -> list[Refusal]:
        """Return the refusals; quantities with the same frames and reason are merged."""
        groups: dict[tuple[str, int, str], list[Refusal]] = {}
        for refusal in self._refusals.values():
            key = (refusal.why, refusal.count, refusal.frames)
            groups.setdefault(key, []).append(refusal)
        return [
            Refusal(**{**asdict(group[0]), "what": ", ".join(r.what for r in group)})
            for group in groups.values()
        ]

    def state(self) -> list[dict[str, Any]]:
        return [asdict(refusal) for refusal in self._refusals.values()]

    @classmethod
    def of_state(cls, state: list[dict[str, Any]]) -> Refusals:
        """Restore from the output of `state`."""
        refusals = cls()
        for values in state:
            refusals._refusals[values["what"], values["why"]] = Refusal(**values)
        return refusals


def _refused(joined: JoinedFrame) -> Iterator[tuple[str, str]]:
    """Yield quantity and reason of each refusal of a frame."""
    estimate = joined.record.estimate
    if estimate is None:
        yield WHOLE_FRAME, joined.record.reason
        return
    visibility = estimate.visibility
    distance = OTHER_CHANNELS if math.isfinite(visibility.distance) else DISTANCE
    for what, status in (
        ("water", estimate.water.status), (distance, visibility.status),
        ("depth by colour", visibility.depth_status),
    ):
        if status is not Status.OK:
            yield what, str(status)
    filtered = joined.filtered
    if filtered is not None and math.isfinite(visibility.distance) and not math.isfinite(
            filtered.visibility.distance):
        yield OVER_FRAMES, str(filtered.visibility.status)
    if joined.verdict is not None and joined.verdict not in JUDGED:
        # Frames with the same reason differ in its numbers.
        reason = re.sub(r"\d+(\.\d+)?", "…", joined.verdict_reason)
        yield PLAUSIBILITY, reason or str(joined.verdict)
