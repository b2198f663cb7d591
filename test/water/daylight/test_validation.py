# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Validation of an estimate against another one."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.status import Status
from uw_visibility.water.daylight.validation import compare_steps, refute_clearness
from uw_visibility.water.estimate import WaterEstimate

BETA = np.array([0.4, 0.2, 0.15])


def estimate(attenuation: np.ndarray, part: float = 0.1) -> WaterEstimate:
    """Estimate whose deviation is a part of attenuation."""
    covariance = 1e-4 * np.eye(6)
    covariance[0::2, 0::2] = np.diag((part * attenuation) ** 2)
    return WaterEstimate(
        Status.OK, attenuation, np.full(3, 0.5), covariance, 10, 20, (Status.OK,) * 3)


@pytest.mark.parametrize(("factor", "part", "holds"), [
    ((1.0, 1.0, 1.0), 0.1, True),
    # 2.5 deviations.
    ((0.7, 0.7, 0.7), 0.1, True),
    # A channel alone.
    ((1.0, 1.0, 0.4), 0.1, False),
    ((0.4, 0.4, 0.4), 0.1, False),
    # Many deviations, but little.
    ((0.85, 0.85, 0.85), 0.01, True),
    ((0.5, 0.5, 0.5), 0.4, True),
    # A mesh that covers open water shows clearer water than there is.
    ((2.5, 2.5, 2.5), 0.1, True),
])
def test_steps_that_contradict_each_other_are_refused(factor, part, holds):
    second = estimate(BETA * factor, part)
    found = compare_steps(estimate(BETA, part), second)
    assert (found is second) == holds
    if not holds:
        assert found.status is Status.STEPS_DISAGREE
        assert np.isnan(found.attenuation).all()


def test_a_step_that_knows_nothing_contradicts_nothing():
    second = estimate(BETA)
    assert compare_steps(WaterEstimate.not_assessable(Status.TOO_DARK), second) is second
    nothing = WaterEstimate.not_assessable(Status.SATURATED)
    assert compare_steps(second, nothing) is nothing
    part = estimate(np.array([np.nan, 0.2, 0.15]))
    assert compare_steps(part, second) is second


@pytest.mark.parametrize(("below", "expected"), [
    # In deviations: one channel far below; all a little, which is far together; two of three not.
    ((4.0, -9.0, -9.0), Status.CLEARER_THAN_CLEAR_WATER),
    ((2.0, 2.0, 2.0), Status.CLEARER_THAN_CLEAR_WATER),
    ((2.0, 2.0, -2.0), Status.OK),
    ((np.nan, 2.0, 2.0), Status.OK),
])
def test_water_is_refuted_that_is_clearer_in_one_channel_or_in_all_together(
    below: tuple[float, ...], expected: Status
) -> None:
    clear_water, stddev = np.array((0.22, 0.066, 0.0245)), 0.005
    attenuation = clear_water - stddev * np.array(below)
    assert refute_clearness(attenuation, np.eye(3) * stddev**2, clear_water) is expected
