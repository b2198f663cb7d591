# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Spike-and-slab prior of attenuation: that of clear water, or any above it.

No water is clearer than clear sea water (eq. 3). Where an image alone says so, or nearly, the water
is either about that clear, or its attenuation is the part of the image's normal distribution above
clear water's. An estimate raised to clear water's own would be sure of the farthest visibility
there is; one that is always above would never find clear water (Mitchell and Beauchamp 1988,
doi:10.1080/01621459.1988.10478694).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array
from uw_visibility.water.daylight.fit import Fit, measure, move, moved
from uw_visibility.water.daylight.priors import CLEAR_WATER_TOLERANCE

# Waters that are clear beforehand, and the attenuation by particles, 1/m, over which the
# others are spread.
CLEAR = 0.05
SPREAD = 0.6
# Clear water that is less likely than this is left out.
LEAST_CLEAR_SHARE = 1e-3
# Deviations from which on the normal law's tail is taken from its expansion.
FAR = 25.0


def hold_above_clear_water(fit: Fit, clear_water: Array) -> Fit:
    """Mean and covariance of a fit of all channels under the spike-and-slab prior."""
    values, covariance, cost = _truncate(fit.parameters, fit.covariance, clear_water)
    above = replace(fit, parameters=values, covariance=covariance)
    step, known, information, distance = measure(
        fit.parameters, fit.covariance, clear_water,
        np.diag((CLEAR_WATER_TOLERANCE * clear_water) ** 2))
    # Odds of a normal law at one value to one spread over many (Occam's factor).
    stddev = 1.0 / math.sqrt(float(information.sum()))
    spread = (1.0 - CLEAR) / CLEAR * math.sqrt(2.0 * math.pi) * stddev / SPREAD
    share = 1.0 / (1.0 + spread * math.exp(min(max(0.5 * (distance - cost), 0.0), 50.0)))
    if share < LEAST_CLEAR_SHARE:
        return above
    return _mixed(moved(fit, step, known), above, share)


@njit(nogil=True)
def _truncate(parameters: Any, covariance: Any, clear_water: Any) -> tuple[Any, Any, float]:
    """Truncate each channel at clear water in turn; also return the squared distances."""
    cost = 0.0
    for c in range(3):
        # Of channels that go together, rounding may leave less than nothing.
        known = max(covariance[2 * c, 2 * c], 0.0)
        stddev = math.sqrt(known + (CLEAR_WATER_TOLERANCE * clear_water[c]) ** 2)
        below = (clear_water[c] - parameters[c, 0]) / stddev
        cost += max(below, 0.0) ** 2
        ratio = inverse_mills(below)
        gain = covariance[2 * c] / stddev
        parameters, covariance = move(
            parameters, covariance, ratio * gain, ratio * (ratio - below) * np.outer(gain, gain))
    return parameters, covariance, cost


@njit(nogil=True)
def inverse_mills(a: float) -> float:
    """Inverse Mills ratio φ(a) / (1 − Φ(a)): mean of a normal law that is truncated at a.

    The variance above a is 1 − m (m − a) with this mean m.
    """
    if a > FAR:
        # Laplace's expansion: both of the quotient's numbers are too small.
        return a + 1.0 / a - 2.0 / a**3 + 10.0 / a**5
    return math.sqrt(2.0 / math.pi) * math.exp(-0.5 * a * a) / math.erfc(a / math.sqrt(2.0))


def _mixed(one: Fit, other: Fit, share: float) -> Fit:
    """Mean and covariance of two fits; `share` is the weight of the first."""
    off = (one.parameters - other.parameters).ravel()
    return replace(
        other,
        parameters=share * one.parameters + (1.0 - share) * other.parameters,
        covariance=share * one.covariance + (1.0 - share) * other.covariance
        + share * (1.0 - share) * np.outer(off, off))
