# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Averaging of estimates over the transfer that was told and the other one."""

import numpy as np
import pytest

from uw_visibility.water.daylight.transfer_check import OtherTransfer, negligible

TOLD = np.array([[0.6, 0.3], [0.45, 0.5], [0.4, 0.6]])
KNOWN = np.diag(np.full(6, 1e-4))


def other(log_odds: float, attenuation: float = 0.6, veil: float = 0.5) -> OtherTransfer:
    return OtherTransfer(log_odds, TOLD * (attenuation, veil), TOLD)


def test_an_estimate_moves_towards_the_other_transfer_and_is_less_sure():
    moved = {}
    for odds in (0.0, 2.0, 3.0):
        parameters, covariance = other(odds).averaged(TOLD, KNOWN)
        assert (0.6 * TOLD[:, 0] < parameters[:, 0]).all()
        moved[odds] = parameters[0, 0], covariance[0, 0]
        assert np.linalg.eigvalsh(covariance).min() > 0.0
    attenuation, variance = zip(*moved.values(), strict=True)
    assert list(attenuation) == sorted(attenuation, reverse=True)
    assert list(variance) == sorted(variance)
    assert variance[0] > 4.0 * KNOWN[0, 0]
    assert variance[0] < 0.25 * 0.4**2 * 0.6**2


def test_brightness_of_the_veil_is_exposure():
    parameters, covariance = other(2.0, veil=0.2).averaged(TOLD, KNOWN)
    np.testing.assert_allclose(parameters[:, 1], TOLD[:, 1])
    np.testing.assert_allclose(np.diag(covariance)[1::2], 1e-4)


def test_channels_that_do_not_count_stay():
    gone = np.array([[np.nan], [1.0], [1.0]])
    one = OtherTransfer(2.0, gone * TOLD * (0.6, 0.5), gone * TOLD)
    parameters, covariance = one.averaged(TOLD, KNOWN)
    assert np.isfinite(covariance).all()
    np.testing.assert_array_equal(parameters[0], TOLD[0])
    assert (parameters[1:, 0] < TOLD[1:, 0]).all()


@pytest.mark.parametrize(("log_odds", "leaves"), [(-5.0, True), (2.0, False)])
def test_an_unlikely_transfer_is_negligible(log_odds, leaves):
    assert negligible(log_odds) is leaves
