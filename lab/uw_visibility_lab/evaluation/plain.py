# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's own fit of the water, as a peer of the estimate (eq. 4-7).

The 1 % quantile of each range bin's pixels is fitted with E = I∞ (1 − e^(−βd)) by least squares
with a soft L1 loss; I∞ is at least the bright envelope (eq. 7). Without priors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.light_model import transmission, veil_of
from uw_visibility.optics.transfer import to_linear
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate, blank, of_channels

BINS = 48
"""Of equal width."""
DARK_QUANTILE, BRIGHT_QUANTILE = 0.01, 0.99
FEWEST = 100
"""Pixels that a bin needs."""
FEWEST_BINS = 6
LEAST_RATIO = 1.25
"""Of the farthest range to the nearest one."""
SCALE = 0.01
"""Residuals beyond this irradiance lose weight."""
BRIGHT_BINS = 3
"""The bright envelope is that of the third brightest bin."""
BOUNDS = (1e-4, 10.0)
"""Of β, 1/m."""
LARGEST_LIGHT = 2.0
"""Above the largest code: open water may be overexposed."""


def fit_plain(
    image: NDArray[Any], ranges: NDArray[np.floating], clear_water: Array,
    transfer: str = "linear",
) -> WaterEstimate:
    """Estimate I∞ and β of each channel, with the fit's own covariance.

    image: (H, W, 3), code values. ranges: (H, W), m, along the line of sight; NaN where unknown.
    clear_water: κ, (3,), 1/m, from which β starts.
    """
    known = np.isfinite(ranges)
    distance, light = ranges[known].astype(np.float64), to_linear(image, transfer)[known]
    if distance.size < FEWEST * FEWEST_BINS:
        return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
    low, high = np.quantile(distance, (0.005, 0.995))
    if high < LEAST_RATIO * low:
        return WaterEstimate.not_assessable(Status.RANGE_SPREAD_TOO_SMALL)
    middle, dark, bright = _envelopes(distance, light, np.linspace(low, high, BINS + 1))
    if len(middle) < FEWEST_BINS:
        return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
    values, covariance, status = np.full((3, 2), np.nan), np.zeros((6, 6)), []
    for c in range(3):
        fit = _fit_channel(middle, dark[c], bright[c], float(clear_water[c]))
        found = fit.status > 0 and fit.x[0] < BOUNDS[1] * (1.0 - 1e-6)
        status.append(Status.OK if found else Status.FIT_FAILED)
        if found:
            block = slice(2 * c, 2 * c + 2)
            values[c] = fit.x
            variance = 2.0 * fit.cost / max(len(middle) - 2, 1)
            covariance[block, block] = variance * np.linalg.pinv(fit.jac.T @ fit.jac)
    known_channels = np.isfinite(values[:, 0])
    return WaterEstimate(
        **of_channels(status, values[:, 0], values[:, 1], blank(covariance, known_channels)),
        iterations=0, bins=len(middle))


def _envelopes(distance: Array, light: Map, edges: Array) -> tuple[Array, Array, Array]:
    """Mean range (N,), dark and bright envelope (3, N) of the bins with enough pixels."""
    place = np.searchsorted(edges, distance, side="right") - 1
    middle, envelopes = [], []
    for k in range(BINS):
        inside = place == k
        if inside.sum() >= FEWEST:
            middle.append(distance[inside].mean())
            envelopes.append(
                np.quantile(light[inside], (DARK_QUANTILE, BRIGHT_QUANTILE), axis=0))
    dark, bright = np.array(envelopes).reshape(-1, 2, 3).transpose(1, 2, 0)
    return np.array(middle), dark, bright


def _fit_channel(distance: Array, dark: Array, bright: Array, start: float) -> OptimizeResult:
    def residual(p: Array) -> Array:
        return np.asarray(veil_of(p[1], transmission(p[0], distance)) - dark)

    lower = np.array([BOUNDS[0], np.sort(bright)[-min(BRIGHT_BINS, len(bright))]])
    upper = np.array([BOUNDS[1], LARGEST_LIGHT])
    inside = 1e-6 * (upper - lower)
    first = np.clip((start, bright.max()), lower + inside, upper - inside)
    return least_squares(residual, first, bounds=(lower, upper), loss="soft_l1", f_scale=SCALE)
