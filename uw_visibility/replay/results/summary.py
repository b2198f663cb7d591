# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Summary of a replay, for the terminal, the report and replay.json."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from uw_visibility.plausibility.monitor import Report
from uw_visibility.replay.columns import FAILED, word
from uw_visibility.replay.records import JoinedFrame, count_reason
from uw_visibility.replay.results.provenance import Origin
from uw_visibility.replay.results.refusals import Refusals
from uw_visibility.replay.results.synopsis import Synopsis
from uw_visibility.water.series.survey import SurveyEstimate
from uw_visibility.water.series.tracking import TrackingEvent

TAKEN = (TrackingEvent.STARTED, TrackingEvent.UPDATED, TrackingEvent.RESTARTED)
"""Events of frames that updated the filter."""


@dataclass
class Summary:
    bag: str
    output: str
    complete: bool = False
    # frames, resumed: rows of the table, and those of an earlier part among them
    frames: int = 0
    resumed: int = 0
    # status, visibility_status, depth_status, reasons: frames by status, in the words of the table,
    # by that of the visibility distance and that of the depth, and those without result by reason
    status: Counter[str] = field(default_factory=Counter)
    visibility_status: Counter[str] = field(default_factory=Counter)
    depth_status: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    # frames by what they did to the water filtered over frames
    filtering: Counter[str] = field(default_factory=Counter)
    # how many frames' filtered water is that of a survey, of how many frames at most, and their
    # ranges, m; empty without any
    survey: dict[str, Any] = field(default_factory=dict)
    refusals: Refusals = field(default_factory=Refusals)  # what was not assessable in which frames
    # images that became part of no frame, by reason
    dropped: Counter[str] = field(default_factory=Counter)
    damage: list[str] = field(default_factory=list)
    # what was to be joined and is not in this one of several recordings
    lacks: list[str] = field(default_factory=list)
    error: str = ""  # why there is no result, where that holds up no other recording
    notes: list[str] = field(default_factory=list)  # choices made for the user
    topics: dict[str, str] = field(default_factory=dict)  # topics used, by purpose
    seconds: float = 0.0  # duration of the replay
    provenance: dict[str, Any] = field(default_factory=dict)
    plausibility: Report | None = None
    # frames by verdict of the depth sensor's plausibility
    verdicts: Counter[str] = field(default_factory=Counter)
    synopsis: Synopsis | None = None  # None before the end

    @property
    def name(self) -> str:
        """Name of the recording among several: that of its folder."""
        return Path(self.output).name

    @property
    def assessed(self) -> int:
        """Frames whose water was assessed."""
        return self.status["ok"]

    @property
    def failed(self) -> int:
        return self.status[FAILED]

    def rejections(self) -> str:
        """Number of frames that the filter over frames rejected, in words; empty for none."""
        rejected = self.filtering[word(TrackingEvent.OUTLIER)]
        estimates = sum(self.filtering[word(event)] for event in TAKEN) + rejected
        if not rejected:
            return ""
        followed = self.filtering[word(TrackingEvent.RESTARTED)]
        runs = "1 run" if followed == 1 else f"{followed} runs"
        return (
            f"the filter rejected {rejected} of {estimates} frames"
            + (f", and followed {runs} of such frames as a change" if followed else "")
        )

    def surveyed(self) -> str:
        """Describe the surveys that the filtered water comes from."""
        if not self.survey:
            return ""
        return (
            "filtered water of {count} frames is that of a survey: up to {frames} frames "
            "together, ranges from {range_min:.2f} to {range_max:.2f} m".format(**self.survey)
        )

    def _count_survey(self, survey: SurveyEstimate) -> None:
        low, high = survey.range_min, survey.range_max
        before = self.survey or {"count": 0, "frames": 0, "range_min": low, "range_max": high}
        self.survey = {
            "count": before["count"] + 1,
            "frames": max(before["frames"], survey.frames),
            "range_min": min(before["range_min"], low),
            "range_max": max(before["range_max"], high),
        }

    def count(self, joined: JoinedFrame) -> None:
        self.frames += 1
        self.refusals.count(joined)
        filtered, estimate = joined.filtered, joined.record.estimate
        if filtered is not None:
            self.filtering[word(filtered.event)] += 1
            if filtered.survey is not None:
                self._count_survey(filtered.survey)
        if estimate is None:
            self.status[FAILED] += 1
            count_reason(self.reasons, joined.record.reason)
            return
        self.status[word(estimate.water.status)] += 1
        self.visibility_status[word(estimate.visibility.status)] += 1
        self.depth_status[word(estimate.visibility.depth_status)] += 1

    def state(self, origin: Origin) -> dict[str, Any]:
        """Serialise the summary and its origin for JSON."""
        return {
            "complete": self.complete, "version": origin.version, "bag": origin.bag,
            "input_sha256": self.provenance.get("input_sha256"),
            "fingerprint": origin.fingerprint, "topics": self.topics, "frames": self.frames,
            "status": dict(self.status), "visibility_status": dict(self.visibility_status),
            "depth_status": dict(self.depth_status),
            "unusable": dict(self.reasons), "not_assessable": self.refusals.state(),
            "filtering": dict(self.filtering),
            "survey": self.survey,
            "synopsis": None if self.synopsis is None else self.synopsis.state(),
            "dropped": dict(self.dropped),
            "damage": self.damage, "lacks": self.lacks, "plausibility": dict(self.verdicts),
            "seconds": round(self.seconds, 3), "python": sys.version.split()[0],
            "parameters": origin.parameters, "told": self.provenance.get("told"),
        }

    @classmethod
    def of_finished(cls, bag: str, output: str, state: Mapping[str, Any]) -> Summary:
        """Return the summary of an existing result."""
        return cls(
            bag, output, complete=True, frames=state["frames"], resumed=state["frames"],
            status=Counter(state["status"]),
            visibility_status=Counter(state.get("visibility_status")),
            depth_status=Counter(state["depth_status"]), reasons=Counter(state["unusable"]),
            refusals=Refusals.of_state(state.get("not_assessable", [])),
            filtering=Counter(state.get("filtering")), survey=dict(state.get("survey", {})),
            dropped=Counter(state["dropped"]),
            damage=list(state["damage"]), lacks=list(state.get("lacks", [])),
            topics=state["topics"],
            provenance={name: state[name] for name in ("parameters", "told")},
            synopsis=None if state.get("synopsis") is None else Synopsis.of_state(
                state["synopsis"]),
        )
