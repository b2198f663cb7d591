# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the pipeline: what the filter over frames did."""

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")

from uw_visibility.ros.monitor import OK, WARN, ReasonLog
from uw_visibility.ros.pipeline_state import PipelineState
from uw_visibility.status import Status
from uw_visibility.water.assessment import Visibility
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.filter import FilteredWater
from uw_visibility.water.survey import SurveyEstimate
from uw_visibility.water.tracking import TrackingEvent

FLAT = Status.RANGE_SPREAD_TOO_SMALL
VISIBILITY = Visibility(FLAT, FLAT)


def result(status: Status, distance: Status | None = None) -> Any:
    return SimpleNamespace(
        status=status, visibility=Visibility(distance or status, FLAT), timing_ms={},
        stereo=SimpleNamespace(support_points=100, coverage=0.5, matched_fraction=0.5),
    )


def state() -> PipelineState:
    return PipelineState(ReasonLog(lambda _: None))


def test_rejected_frames_are_counted() -> None:
    kept = state()
    water = WaterEstimate.not_assessable(FLAT)
    kept.add(result(Status.OK), 0.1, 1.0, FilteredWater(
        water, VISIBILITY, TrackingEvent.OUTLIER, 200, 3, 1))
    finding = kept.diagnose("", 0)
    assert finding.level == OK
    assert finding.values["rejected by the filter"] == "3 of 200 frames"
    assert finding.values["rejected by the filter in a row"] == 1
    assert str(finding.values["filter"]) == "outlier"


def test_a_survey_says_over_what_it_rests() -> None:
    kept = state()
    water = WaterEstimate.not_assessable(FLAT)
    kept.add(result(FLAT), 0.1, 1.0)
    assert kept.diagnose("", 0).level == WARN
    survey = SurveyEstimate(water, 60, 59.0, 1.65, 2.34)
    kept.add(result(FLAT), 0.1, 1.0, FilteredWater(
        water, VISIBILITY, TrackingEvent.SURVEYED, 0, 0, 0, survey))
    finding = kept.diagnose("", 0)
    assert finding.level == OK
    assert "60 frames in 59 s, ranges from 1.65 to 2.34 m" in finding.message


def test_a_distance_that_is_not_told_has_its_reason() -> None:
    kept = state()
    kept.add(result(Status.OK, FLAT), 0.1, 1.0)
    finding = kept.diagnose("", 0)
    assert finding.level == WARN
    assert finding.message == f"the visibility distance is not assessable: {FLAT}"


def test_frames_that_were_lost_do_not_hide_why_there_is_no_water() -> None:
    kept = state()
    kept.diagnose("", 0)
    kept.refuse("dropped a frame: left image: too dark")
    assert kept.diagnose("", 0).message == "dropped a frame: left image: too dark"
    kept.add(result(FLAT), 0.1, 1.0)
    finding = kept.diagnose("", 0)
    assert finding.level == WARN
    assert finding.message == f"the water is not assessable: {FLAT}; frames were lost lately"
    kept.add(result(Status.OK), 0.1, 1.0)
    assert kept.diagnose("", 0).message == "frames were lost lately"
