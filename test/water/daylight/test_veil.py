# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Model averaging over the veil."""

from dataclasses import replace

import numpy as np
from scenes import KAPPA, water_view

from uw_visibility.config.schema import WaterConfig
from uw_visibility.optics.light_model import transmission
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.daylight.fit import Fit
from uw_visibility.water.daylight.veil import fit_free_veil

# A dark patch so far away shows so much light.
RANGE, SHOWN = 6.0, 0.3
BRIGHTEST = np.full(3, 0.4)


def veil_of(attenuation):
    """Veil that the dark patch shows, if that is the attenuation."""
    return SHOWN / (1.0 - transmission(attenuation, RANGE))


def test_the_veil_goes_with_the_attenuation_that_priors_have_moved():
    view = water_view()
    envelope = WaterEstimator(WaterConfig(), KAPPA).estimate(
        view.codes(), view.range, range_error=0.0).envelope
    badly_known, held = 0.2, 0.45

    def fit(veil, attenuation=None):
        """Dark envelope that knows the attenuation badly, and the veil for each of them."""
        if (veil.lower != BRIGHTEST).any():
            # As the paper has it the veil is no darker than what is brightest; no other is asked.
            return None
        beta = np.full(3, badly_known) if attenuation is None else attenuation
        slope = (veil_of(badly_known + 1e-4) - veil_of(badly_known)) / 1e-4
        block = 0.2**2 * np.array(((1.0, slope), (slope, slope**2)))
        covariance = np.kron(np.eye(3), block + np.diag((0.0, 1e-8)))
        return Fit(np.stack((beta, veil_of(beta)), axis=1), covariance, 1, True)

    def fuse(found, light, veil, tolerance):
        """Priors that know the attenuation, and take the veil along."""
        step = held - badly_known
        slope = found.covariance[0, 1] / found.covariance[0, 0]
        return replace(
            found, parameters=found.parameters + np.array((step, step * slope)),
            covariance=np.diag(np.tile((1e-4, 1e-8), 3)))

    found = fit_free_veil(
        fit, fuse, envelope, np.full(3, True), BRIGHTEST, np.full(3, 0.05), None, None)

    attenuation, veil = found.fit.parameters.T
    np.testing.assert_allclose(attenuation, held, rtol=1e-3)
    np.testing.assert_allclose(veil, veil_of(held), rtol=1e-3)
