# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Backscatter fit of Sea-thru, as a peer of the estimate of the water.

D. Akkaynak and T. Treibitz, Sea-thru: a method for removing water from underwater images,
CVPR 2019, doi 10.1109/CVPR.2019.00178, section 4.2; written from the publication. The darkest
pixels of ten range bins are fitted with E(d) = B (1 − e^(−βd)) + J e^(−β'd).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.light_model import transmission, veil_of
from uw_visibility.optics.transfer import to_linear
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate

BINS = 10
DARKEST = 0.01
"""Share of a bin's pixels that is taken, by the sum of R, G and B."""
FEWEST = 20
"""Pixels that a bin needs."""
MOST = 100
"""Pixels taken of a bin: more add time, and nothing else."""
STARTS = (0.3, 1.0, 3.0)
"""Optical thickness of the middle range that fits start from; the best one counts."""
LARGEST = np.array([1.0, 5.0, 1.0, 5.0])
"""Bounds of B, β, J and β', from 0, as in the publication."""


def fit_backscatter(
    image: NDArray[Any], ranges: NDArray[np.floating], transfer: str = "linear"
) -> WaterEstimate:
    """Estimate B (as ambient light) and β of each channel, with the fit's own covariance.

    image: (H, W, 3), code values. ranges: (H, W), m, along the line of sight; NaN where unknown.
    """
    known = np.isfinite(ranges)
    if known.sum() < FEWEST * BINS:
        return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
    distance, light = ranges[known].astype(np.float64), to_linear(image, transfer)[known]
    dark = _darkest(distance, light)
    if dark.size == 0:
        return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
    values, covariance, status = np.full((3, 2), np.nan), np.full((3, 2, 2), np.nan), []
    for c in range(3):
        fit = _fit_channel(distance[dark], light[dark, c].astype(np.float64))
        status.append(Status.FIT_FAILED if fit is None else Status.OK)
        if fit is not None:
            values[c], covariance[c] = fit
    return WaterEstimate(
        status=next((reason for reason in status if reason is not Status.OK), Status.OK),
        attenuation=values[:, 0],
        ambient_light=values[:, 1],
        covariance=covariance,
        iterations=0,
        bins=BINS,
        channel_status=(status[0], status[1], status[2]),
    )


def _darkest(distance: Array, light: Map) -> NDArray[np.intp]:
    """Return the indices of the darkest pixels of each bin."""
    edges = np.linspace(distance.min(), distance.max(), BINS + 1)
    place = np.clip(np.searchsorted(edges, distance, side="right") - 1, 0, BINS - 1)
    brightness = light.sum(axis=1)
    chosen = []
    for k in range(BINS):
        inside = np.flatnonzero(place == k)
        if len(inside) < FEWEST:
            continue
        count = max(1, int(DARKEST * len(inside)))
        darkest = inside[np.argpartition(brightness[inside], count - 1)[:count]]
        chosen.append(np.sort(darkest)[:: max(1, count // MOST)])
    return np.concatenate(chosen) if len(chosen) > 3 else np.zeros(0, np.intp)


def _fit_channel(distance: Array, light: Array) -> tuple[Array, Array] | None:
    """Fit one channel; β and B with their covariance, or None where a bound stops them."""
    def model(p: Array) -> Array:
        veil = veil_of(p[0], transmission(p[1], distance))
        return np.asarray(veil + p[2] * transmission(p[3], distance))

    middle = float(np.median(distance))
    fits = [
        least_squares(
            lambda p: model(p) - light,
            np.clip([float(light.max()), thickness / middle, 0.01, 1.0 / middle],
                    1e-3, 0.99 * LARGEST),
            bounds=(0.0, LARGEST), x_scale=np.array([0.1, 1 / middle, 0.1, 1 / middle]),
            max_nfev=200,
        )
        for thickness in STARTS
    ]
    result = min(fits, key=lambda fit: fit.cost)
    veil, rate = result.x[:2]
    bounded = veil > 0.999 * LARGEST[0] or rate > 0.999 * LARGEST[1] or rate < 1e-4
    if not result.success or bounded:
        return None
    variance = 2.0 * result.cost / max(len(distance) - 4, 1)
    covariance = variance * np.linalg.pinv(result.jac.T @ result.jac)
    order = [1, 0]
    return result.x[order], covariance[np.ix_(order, order)]
