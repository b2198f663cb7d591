# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Spike-and-slab prior of attenuation, against draws of water and of errors."""

import numpy as np
import pytest
from scipy.special import erfcx

from uw_visibility.water.daylight.clear_water import (
    CLEAR,
    SPREAD,
    hold_above_clear_water,
    inverse_mills,
)
from uw_visibility.water.daylight.fit import Fit

KAPPA = np.array([0.228, 0.066, 0.025])


def fit(attenuation, stddev, alike=0.99):
    """Return a fit whose errors are alike in the channels, and move the veil against them."""
    covariance = np.zeros((6, 6))
    covariance[0::2, 0::2] = stddev**2 * (alike + (1 - alike) * np.eye(3))
    gain = -0.5
    covariance[0::2, 1::2] = covariance[1::2, 0::2] = gain * covariance[0::2, 0::2]
    covariance[1::2, 1::2] = gain**2 * covariance[0::2, 0::2] + 1e-4 * np.eye(3)
    values = np.stack((attenuation, np.full(3, 0.5)), axis=1)
    return Fit(values, covariance, 10, True)


def test_what_is_far_above_stays():
    before = fit(KAPPA + 0.2, 0.02)
    after = hold_above_clear_water(before, KAPPA)
    np.testing.assert_allclose(after.parameters, before.parameters, rtol=1e-3)
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=0.01)


def test_what_is_uncertain_and_below_is_not_sure_to_be_clear_water():
    after = hold_above_clear_water(fit(KAPPA - 0.05, 0.05), KAPPA)
    above = after.parameters[:, 0] - KAPPA
    deviation = np.sqrt(np.diag(after.covariance)[0::2])
    assert (above > 0.5 * deviation).all()
    # Far more than the tenth to which clear water itself is known.
    assert (deviation > 0.015).all()
    # The veil follows, as far as it varies with attenuation.
    assert (after.parameters[:, 1] < 0.5).all()


def test_what_is_sure_and_at_clear_water_stays_there():
    after = hold_above_clear_water(fit(KAPPA, 0.004), KAPPA)
    np.testing.assert_allclose(after.parameters[:, 0], KAPPA, atol=0.002)


@pytest.mark.parametrize("stddev", [0.01, 0.03, 0.05])
def test_errors_follow_the_standard_deviation_over_waters(stddev):
    rng = np.random.default_rng(1)
    error = stddev * (np.sqrt(0.99) * rng.normal(size=(2000, 1)) + np.sqrt(0.01) * rng.normal(
        size=(2000, 3)))
    clear = rng.random(2000) < CLEAR
    true = KAPPA + np.where(clear, 0.0, rng.uniform(0.0, SPREAD, 2000))[:, np.newaxis]
    found = [hold_above_clear_water(fit(seen, stddev), KAPPA) for seen in true + error]
    off = np.array([f.parameters[:, 0] for f in found]) - true
    deviation = np.array([np.sqrt(np.diag(f.covariance)[0::2]) for f in found])
    # By what is seen: of waters alike, those that look clearer are not as clear as they look.
    near = (true + error - KAPPA).mean(axis=1) < 2.0 * stddev
    for some in (near, ~near):
        assert np.abs((off[some] / deviation[some]).mean()) < 0.5
        assert 0.75 < np.sqrt(((off[some] / deviation[some]) ** 2).mean()) < 1.3
    # Closer to the truth than the image alone.
    assert (off[near] ** 2).mean() < 0.9 * (error[near] ** 2).mean()


@pytest.mark.parametrize("stddev", [1e-3, 1.0, 1e3])
def test_channels_that_are_known_together_alone_stay_finite(stddev):
    """Rounding leaves variances below zero of channels whose errors are the same."""
    for shift in (-1e8, -1e6, -1e4, -2.0, 0.5):
        after = hold_above_clear_water(fit(KAPPA + shift * stddev, stddev, alike=1.0), KAPPA)
        assert np.isfinite(after.parameters).all()
        assert np.isfinite(after.covariance).all()


@pytest.mark.parametrize("a", [-60.0, -3.0, 0.0, 4.0, 24.9, 25.1, 200.0])
def test_mean_of_a_truncated_normal_law_far_out_as_well(a):
    expected = np.sqrt(2.0 / np.pi) / erfcx(a / np.sqrt(2.0))
    assert inverse_mills(a) == pytest.approx(expected, rel=1e-8, abs=1e-300)
