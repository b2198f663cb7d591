# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""How well the light model fits the quantiles over range, for a grid of attenuations.

If surfaces at all ranges are alike, each quantile of irradiance follows

    q_k(d) = B + c_k e^(−βd),

with one veil B and one β (eq. 4 for any reflectance). For a given β that is linear in B and c_k.
The network sees the residuals over β, with the veil that belongs to each, and need not learn what
an exponential is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility_lab.posterior.statistics import BINS, FLOOR, OF_IMAGE, QUANTILES

# Optical thickness at the median range, of the grid.
THICKNESS = np.geomspace(0.03, 4.0, 18).astype(np.float32)
# Quantiles of the fits, by place in QUANTILES: of the dark ones, and of all but the extremes.
DARK = (1, 2, 3)
ALL = (1, 2, 3, 4, 5, 6)
# Pairs of quantiles whose difference shows contrast.
SPREADS = ((6, 2), (5, 3), (4, 1))
# Rounding and noise, relative to the brightest: residuals below it say nothing.
PRECISION = 0.003
OF_CURVES = 5 * len(THICKNESS) + 3 + 2 * (len(SPREADS) + 1)


def curves(
    of_bins: NDArray[np.floating], of_image: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Fit the quantiles over range for each attenuation of a grid.

    Parameters
    ----------
    of_bins : (..., 3, BINS, OF_BIN) float32 ndarray
    of_image : (..., OF_IMAGE) float32 ndarray
        See `Statistics`.

    Returns
    -------
    (..., 3, OF_CURVES) float32 ndarray
        Logarithms of residuals and of veils over the grid, and the decay of contrast.
    """
    distance = np.exp(of_image[..., OF_IMAGE - 2 * BINS:OF_IMAGE - BINS])
    weight = of_bins[..., -1]
    q = np.exp(of_bins[..., :len(QUANTILES)]) - FLOOR
    parts = []
    for chosen, black in ((ALL, False), (DARK, False), (DARK[:1], True)):
        residual, veil = _fit(q[..., chosen], distance, weight, black)
        least = residual.min(axis=-1, keepdims=True)
        parts += [residual - least, least]
        if chosen is not DARK:
            parts.append(veil)
    parts.append(_decay(q, of_bins[..., len(QUANTILES)], distance, weight))
    return np.concatenate(parts, axis=-1).astype(np.float32)


def _fit(
    q: NDArray[np.floating], distance: NDArray[np.floating], weight: NDArray[np.floating],
    black: bool,
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """ln of the mean squared residual and ln B, (..., 3, G); with `black`, c is −B."""
    residuals, veils = [], []
    total = np.maximum(weight.sum(axis=-1), 1.0)
    for thickness in THICKNESS:
        left = np.exp(-thickness * distance)[..., np.newaxis, :] * weight
        one = weight.copy()
        if black:
            one = one - left
            own = q * weight[..., np.newaxis]
        else:
            square = np.maximum((left**2).sum(axis=-1), 1e-12)[..., np.newaxis]
            one = one - left * (one * left).sum(axis=-1, keepdims=True) / square
            along = np.einsum("...ik,...i->...k", q, left) / square
            own = q * weight[..., np.newaxis] - left[..., np.newaxis] * along[..., np.newaxis, :]
        norm = np.maximum((one**2).sum(axis=-1), 1e-9)
        veil = np.einsum("...ik,...i->...", own, one) / (norm * q.shape[-1])
        off = own - veil[..., np.newaxis, np.newaxis] * one[..., np.newaxis]
        residuals.append((off**2).sum(axis=(-1, -2)) / (total * q.shape[-1]))
        veils.append(veil)
    residual = np.log(np.stack(residuals, axis=-1) + PRECISION**2)
    return residual, np.log(np.clip(np.stack(veils, axis=-1), 0.5 * FLOOR, 8.0))


def _decay(
    q: NDArray[np.floating], contrast: NDArray[np.floating], distance: NDArray[np.floating],
    weight: NDArray[np.floating],
) -> NDArray[np.floating]:
    """Slopes of ln contrast over range in median ranges, and their residuals, (..., 3, 8)."""
    x = np.broadcast_to(distance[..., np.newaxis, :], weight.shape)
    number = np.maximum(weight.sum(axis=-1, keepdims=True), 1.0)
    away = (x - (weight * x).sum(axis=-1, keepdims=True) / number) * weight
    spread = np.maximum((away**2).sum(axis=-1), 1e-6)
    found = []
    for y in (*(np.log(np.maximum(q[..., a] - q[..., b], 0.0) + 0.5 * FLOOR)
                for a, b in SPREADS), contrast):
        off = (y - (weight * y).sum(axis=-1, keepdims=True) / number) * weight
        slope = (away * off).sum(axis=-1) / spread
        rest = off - slope[..., np.newaxis] * away
        found += [np.clip(slope, -9.0, 9.0), np.log((rest**2).sum(axis=-1) / number[..., 0] + 1e-4)]
    return np.stack(found, axis=-1)
