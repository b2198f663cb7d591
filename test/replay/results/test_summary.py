# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a replay tells of the filter over frames."""

from __future__ import annotations

from uw_visibility.replay.results.provenance import Origin
from uw_visibility.replay.results.summary import Summary

ORIGIN = Origin("bag", "of its files", "1.0", {})


def row(filtering: str, **others: str) -> dict[str, str]:
    fine = dict.fromkeys(("status", "visibility_status", "depth_status"), "ok")
    return {"frame": "0", "reason": "", "filtering": filtering, "plausibility_reason": "",
            **fine, **others}


def counted(*rows: dict[str, str]) -> Summary:
    summary = Summary("bag", "out")
    for one in rows:
        summary.count(one)
    return summary


def test_rejected_frames_and_runs_that_were_followed_are_told() -> None:
    rows = [row(event) for event in (
        "started", "updated", "outlier", "outlier", "restarted", "outlier", "updated",
        "predicted", "not assessable")]
    told = "the filter rejected 3 of 7 frames, and followed 1 run of such frames as a change"
    assert counted(*rows).rejections() == told
    assert counted(row("started"), row("updated")).rejections() == ""


def test_what_a_survey_rests_on_is_told_again_from_its_state() -> None:
    summary = counted(
        row("not assessable"),
        row("survey", survey_frames="20", survey_range_min="1.7", survey_range_max="2.2"),
        row("survey", survey_frames="21", survey_range_min="1.6", survey_range_max="2.1"),
    )
    told = ("filtered water of 2 frames is that of a survey: up to 21 frames together, "
            "ranges from 1.60 to 2.20 m")
    assert summary.surveyed() == told
    assert Summary.of_finished("bag", "out", summary.state(ORIGIN)).surveyed() == told
    assert counted(row("updated")).surveyed() == ""
