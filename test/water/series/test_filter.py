# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The filter over frames: begun anew with another rig, and off where it is turned off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.status import REFUTING, Status
from uw_visibility.water.blocks import Blocks
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.lamps.survey import LampSurvey
from uw_visibility.water.observations import observe
from uw_visibility.water.series.filter import WaterFilter
from uw_visibility.water.series.survey import SurveyEstimate
from uw_visibility.water.series.tracking import TrackingEvent
from uw_visibility_lab.simulation.lamps import default_rig, lighting_parameters

STARTED, UPDATED = TrackingEvent.STARTED, TrackingEvent.UPDATED


def water() -> WaterEstimate:
    covariance = np.diag([0.02**2, 0.01**2] * 3)
    return WaterEstimate(
        Status.OK, np.array([0.5, 0.3, 0.2]), np.array([0.1, 0.4, 0.6]), covariance, 9, 30,
        (Status.OK,) * 3,
    )


def test_another_rig_begins_anew_and_the_same_one_does_not() -> None:
    kept = WaterFilter(PipelineConfig())
    events = []
    for number, rig in enumerate(("a", "a", "b", "b", "a")):
        found = kept.update(water(), float(number), rig)
        assert found is not None
        events.append(found.event)
    assert events == [STARTED, UPDATED, STARTED, UPDATED, STARTED]


def test_a_filter_that_is_reset_begins_anew() -> None:
    kept = WaterFilter(PipelineConfig())
    grey = kept.update(replace(water(), grey_on_average=True), 0.0)
    assert grey is not None and grey.water.grey_on_average
    assert kept.known is not None
    kept.reset()
    assert kept.known is None
    found = kept.update(water(), 1.0)
    assert found is not None and found.event is STARTED and not found.water.grey_on_average


def test_what_is_filtered_is_assessed_too() -> None:
    kept = WaterFilter(PipelineConfig())
    first, second = (kept.update(water(), time) for time in (0.0, 1.0))
    assert first is not None and second is not None
    assert second.visibility.distance > 0
    assert second.visibility.distance_stddev < first.visibility.distance_stddev


def test_a_distance_that_is_no_longer_known_is_refused_for_the_reason_of_the_frame() -> None:
    kept = WaterFilter(PipelineConfig.from_parameters({"tracking.unseen_rate": 0.2}))
    kept.update(water(), 0.0)
    blind = WaterEstimate.not_assessable(Status.TOO_DARK)
    found = [kept.update(blind, time) for time in (0.2, 4.5)]
    assert [one.event for one in found if one] == [TrackingEvent.PREDICTED] * 2
    assert [one.visibility.status for one in found if one] == [Status.OK, Status.TOO_DARK]


@pytest.mark.parametrize("reason", sorted(REFUTING))
def test_a_frame_that_refutes_the_model_is_not_bridged_by_those_before(reason: Status) -> None:
    kept = WaterFilter(PipelineConfig())
    kept.update(water(), 0.0)
    frames = [WaterEstimate.not_assessable(why) for why in (Status.TOO_DARK, reason)]
    found = [kept.update(frame, 0.2 + 0.2 * k) for k, frame in enumerate([*frames, frames[0]])]
    assert [one.water.status for one in found if one] == [Status.OK, reason, Status.OK]
    assert [np.isfinite(one.visibility.distance) for one in found if one] == [True, False, True]


def statuses(odds: list[float]) -> list[Status]:
    """Filtered statuses of frames that say so of the camera's transfer."""
    kept = WaterFilter(PipelineConfig())
    found = [
        kept.update(replace(water(), transfer_log_odds=one), 0.2 * k)
        for k, one in enumerate(odds)]
    return [one.water.status for one in found if one is not None]


def test_a_transfer_that_no_frame_is_certain_of_is_told_by_some_of_them() -> None:
    told = statuses([2.5, 1.6, np.nan, 2.0, 2.4, 2.4])
    assert told == [Status.OK] * 4 + [Status.OTHER_TRANSFER] * 2


@pytest.mark.parametrize("odds", [
    [1.2] * 100, [9.0, -2.0] * 50, [-3.0] * 20 + [3.0] * 8, [np.nan] * 20, [9.0] * 3,
])
def test_small_odds_never_add_up_to_certainty(odds: list[float]) -> None:
    """Frames of one scene err alike."""
    assert set(statuses(odds)) == {Status.OK}


@pytest.mark.parametrize("other", [-3.0, 1.0])
def test_what_frames_of_a_recording_share_is_forgotten_where_stamps_jump_back(other: float) -> None:
    kept = WaterFilter(PipelineConfig())
    for k in range(6):
        frame = replace(water(), transfer_log_odds=3.0, lamps_log_odds=2.0)
        found = kept.update(frame, 0.2 * k)
    assert found is not None and found.water.status is Status.OTHER_TRANSFER
    with pytest.raises(InputError, match="stamp of the frame is nan"):
        kept.update(water(), np.nan)
    found = kept.update(replace(water(), transfer_log_odds=-0.5, lamps_log_odds=-5.0), other)
    assert found is not None and found.water.status is Status.OK


@pytest.mark.parametrize(("odds", "status"), [
    ([-1.0, -2.5, -1.0, -1.5], Status.LIGHT_UNCERTAIN),
    ([2.0, -2.5, 1.0, 1.0], Status.LIT_BY_LAMPS),
    ([-7.0] * 19 + [0.5], Status.OK), ([np.nan] * 3, Status.OK),
])
def test_a_frame_that_passes_for_daylight_among_those_by_lamps_is_none(
    odds: list[float], status: Status
) -> None:
    kept = WaterFilter(PipelineConfig())
    for k, one in enumerate(odds):
        found = kept.update(replace(water(), lamps_log_odds=one), 0.2 * k)
    assert found is not None and found.water.status is status
    assert np.isfinite(found.visibility.distance) == (status is Status.OK)


def test_frames_that_together_are_clearer_than_clear_water_are_refused() -> None:
    """Each is within three sigma of it, and the mean of five is not."""
    covariance = np.diag([0.05**2, 0.01**2] * 3)
    one = replace(water(), attenuation=np.array([0.17, 0.3, 0.2]), covariance=covariance)
    kept = WaterFilter(PipelineConfig.from_parameters({"tracking.common_error": 0.0}))
    found = [kept.update(one, float(number)) for number in range(8)]
    assert found[0] is not None and found[0].visibility.status is Status.OK
    assert found[-1] is not None
    assert found[-1].visibility.status is Status.CLEARER_THAN_CLEAR_WATER
    assert not np.isfinite(found[-1].water.attenuation).any()


def test_nothing_is_filtered_where_tracking_is_off() -> None:
    off = WaterFilter(PipelineConfig.from_parameters({"tracking.enabled": False}))
    assert off.update(water(), 0.0) is None


def flat(frame: int) -> WaterEstimate:
    """A frame of a survey, 2 m above the floor: its envelopes, and why that is all."""
    altitude = 2.0 + 0.3 * np.sin(0.4 * frame)
    distance = np.tile(altitude + np.linspace(-0.06, 0.06, 60), (25, 1))
    beta, light = np.array([0.5, 0.3, 0.25]), np.array([0.3, 0.6, 0.7])
    left = np.exp(-beta * distance[..., np.newaxis])
    shade = 0.9 * np.random.default_rng(frame).random((25, 60, 1)) ** 2
    shown = light * (1.0 - left * (1.0 - shade))
    blocks = Blocks(
        shown.astype(np.float32), distance.astype(np.float32), 1.0, np.zeros(3), np.zeros(3),
        np.full(3, 0.3 / 255), False, False)
    estimate = WaterEstimate.not_assessable(
        Status.RANGE_SPREAD_TOO_SMALL, observe(blocks, 0.001))
    return replace(estimate, blocks=blocks)


def test_frames_that_show_nothing_alone_do_together() -> None:
    kept = WaterFilter(PipelineConfig.from_parameters({"water.veil": "paper"}))
    found = [kept.update(flat(frame), float(frame), "rig") for frame in range(22)]
    assert [f is not None and f.survey is not None for f in found] == [False] * 19 + [True] * 3
    last = found[-1]
    assert last is not None and last.survey is not None
    assert last.event is TrackingEvent.SURVEYED
    assert (last.assessed, last.rejected) == (0, 0)
    assert str(last.survey) == "22 frames in 21 s, ranges from 1.64 to 2.36 m"
    error = (last.water.attenuation - (0.5, 0.3, 0.25)) / last.water.attenuation_stddev
    assert (np.abs(error) < 3.0).all()
    assert last.visibility.distance == pytest.approx(2.351 / last.water.attenuation.min(), rel=1e-3)
    # A frame that shows the water by itself is taken at its word.
    after = kept.update(water(), 22.0, "rig")
    assert after is not None and after.event is STARTED and after.survey is None
    # What another rig saw does not count.
    other = kept.update(flat(23), 23.0, "other")
    assert other is not None and other.survey is None


@pytest.mark.parametrize(("scale", "deviation", "taken"), [
    (2.0, 0.03, True), (0.5, 0.015, False), (2.0, 0.05, False),
])
def test_a_survey_under_lamps_is_taken_where_its_relative_deviation_is_smaller(
    monkeypatch: pytest.MonkeyPatch, scale: float, deviation: float, taken: bool
) -> None:
    """What is too clear has a small deviation, too: that alone says nothing."""
    one = water()
    together = replace(
        one, attenuation=scale * one.attenuation,
        covariance=np.diag([deviation**2, 0.01**2] * 3))
    monkeypatch.setattr(LampSurvey, "estimate", lambda _: SurveyEstimate(
        together, 40, 39.0, 1.0, 3.0))
    kept = WaterFilter(PipelineConfig.from_parameters(
        lighting_parameters(default_rig(2), daylight=False)))
    found = kept.update(one, 0.0)
    assert found is not None and (found.event is TrackingEvent.SURVEYED) == taken
    expected = together if taken else one
    np.testing.assert_allclose(found.water.attenuation, expected.attenuation, rtol=1e-6)


def test_no_survey_where_it_is_turned_off() -> None:
    off = WaterFilter(PipelineConfig.from_parameters({"survey.enabled": False}))
    for frame in range(22):
        found = off.update(flat(frame), float(frame))
    assert found is not None and found.event is TrackingEvent.NOT_ASSESSABLE
    assert found.water.status is Status.RANGE_SPREAD_TOO_SMALL


def test_the_water_is_known_until_the_filter_would_begin_anew() -> None:
    kept = WaterFilter(PipelineConfig())
    assert kept.known is None
    found = kept.update(water(), 1.0, "a")
    assert found is not None and kept.known is not None
    known = kept.known.at(2.0, "a")
    assert known is not None
    np.testing.assert_array_equal(known.attenuation, found.water.attenuation)
    late = 1.0 + PipelineConfig().tracking.timeout
    assert kept.known.at(late, "a") is not None
    for stamp, rig in ((late + 0.1, "a"), (1.0, "a"), (0.0, "a"), (2.0, "b")):
        assert kept.known.at(stamp, rig) is None
    kept.update(WaterEstimate.not_assessable(Status.TOO_DARK), 2.0, "a")
    assert kept.known is not None
    kept.update(WaterEstimate.not_assessable(Status.OTHER_TRANSFER), 3.0, "a")
    assert kept.known is None
    kept.update(water(), 4.0, "a")
    kept.reset()
    assert kept.known is None
