# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Published fits of the water, without priors, for comparison with our estimate.

The paper's (eq. 4-7): dark envelopes are fitted with E = I∞ (1 − e^(−βd)); I∞ is at least the
bright envelope. Sea-thru's (D. Akkaynak and T. Treibitz, CVPR 2019, doi
10.1109/CVPR.2019.00178, section 4.2, written from the publication): the darkest pixels of ten range
bins are fitted with E(d) = B (1 − e^(−βd)) + J e^(−β'd).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.light_model import transmission
from uw_visibility.optics.transfer import to_linear
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate, overall_status

BINS = 48
"""Number of bins of equal width in the paper's fit."""
DARK_QUANTILE, BRIGHT_QUANTILE = 0.01, 0.99
FEWEST = 100
"""Least number of pixels in a bin."""
FEWEST_BINS = 6
LEAST_RATIO = 1.25
"""Least ratio of the farthest range to the nearest one."""
SCALE = 0.01
"""Residuals beyond this irradiance lose weight."""
BRIGHT_BINS = 3
"""The bright envelope is that of the third brightest bin."""
BOUNDS = (1e-4, 10.0)
"""Bounds of β, 1/m."""
LARGEST_LIGHT = 2.0
"""Largest I∞, above the largest code, since open water may be overexposed."""

DARK_BINS = 10
DARKEST = 0.01
"""Share of a bin's pixels that Sea-thru's fit uses, by the sum of R, G and B."""
FEWEST_DARK, MOST_DARK = 20, 100
"""Least number of pixels in a bin, and number of those used: more take time without benefit."""
STARTS = (0.3, 1.0, 3.0)
"""Optical thicknesses at the median range from which fits start; the best fit is used."""
LARGEST = np.array([1.0, 5.0, 1.0, 5.0])
"""Bounds of B, β, J and β', from 0, as in the publication."""


def fit_plain(
    image: NDArray[Any], ranges: NDArray[np.floating], clear_water: Array,
    transfer: str = "linear",
) -> WaterEstimate:
    """Estimate I∞ and β of each channel by the paper's fit, with the fit's covariance.

    image: (H, W, 3), code values. ranges: (H, W), m, along the line of sight; NaN where unknown.
    clear_water: κ, (3,), 1/m, the first value of β.
    """
    distance, light = _seen(image, ranges, transfer)
    if distance.size < FEWEST * FEWEST_BINS:
        return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
    low, high = np.quantile(distance, (0.005, 0.995))
    if high < LEAST_RATIO * low:
        return WaterEstimate.not_assessable(Status.RANGE_SPREAD_TOO_SMALL)
    bins = list(_bins(distance, low, high, BINS, FEWEST))
    if len(bins) < FEWEST_BINS:
        return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
    middle = np.array([distance[inside].mean() for inside in bins])
    dark, bright = np.array([
        np.quantile(light[inside], (DARK_QUANTILE, BRIGHT_QUANTILE), axis=0) for inside in bins
    ]).transpose(1, 2, 0)
    fits = [_fit_veil(middle, *of_channel) for of_channel in zip(
        dark, bright, clear_water, strict=True)]
    found = [fit.status > 0 and fit.x[0] < BOUNDS[1] * (1.0 - 1e-6) for fit in fits]
    return _estimate(fits, found, (0, 1), len(bins))


def fit_backscatter(
    image: NDArray[Any], ranges: NDArray[np.floating], transfer: str = "linear"
) -> WaterEstimate:
    """Estimate B (as ambient light) and β of each channel by Sea-thru's fit; see `fit_plain`."""
    distance, light = _seen(image, ranges, transfer)
    if distance.size < FEWEST_DARK * DARK_BINS:
        return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
    brightness = light.sum(axis=1)
    chosen = []
    for inside in _bins(distance, distance.min(), distance.max(), DARK_BINS, FEWEST_DARK):
        count = max(1, int(DARKEST * len(inside)))
        darkest = inside[np.argpartition(brightness[inside], count - 1)[:count]]
        chosen.append(np.sort(darkest)[:: max(1, count // MOST_DARK)])
    if len(chosen) <= 3:
        return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
    dark = np.concatenate(chosen)
    fits = [_fit_backscatter(distance[dark], light[dark, c].astype(np.float64)) for c in range(3)]
    found = [
        fit.success and (fit.x[:2] <= 0.999 * LARGEST[:2]).all() and fit.x[1] >= 1e-4
        for fit in fits]
    return _estimate(fits, found, (1, 0), DARK_BINS)


def _seen(
    image: NDArray[Any], ranges: NDArray[np.floating], transfer: str
) -> tuple[Array, Map]:
    """Return range, (n,), and light, (n, 3), of the pixels with known range."""
    known = np.isfinite(ranges)
    return ranges[known].astype(np.float64), to_linear(image, transfer)[known]


def _bins(
    distance: Array, low: float, high: float, count: int, fewest: int
) -> Iterator[NDArray[np.intp]]:
    """Yield the pixels' indices of each bin of equal width with at least `fewest` pixels."""
    edges = np.linspace(low, high, count + 1)
    place = np.searchsorted(edges, distance, side="right") - 1
    # The last bin includes the farthest pixel.
    place[distance == high] = count - 1
    for k in range(count):
        inside = np.flatnonzero(place == k)
        if len(inside) >= fewest:
            yield inside


def _fit_veil(distance: Array, dark: Array, bright: Array, start: float) -> OptimizeResult:
    """Fit β and I∞ of a channel with a soft L1 loss."""
    def residual(p: Array) -> Array:
        return np.asarray(p[1] * (1.0 - transmission(p[0], distance)) - dark)

    lower = np.array([BOUNDS[0], np.sort(bright)[-min(BRIGHT_BINS, len(bright))]])
    upper = np.array([BOUNDS[1], LARGEST_LIGHT])
    inside = 1e-6 * (upper - lower)
    first = np.clip((start, bright.max()), lower + inside, upper - inside)
    return least_squares(residual, first, bounds=(lower, upper), loss="soft_l1", f_scale=SCALE)


def _fit_backscatter(distance: Array, light: Array) -> OptimizeResult:
    """Fit B, β, J and β' of a channel."""
    def residual(p: Array) -> Array:
        veil = p[0] * (1.0 - transmission(p[1], distance))
        return np.asarray(veil + p[2] * transmission(p[3], distance) - light)

    middle = float(np.median(distance))
    fits = [
        least_squares(
            residual,
            np.clip([float(light.max()), thickness / middle, 0.01, 1.0 / middle],
                    1e-3, 0.99 * LARGEST),
            bounds=(0.0, LARGEST), x_scale=np.array([0.1, 1 / middle, 0.1, 1 / middle]),
            max_nfev=200,
        )
        for thickness in STARTS
    ]
    return min(fits, key=lambda fit: fit.cost)


def _estimate(
    fits: Sequence[OptimizeResult], found: Sequence[bool], places: tuple[int, int], bins: int
) -> WaterEstimate:
    """Return the estimate of three channels; `places`: of β and the veil in the parameters."""
    values, covariance = np.full((3, 2), np.nan), np.full((6, 6), np.nan)
    for c, fit in enumerate(fits):
        if found[c]:
            variance = 2.0 * fit.cost / max(len(fit.fun) - len(fit.x), 1)
            values[c] = fit.x[list(places)]
            block = slice(2 * c, 2 * c + 2)
            covariance[block, block] = (
                variance * np.linalg.pinv(fit.jac.T @ fit.jac))[np.ix_(places, places)]
    red, green, blue = (Status.OK if ok else Status.FIT_FAILED for ok in found)
    return WaterEstimate(
        overall_status((red, green, blue)), values[:, 0], values[:, 1], covariance, 0, bins,
        (red, green, blue))
