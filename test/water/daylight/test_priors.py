# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What is expected of any water decides where the image does not, and nowhere else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import KAPPA

from uw_visibility.water.daylight.fit import Fit
from uw_visibility.water.daylight.priors import NOTHING_EXPECTED, Daylight, fuse

WHITE = np.ones(3)


def fit_of(beta, ambient, beta_stddev, ambient_stddev):
    """A fit whose channels are independent."""
    stddev = np.stack((np.broadcast_to(beta_stddev, 3), np.broadcast_to(ambient_stddev, 3)), 1)
    return Fit(np.stack((beta, ambient), axis=1), np.diag(stddev.ravel() ** 2), 10, True)


def combined(fit, bright, daylight=None, tolerance=0.15):
    return fuse(fit, KAPPA, np.asarray(bright), daylight, tolerance)


@given(st.floats(0.0, 0.5), st.floats(0.5, 10.0), st.floats(0.2, 1.0))
@settings(max_examples=50, deadline=None)
def test_what_the_image_knows_well_stays(alpha, depth, exposure):
    beta = KAPPA * np.array([1.0, 1.5, 3.0]) + alpha
    ambient = exposure * np.exp(-beta * depth) * np.array([0.7, 1.0, 0.8])
    fit = fit_of(beta, ambient, 1e-4, 1e-4 * ambient)
    found = combined(fit, 0.8 * ambient, Daylight(WHITE, KAPPA))
    np.testing.assert_allclose(found.parameters[:, 0], beta, atol=1e-3)
    np.testing.assert_allclose(found.parameters[:, 1], ambient, rtol=1e-3)


def test_unseen_blue_follows_from_red_and_green_and_the_law_of_daylight():
    depth, exposure = 4.0, 0.9
    ambient = exposure * np.exp(-KAPPA * depth)
    seen = ambient * [1.0, 1.0, 0.7]
    fit = fit_of(KAPPA, seen, 1e-3, [0.01, 0.01, 0.6])
    bright = ambient * [0.95, 0.95, 0.7]
    found = combined(fit, bright, Daylight(WHITE, KAPPA), 0.05)
    assert found.parameters[2, 1] == pytest.approx(ambient[2], rel=0.06)
    without = combined(fit, bright)
    assert without.parameters[2, 1] == pytest.approx(0.7 * ambient[2], rel=0.03)
    # ... and is known better for it.
    assert found.covariance[5, 5] < 0.3 * without.covariance[5, 5]


def test_the_cameras_white_counts():
    ambient = np.exp(-KAPPA * 3.0)
    reference = np.array([0.8, 1.0, 1.3])
    fit = fit_of(KAPPA, ambient * reference, 1e-3, [0.01, 0.01, 0.6])
    bright = 0.5 * ambient * reference
    right = combined(fit, bright, Daylight(reference, KAPPA), 0.05)
    wrong = combined(fit, bright, Daylight(WHITE, KAPPA), 0.05)
    assert abs(right.parameters[2, 1] / fit.parameters[2, 1] - 1) < 0.05
    assert abs(wrong.parameters[2, 1] / fit.parameters[2, 1] - 1) > 0.15


def test_the_waters_own_attenuation_can_stand_for_that_above():
    beta = KAPPA + np.array([0.1, 0.1, 0.4])
    ambient = np.exp(-beta * 2.0)
    fit = fit_of(beta, ambient, 1e-4, [0.005, 0.005, 0.3])
    own = combined(fit, 0.5 * ambient, Daylight(WHITE, None), 0.05)
    np.testing.assert_allclose(own.parameters[:, 1], ambient, rtol=0.08)
    clear = combined(fit, 0.5 * ambient, Daylight(WHITE, KAPPA), 0.05)
    assert clear.parameters[2, 1] > 1.15 * ambient[2]


def test_channels_that_are_not_seen_take_after_those_that_are():
    beta = KAPPA + np.array([0.2, 0.2, 0.5])
    ambient = np.full(3, 0.5)
    fit = fit_of(beta, ambient, [0.003, 0.003, 0.4], 0.005)
    found = combined(fit, ambient)
    assert abs(found.parameters[2, 0] - KAPPA[2] - 0.2) < 0.1
    np.testing.assert_allclose(found.parameters[:2, 0], beta[:2], atol=0.01)
    assert found.covariance[4, 4] < 0.5 * fit.covariance[4, 4]


def test_a_contradicted_expectation_gives_way():
    """Yellow matter: blue is attenuated by far more than red, and the image shows it."""
    beta = KAPPA + np.array([0.1, 0.2, 0.8])
    ambient = np.array([0.2, 0.6, 0.05])
    fit = fit_of(beta, ambient, 0.04, 0.08 * ambient)
    found = combined(fit, 0.9 * ambient, Daylight(WHITE, KAPPA))
    deviation = np.sqrt(np.diag(fit.covariance)).reshape(3, 2)
    assert (np.abs(found.parameters - fit.parameters) < deviation).all()


def test_expecting_nothing_of_daylight_is_possible():
    ambient = np.array([0.2, 0.6, 0.05])
    fit = fit_of(KAPPA + 0.2, ambient, 0.01, 0.2 * ambient)
    nothing = combined(fit, 0.9 * ambient, Daylight(WHITE, KAPPA), NOTHING_EXPECTED)
    without = combined(fit, 0.9 * ambient)
    np.testing.assert_allclose(nothing.parameters, without.parameters, rtol=1e-3)


def test_covariance_stays_one_and_never_grows():
    rng = np.random.default_rng(0)
    ambient = np.array([0.4, 0.6, 0.7])
    root = rng.normal(0, 0.05, (6, 6))
    fit = Fit(np.stack((KAPPA + 0.1, ambient), 1), root @ root.T, 10, True)
    found = combined(fit, 0.9 * ambient, Daylight(WHITE, KAPPA))
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
    assert (np.linalg.eigvalsh(found.covariance) > -1e-12).all()
    before = fit.covariance / np.outer(fit.parameters.ravel(), fit.parameters.ravel())
    after = found.covariance / np.outer(found.parameters.ravel(), found.parameters.ravel())
    assert np.diag(after)[1::2].sum() < np.diag(before)[1::2].sum()
    assert np.diag(found.covariance)[0::2].sum() < np.diag(fit.covariance)[0::2].sum()


def test_ambient_light_stays_above_the_bright_envelope():
    ambient = np.array([0.5, 0.5, 0.5])
    fit = fit_of(KAPPA + 0.1, ambient, 0.01, [0.005, 0.005, 0.3])
    found = combined(fit, ambient, Daylight(np.array([1.0, 1.0, 0.3]), KAPPA), 0.02)
    assert (found.parameters[:, 1] >= 0.5).all()
