# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The recursion over frames, on drawn estimates whose errors are known."""

import dataclasses
import math

import numpy as np
import pytest

from uw_visibility.config.schema import AssessmentConfig, TrackingConfig
from uw_visibility.errors import InputError
from uw_visibility.optics.light_model import ambient_light_at_depth
from uw_visibility.optics.spectra import load_response
from uw_visibility.status import Status
from uw_visibility.water.assessment import Assessor
from uw_visibility.water.estimation import WaterEstimate
from uw_visibility.water.tracking import TrackingEvent, WaterTracker

ASSESSOR = Assessor(AssessmentConfig(), load_response("nikon_d5100"))
KAPPA = ASSESSOR.clear_water_attenuation
BETA = KAPPA + 0.15
LIGHT = ambient_light_at_depth(BETA, 4.0)
PERIOD = 0.2


def drawn(rng, attenuation=BETA, light=LIGHT, gain=1.0, scale=1.0, common=None, share=0.5):
    """One frame's estimate of known water; ``common`` is the error that frames share."""
    light = gain * np.asarray(light)
    root = np.zeros((6, 6))
    for channel in range(3):
        at = 2 * channel
        root[at, at] = 0.02
        root[at + 1, at + 1] = 0.01 * light[channel]
        root[at + 1, at] = -0.02 * light[channel]
    root[0::2, 0::2] += 0.01
    root *= scale
    joint = root @ root.T
    new = rng.standard_normal(6)
    error = root @ (
        new if common is None else math.sqrt(1 - share) * new + math.sqrt(share) * common
    )
    return WaterEstimate(
        Status.OK, attenuation + error[0::2], light + error[1::2],
        np.stack([joint[2 * c:2 * c + 2, 2 * c:2 * c + 2] for c in range(3)]), 12, 40,
        (Status.OK,) * 3, joint_covariance=joint)


def alpha(estimate):
    return float(np.mean(estimate.attenuation - KAPPA))


def chromaticity(estimate):
    return estimate.ambient_light / estimate.ambient_light.sum()


def settled(rng, tracker=None, frames=30, **water):
    """A tracker that has seen a while of steady water, and the time of its last frame."""
    tracker = tracker or WaterTracker()
    for k in range(frames):
        tracker.update(drawn(rng, **water), k * PERIOD)
    return tracker, (frames - 1) * PERIOD


def test_the_first_frame_is_taken_as_it_is():
    tracker = WaterTracker()
    frame = drawn(np.random.default_rng(0))
    out = tracker.update(frame, 3.0)
    assert tracker.event is TrackingEvent.STARTED
    np.testing.assert_allclose(out.attenuation, frame.attenuation)
    np.testing.assert_allclose(out.ambient_light, frame.ambient_light)
    np.testing.assert_allclose(out.joint_covariance, frame.joint_covariance, atol=1e-12)


def test_frame_to_frame_changes_are_less_than_half_and_nothing_is_biased():
    rng = np.random.default_rng(1)
    tracker = WaterTracker()
    raw, filtered = [], []
    for k in range(300):
        frame = drawn(rng)
        raw.append(alpha(frame))
        filtered.append(alpha(tracker.update(frame, k * PERIOD)))
    assert np.std(np.diff(filtered[5:])) < 0.5 * np.std(np.diff(raw[5:]))
    assert np.std(filtered[5:]) < 0.6 * np.std(raw[5:])
    assert abs(np.mean(filtered[5:]) - 0.15) < 0.003


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_standard_deviations_hold_where_frames_share_a_part_of_their_errors(share):
    """Normalised squared error of β and I∞, over trackers of another shared error each."""
    squares = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        tracker = WaterTracker(TrackingConfig(common_error=share, exposure_change=0.0))
        common = rng.standard_normal(6)
        for k in range(15):
            out = tracker.update(drawn(rng, common=common, share=share), k * PERIOD)
        error = np.empty(6)
        error[0::2], error[1::2] = out.attenuation - BETA, out.ambient_light - LIGHT
        squares.append(error @ np.linalg.solve(out.joint_covariance, error))
    # Chi squared has a mean of 6; that of 60 values a deviation of 0.45. Water that
    # does not wander, as here, is followed better than the process noise says.
    assert 2.0 < np.mean(squares) < 7.4


def test_a_jump_of_the_exposure_leaves_attenuation_and_chromaticity_alone():
    rng = np.random.default_rng(2)
    tracker, stamp = settled(rng)
    before = tracker.estimate
    after = tracker.update(drawn(rng, gain=0.5), stamp + PERIOD)
    assert tracker.event is TrackingEvent.UPDATED
    np.testing.assert_allclose(after.ambient_light.sum(), 0.5 * before.ambient_light.sum(),
                               rtol=0.06)
    assert abs(alpha(after) - alpha(before)) < 0.015
    np.testing.assert_allclose(chromaticity(after), chromaticity(before), atol=0.01)


def test_a_fixed_exposure_takes_such_a_jump_for_an_outlier():
    rng = np.random.default_rng(2)
    tracker, stamp = settled(rng, WaterTracker(TrackingConfig(exposure_change=0.0)))
    tracker.update(drawn(rng, gain=0.5), stamp + PERIOD)
    assert tracker.event is TrackingEvent.OUTLIER


def test_one_outlier_changes_nothing():
    rng = np.random.default_rng(3)
    tracker, stamp = settled(rng)
    before = tracker.estimate
    after = tracker.update(drawn(rng, attenuation=BETA + 0.6), stamp + PERIOD)
    assert tracker.event is TrackingEvent.OUTLIER
    np.testing.assert_allclose(after.attenuation, before.attenuation, atol=1e-9)
    assert (after.attenuation_stddev >= before.attenuation_stddev).all()
    tracker.update(drawn(rng), stamp + 2 * PERIOD)
    assert tracker.event is TrackingEvent.UPDATED


def test_outliers_that_contradict_one_another_never_become_the_state():
    rng = np.random.default_rng(4)
    tracker, stamp = settled(rng)
    for k in range(8):
        wild = drawn(rng, attenuation=BETA + (0.5 if k % 2 else 1.5))
        tracker.update(wild, stamp + (k + 1) * PERIOD)
        assert tracker.event is TrackingEvent.OUTLIER
    assert abs(alpha(tracker.estimate) - 0.15) < 0.02


@pytest.mark.parametrize("step", [0.05, 0.1, 0.3, -0.1])
def test_a_step_in_turbidity_is_followed_within_ten_frames(step):
    errors = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        tracker, stamp = settled(rng)
        for k in range(10):
            tracker.update(drawn(rng, attenuation=BETA + step), stamp + (k + 1) * PERIOD)
        errors.append(alpha(tracker.estimate) - 0.15 - step)
    assert abs(np.mean(errors)) < 0.15 * abs(step) + 0.005


def test_a_large_step_restarts_from_the_frames_that_agree():
    rng = np.random.default_rng(5)
    tracker, stamp = settled(rng)
    events = []
    for k in range(4):
        tracker.update(drawn(rng, attenuation=BETA + 0.5), stamp + (k + 1) * PERIOD)
        events.append(tracker.event)
    assert events == [TrackingEvent.OUTLIER, TrackingEvent.OUTLIER, TrackingEvent.RESTARTED,
                      TrackingEvent.UPDATED]
    assert abs(alpha(tracker.estimate) - 0.65) < 0.05


def test_frames_without_an_estimate_are_predicted_until_the_timeout():
    rng = np.random.default_rng(6)
    tracker, stamp = settled(rng, WaterTracker(TrackingConfig(timeout=1.0)))
    blind = WaterEstimate.not_assessable(Status.TOO_FEW_SUPPORT_POINTS)
    last = tracker.estimate
    for k in range(1, 6):
        out = tracker.update(blind, stamp + k * PERIOD)
        assert tracker.event is TrackingEvent.PREDICTED
        assert out.status is Status.OK
        np.testing.assert_allclose(out.attenuation, last.attenuation)
        assert (out.attenuation_stddev > last.attenuation_stddev).all()
        last = out
    out = tracker.update(blind, stamp + 6 * PERIOD)
    assert tracker.event is TrackingEvent.NOT_ASSESSABLE
    assert out.status is Status.TOO_FEW_SUPPORT_POINTS
    assert np.isnan(out.attenuation).all()


def test_before_any_estimate_there_is_no_state():
    out = WaterTracker().update(WaterEstimate.not_assessable(Status.NO_COLOUR), 0.0)
    assert out.status is Status.NO_COLOUR
    assert np.isnan(out.attenuation).all()


def without_red(frame):
    covariance, joint = frame.covariance.copy(), frame.joint_covariance.copy()
    covariance[0], joint[:2, :], joint[:, :2] = np.nan, np.nan, np.nan
    attenuation, light = frame.attenuation.copy(), frame.ambient_light.copy()
    attenuation[0] = light[0] = np.nan
    return dataclasses.replace(
        frame, status=Status.TOO_DARK, attenuation=attenuation, ambient_light=light,
        covariance=covariance, joint_covariance=joint,
        channel_status=(Status.TOO_DARK, Status.OK, Status.OK))


def test_a_channel_that_goes_dark_is_predicted_then_refused_and_comes_back():
    rng = np.random.default_rng(7)
    tracker, stamp = settled(rng, WaterTracker(TrackingConfig(timeout=1.0)))
    for k in range(1, 6):
        out = tracker.update(without_red(drawn(rng)), stamp + k * PERIOD)
        assert out.status is Status.OK
    out = tracker.update(without_red(drawn(rng)), stamp + 6 * PERIOD)
    assert out.channel_status == (Status.TOO_DARK, Status.OK, Status.OK)
    assert out.status is Status.TOO_DARK
    assert np.isnan(out.joint_covariance[0]).all()
    assert np.isfinite(out.joint_covariance[2:, 2:]).all()
    back = drawn(rng)
    out = tracker.update(back, stamp + 7 * PERIOD)
    assert out.status is Status.OK
    assert out.attenuation[0] == pytest.approx(back.attenuation[0], abs=0.03)
    assert out.attenuation_stddev[0] < 0.05


def test_a_channel_that_was_never_seen_is_not_invented():
    rng = np.random.default_rng(8)
    tracker = WaterTracker()
    for k in range(3):
        out = tracker.update(without_red(drawn(rng)), k * PERIOD)
    assert np.isnan(out.attenuation[0])
    assert np.isfinite(out.attenuation[1:]).all()


@pytest.mark.parametrize("stamp", [2.0, 5.8, 5.0, 60.0])
def test_stamps_that_stand_still_go_back_or_leave_a_gap_begin_anew(stamp):
    rng = np.random.default_rng(9)
    tracker, last = settled(rng)
    assert last == pytest.approx(5.8)
    frame = drawn(rng, attenuation=BETA + 0.3)
    out = tracker.update(frame, stamp if stamp != 5.8 else last)
    assert tracker.event is TrackingEvent.STARTED
    np.testing.assert_allclose(out.attenuation, frame.attenuation)


def test_what_is_longer_unseen_is_less_certain():
    spreads = []
    for gap in (0.1, 1.0, 4.0):
        tracker, stamp = settled(np.random.default_rng(10))
        blind = WaterEstimate.not_assessable(Status.TOO_DARK)
        spreads.append(tracker.update(blind, stamp + gap).attenuation_stddev)
    assert (np.diff(spreads, axis=0) > 0).all()


@pytest.mark.parametrize("stamp", [math.nan, math.inf])
def test_a_stamp_that_is_no_time_is_refused(stamp):
    with pytest.raises(InputError, match="stamp"):
        WaterTracker().update(drawn(np.random.default_rng(0)), stamp)


def test_the_filtered_state_is_assessed_like_any_other():
    tracker, _ = settled(np.random.default_rng(11))
    seen = ASSESSOR.assess(tracker.estimate)
    assert seen.status is seen.depth_status is Status.OK
    assert abs(seen.mean_attenuation - 0.15) < 3 * seen.mean_attenuation_stddev
    assert abs(seen.depth - 4.0) < 3 * seen.depth_stddev


def test_attenuation_stays_positive():
    rng = np.random.default_rng(12)
    tracker = WaterTracker()
    for k in range(40):
        frame = drawn(rng, attenuation=np.full(3, 0.02), scale=3.0)
        frame = dataclasses.replace(frame, attenuation=np.maximum(frame.attenuation, 1e-4))
        assert (tracker.update(frame, k * PERIOD).attenuation > 0).all()
