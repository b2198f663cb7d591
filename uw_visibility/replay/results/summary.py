# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary of a replay, for the terminal, the report and replay.json."""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.replay.columns import COLUMNS, FAILED
from uw_visibility.replay.records import FURTHER, MOST_REASONS
from uw_visibility.replay.results.provenance import Origin
from uw_visibility.replay.results.synopsis import Synopsis, synopsis
from uw_visibility.replay.table import Columns, read_table

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
COUNTED = (
    "status", "visibility_status", "depth_status", "filtering", "plausibility", "water_type",
    "filtered_water_type")
"""Columns of which the words are counted."""


@dataclass(frozen=True)
class Refusal:
    """Quantities that were not assessable in the same frames for the same reason."""

    # what, why: quantities and reason
    what: str
    why: str
    count: int  # number of frames
    frames: str  # their numbers, shortened if there are many


@dataclass
class Summary:
    bag: str
    output: str
    complete: bool = False
    resumed: int = 0  # rows taken from an earlier, interrupted replay
    # images that are in no frame, by reason
    dropped: Counter[str] = field(default_factory=Counter)
    damage: list[str] = field(default_factory=list)
    # missing topics to join, with the reason; only with several recordings
    lacks: list[str] = field(default_factory=list)
    error: str = ""  # why there is no result, with several recordings
    notes: list[str] = field(default_factory=list)  # automatic choices
    topics: dict[str, str] = field(default_factory=dict)  # topics used, by purpose
    seconds: float = 0.0  # duration of the replay
    provenance: dict[str, Any] = field(default_factory=dict)
    # From the table, see `read`.
    frames: int = 0
    # numbers of frames by word, for each of `COUNTED`
    counts: dict[str, Counter[str]] = field(
        default_factory=lambda: {name: Counter() for name in COUNTED})
    # number of frames with filtered water from a survey, largest number of frames in a survey,
    # and ranges, m; empty without any
    survey: dict[str, Any] = field(default_factory=dict)
    refusals: list[Refusal] = field(default_factory=list)
    synopsis: Synopsis | None = None  # None before the end

    @property
    def name(self) -> str:
        """Name of the recording among several: name of its folder."""
        return Path(self.output).name

    @property
    def assessed(self) -> int:
        """Frames whose water was assessed."""
        return self.counts["status"]["ok"]

    @property
    def failed(self) -> int:
        return self.counts["status"][FAILED]

    def read(
        self, found: Columns, contrast: float, baselines: Collection[float]
    ) -> None:
        """Summarise a table, complete or partial, of one or several recordings.

        Parameters: see `synopsis`.
        """
        self.frames = len(found["frame"])
        self.counts = {name: Counter(filter(None, found[name])) for name in COUNTED}
        surveyed = np.isfinite(found["survey_frames"])
        if surveyed.any():
            self.survey = {
                "count": int(surveyed.sum()), "frames": int(np.nanmax(found["survey_frames"])),
                "range_min": float(np.nanmin(found["survey_range_min"])),
                "range_max": float(np.nanmax(found["survey_range_max"]))}
        self.refusals = refusals(found)
        self.synopsis = synopsis(found, contrast, baselines)

    def state(self, origin: Origin) -> dict[str, Any]:
        """Serialise the summary and its origin for JSON."""
        return {
            "complete": self.complete, "version": origin.version, "bag": origin.bag,
            "input_sha256": self.provenance.get("input_sha256"),
            "fingerprint": origin.fingerprint, "topics": self.topics, "frames": self.frames,
            **self.counts,
            "unusable": {
                each.why: each.count for each in self.refusals if each.what == WHOLE_FRAME},
            "not_assessable": [asdict(each) for each in self.refusals],
            "survey": self.survey,
            "synopsis": None if self.synopsis is None else self.synopsis.state(),
            "dropped": dict(self.dropped),
            "damage": self.damage, "lacks": self.lacks, "notes": self.notes,
            "seconds": round(self.seconds, 3), "python": sys.version.split()[0],
            "parameters": origin.parameters, "told": self.provenance.get("told"),
        }

    @classmethod
    def of_finished(
        cls, bag: str, output: str, state: Mapping[str, Any], table: Path
    ) -> Summary:
        """Return the summary of an existing result."""
        found = cls(
            bag, output, complete=True, dropped=Counter(state["dropped"]),
            damage=list(state["damage"]), lacks=list(state["lacks"]),
            notes=list(state.get("notes", ())), topics=state["topics"],
            provenance={name: state[name] for name in ("parameters", "told")},
        )
        before = state["synopsis"]
        found.read(
            read_table(table, COLUMNS), float(before["contrast"]),
            [float(b) for b in before["baselines"]])
        found.resumed = found.frames
        return found


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
