# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Refusals: quantities that were not assessable, by frames and reason."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.replay.columns import COLUMNS, FAILED
from uw_visibility.replay.records import FURTHER, MOST_REASONS
from uw_visibility.replay.table import Columns

WHOLE_FRAME = "the whole frame"
DISTANCE, OTHER_CHANNELS = "visibility distance", "visibility distance of all channels"
OVER_FRAMES = "visibility distance over frames"
PLAUSIBILITY = "plausibility of the depth sensor"
# Status column of each quantity.
STATUS_COLUMNS = {"water": "status", DISTANCE: "visibility_status",
                  "depth by colour": "depth_status"}
# Verdicts on the sensor; others have a reason for no verdict.
JUDGED = (Verdict.OK, Verdict.WARN, Verdict.ERROR)
MOST_RUNS = 8
NUMBER = re.compile(r"\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Refusal:
    """Quantities that were not assessable in the same frames for the same reason."""

    # what, why: quantities and reason
    what: str
    why: str
    count: int  # number of frames
    frames: str  # their numbers, shortened if there are many


def refusals(columns: Columns) -> list[Refusal]:
    """Return the refusals in the frames of a table."""
    found: dict[tuple[str, str], list[int]] = {}
    numbers: dict[tuple[str, str], list[list[str]]] = {}
    reasons: Counter[str] = Counter()
    for place in range(len(columns["frame"])):
        for what, why in _refused(columns, place):
            told: list[str] = []
            if what == PLAUSIBILITY:
                # Frames with the same reason but for its numbers are counted together.
                told, why = NUMBER.findall(why), NUMBER.sub("…", why)
            if (what, why) not in found:
                why = why if reasons[what] < MOST_REASONS else FURTHER
                reasons[what] += 1
            found.setdefault((what, why), []).append(place)
            numbers.setdefault((what, why), []).append(told)
    together: dict[tuple[str, tuple[int, ...]], list[str]] = {}
    for (what, why), places in found.items():
        for values in zip(*numbers[what, why], strict=False):
            ends = dict.fromkeys((min(values, key=float), max(values, key=float)))
            why = why.replace("…", " to ".join(ends), 1)
        together.setdefault((why, tuple(places)), []).append(what)
    return [
        Refusal(", ".join(names), why, len(places), _frames(places, columns["frame"]))
        for (why, places), names in together.items()]


def _frames(places: Sequence[int], numbers: NDArray) -> str:
    """Return frame numbers as runs of neighbours in the table, first and last of each."""
    runs = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    ends = [
        [f"{numbers[place]:.0f}" for place in dict.fromkeys(run[[0, -1]])]
        for run in runs[:MOST_RUNS]]
    more = sum(map(len, runs[MOST_RUNS:]))
    return ", ".join(map("-".join, ends)) + (f" and {more} more" if more else "")


def _refused(columns: Columns, place: int) -> Iterator[tuple[str, str]]:
    """Yield quantity and reason of each refusal of a frame."""
    def value(name: str) -> Any:
        return columns[name][place]

    if value("status") == FAILED:
        yield WHOLE_FRAME, value("reason")
        return
    seen = np.isfinite(value("visibility_distance"))
    for what, column in STATUS_COLUMNS.items():
        if value(column) != "ok":
            other = what == DISTANCE and seen
            yield OTHER_CHANNELS if other else what, COLUMNS[column].meaning(value(column))
    if value("filtering") and seen and np.isnan(value("filtered_visibility_distance")):
        column = "filtered_visibility_status"
        yield OVER_FRAMES, COLUMNS[column].meaning(value(column))
    verdict = COLUMNS["plausibility"].meaning(value("plausibility"))
    if verdict and verdict not in JUDGED:
        yield PLAUSIBILITY, value("plausibility_reason") or verdict
