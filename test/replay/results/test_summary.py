# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a replay tells of the filter over frames."""

from __future__ import annotations

from pathlib import Path

import pytest
from frame_records import frame_estimate, frame_record, write_table

from uw_visibility.replay.columns import COLUMNS
from uw_visibility.replay.records import JoinedFrame
from uw_visibility.replay.report.sentences import filtering
from uw_visibility.replay.results.provenance import Origin
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.table import read_table
from uw_visibility.water.series.filter import FilteredWater
from uw_visibility.water.series.survey import SurveyEstimate
from uw_visibility.water.series.tracking import TrackingEvent

ORIGIN = Origin("bag", "of its files", "1.0", {})


def frame(event: TrackingEvent, survey: SurveyEstimate | None = None) -> JoinedFrame:
    estimate = frame_estimate()
    filtered = FilteredWater(estimate.water, estimate.visibility, event, survey=survey)
    return JoinedFrame(frame_record(estimate=estimate), filtered)


def surveyed(frames: int, low: float, high: float) -> JoinedFrame:
    survey = SurveyEstimate(frame_estimate().water, frames, 10.0, low, high)
    return frame(TrackingEvent.SURVEYED, survey)


def counted(folder: Path, *frames: JoinedFrame) -> Summary:
    summary = Summary("bag", "out", provenance={"told": []})
    summary.read(read_table(write_table(folder, frames), COLUMNS), 0.05, ())
    return summary


def test_rejected_frames_and_runs_that_were_followed_are_told(tmp_path: Path) -> None:
    frames = [frame(TrackingEvent(event)) for event in (
        "started", "updated", "outlier", "outlier", "restarted", "outlier", "updated",
        "predicted", "not assessable")]
    told = "The filter rejected 3 of 7 frames, and accepted 1 run of such frames as a change."
    assert [told] in filtering(counted(tmp_path, *frames))
    frames = [frame(TrackingEvent.STARTED), frame(TrackingEvent.UPDATED)]
    assert ["The filter rejected none of 2 frames."] in filtering(counted(tmp_path, *frames))


def test_what_a_survey_rests_on_is_told_again_from_its_table(tmp_path: Path) -> None:
    summary = counted(
        tmp_path, frame(TrackingEvent.NOT_ASSESSABLE),
        surveyed(20, 1.7, 2.2), surveyed(21, 1.6, 2.1))
    told = ["Filtered water of 2 frames is from a survey: up to 21 frames together, "
            "ranges from 1.60 to 2.20 m."]
    assert told in filtering(summary)
    again = Summary.of_finished("bag", "out", summary.state(ORIGIN), tmp_path / "frames.csv")
    assert told in filtering(again)
    assert not counted(tmp_path, frame(TrackingEvent.UPDATED)).survey


def test_a_result_whose_table_is_damaged_is_not_told_again(tmp_path: Path) -> None:
    state = counted(tmp_path, frame(TrackingEvent.UPDATED)).state(ORIGIN)
    table = tmp_path / "frames.csv"
    good = table.read_text()
    for before, after in (("frame,", "number,"), ("\n0,", "\nnone,"), ("status,", "\udcff,")):
        table.write_text(good.replace(before, after, 1), errors="surrogateescape")
        with pytest.raises((LookupError, ValueError)):
            Summary.of_finished("bag", "out", state, table)
