# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fits of the dark envelope for a given veil."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import KAPPA

from uw_visibility.water.daylight.dark_fit import fit_of_veil
from uw_visibility.water.daylight.veil_components import PossibleVeil
from uw_visibility.water.observations import Envelopes

BETA = np.array([0.8, 0.2, 0.15])
VEIL = np.array([0.035, 0.4, 0.5])
DEVIATION = 0.003


@pytest.mark.parametrize(("lighter", "may_be"), [(0.0, True), (1.5, True), (3.0, False)])
def test_a_veil_may_be_darker_than_dark_patches_by_noise_alone(lighter, may_be):
    """Far off, what is left of red is its veil, a few code values."""
    distance = np.geomspace(4.0, 16.0, 16)
    ranges = np.tile(distance, (3, 1))
    dark = VEIL[:, np.newaxis] * (1.0 - np.exp(-BETA[:, np.newaxis] * distance))
    bright = dark + 0.8 * VEIL[:, np.newaxis] * np.exp(-BETA[:, np.newaxis] * distance)
    deviation = np.full((3, 16), DEVIATION)
    envelope = Envelopes(
        distance, np.full(16, 1000), dark, ranges, bright, np.full((3, 16), 1 / 255), deviation,
        np.full(3, 0.5), 16000, np.zeros(3), np.zeros(3), False)
    bound = np.median(dark, axis=1) - lighter * DEVIATION * np.array([1.0, 0.0, 0.0])
    fit = fit_of_veil(envelope, np.ones(3, np.bool_), KAPPA)
    veil = np.array([bound[0], VEIL[1], VEIL[2]])
    assert (fit(PossibleVeil(0.9 * veil, veil, np.ones(3))) is not None) == may_be
