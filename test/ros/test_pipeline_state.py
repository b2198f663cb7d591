# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the pipeline: what the filter over frames did."""

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")

from uw_visibility.ros.monitor.finding import OK, WARN
from uw_visibility.ros.monitor.reasons import ReasonLog
from uw_visibility.ros.pipeline_state import PipelineState
from uw_visibility.status import Status
from uw_visibility.water.assessment import Visibility
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.filter import FilteredWater
from uw_visibility.water.survey import SurveyEstimate
from uw_visibility.water.tracking import TrackingEvent

FLAT = Status.RANGE_SPREAD_TOO_SMALL
VISIBILITY = Visibility(FLAT, FLAT)


def result(status: Status) -> Any:
    return SimpleNamespace(
        status=status, visibility=VISIBILITY, timing_ms={},
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
