# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a replay tells of the filter over frames."""

from __future__ import annotations

from frame_records import frame_estimate, frame_record

from uw_visibility.replay.records import JoinedFrame
from uw_visibility.replay.results.provenance import Origin
from uw_visibility.replay.results.summary import Summary
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


def counted(*frames: JoinedFrame) -> Summary:
    summary = Summary("bag", "out")
    for one in frames:
        summary.count(one)
    return summary


def test_rejected_frames_and_runs_that_were_followed_are_told() -> None:
    frames = [frame(TrackingEvent(event)) for event in (
        "started", "updated", "outlier", "outlier", "restarted", "outlier", "updated",
        "predicted", "not assessable")]
    told = "the filter rejected 3 of 7 frames, and followed 1 run of such frames as a change"
    assert counted(*frames).rejections() == told
    assert counted(frame(TrackingEvent.STARTED), frame(TrackingEvent.UPDATED)).rejections() == ""


def test_what_a_survey_rests_on_is_told_again_from_its_state() -> None:
    summary = counted(
        frame(TrackingEvent.NOT_ASSESSABLE), surveyed(20, 1.7, 2.2), surveyed(21, 1.6, 2.1))
    told = ("filtered water of 2 frames is that of a survey: up to 21 frames together, "
            "ranges from 1.60 to 2.20 m")
    assert summary.surveyed() == told
    assert Summary.of_finished("bag", "out", summary.state(ORIGIN)).surveyed() == told
    assert counted(frame(TrackingEvent.UPDATED)).surveyed() == ""
