# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""How well the light model fits the quantiles over range, for a grid of attenuations.

If surfaces at all ranges are alike, each quantile of irradiance follows

    q_k(d) = B + c_k e^(−βd),

with one veil B and one β (eq. 4 for any reflectance). For a given β that is linear in B and c_k.
So do the means of a tile of the image, whose surfaces are more alike than those of all the image.
Where open water is in view, it shows B. The network sees the residuals over β, with the veil that
belongs to each, and need not learn what an exponential is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.water.daylight.statistics import (
    FLOOR,
    LOWER_ROW,
    QUANTILES,
    RANGES,
    ROWS,
    UPPER_ROW,
)

# Optical thickness at the median range, of the grid.
THICKNESS = np.geomspace(0.03, 4.0, 18).astype(np.float32)
LOG_THICKNESS = np.log(THICKNESS)
STEP = float(LOG_THICKNESS[1] - LOG_THICKNESS[0])
# Quantiles of the fits, by place in QUANTILES: of the dark ones, and of all but the extremes.
DARK = (1, 2, 3)
ALL = (1, 2, 3, 4, 5, 6)
# Pairs of quantiles whose difference shows contrast.
SPREADS = ((6, 2), (5, 3), (4, 1))
# Places in `Statistics.of_channels`: whether open water is in view, its light above, and near the
# scene.
IS_WATER, SKY_WATER, SEEN_WATER = 2, 10, 11
# Halves of open water are taken to be at least so many heights apart, and its light to change by
# this logarithm at most.
LEAST_APART, MOST_CHANGE = 0.02, 0.7
# Rounding and noise, relative to the brightest: residuals below it say nothing.
PRECISION = 0.003
# Guesses of ln βd̃: where the residuals of all quantiles, the dark ones, black, open water, its
# gradient, and tiles are least; and ln B of those of black and of tiles.
GUESSES = 8
OF_CURVES = 9 * len(THICKNESS) + 6 + 2 * (len(SPREADS) + 1) + GUESSES



def curves(
    of_bins: NDArray[np.floating], of_tiles: NDArray[np.floating],
    of_channels: NDArray[np.floating], of_image: NDArray[np.floating],
) -> NDArray[np.float32]:
    """Fit the quantiles over range for each attenuation of a grid.

    Parameters
    ----------
    of_bins : (..., 3, BINS, OF_BIN) float32 ndarray
    of_tiles : (..., 4, TILES, BINS) float32 ndarray
    of_channels : (..., 3, OF_CHANNEL) float32 ndarray
    of_image : (..., OF_IMAGE) float32 ndarray
        See `Statistics`.

    Returns
    -------
    (..., 3, OF_CURVES) float32 ndarray
        Logarithms of residuals and of veils over the grid, the decay of contrast, and guesses of
        attenuation and veil.
    """
    distance = np.exp(of_image[..., RANGES])
    weight = of_bins[..., -1]
    q = np.exp(of_bins[..., :len(QUANTILES)]) - FLOOR
    parts, minima, veils = [], [], []
    for chosen, black in ((ALL, False), (DARK, False), (DARK[:1], True)):
        residual, veil = _fit(q[..., chosen], distance, weight, black)
        least = residual.min(axis=-1, keepdims=True)
        parts += [residual - least, least]
        minima.append(_least(residual))
        if chosen is not DARK:
            parts.append(veil)
    veils.append(_at(veil, minima[-1]))
    there = of_channels[..., IS_WATER, np.newaxis]
    near = of_channels[..., SEEN_WATER, np.newaxis]
    for log_veil in (near, near + _gradient(of_channels, of_image)):
        residual = _fit_to_water(q[..., ALL], distance, weight, np.exp(log_veil) - FLOOR)
        least = residual.min(axis=-1, keepdims=True)
        parts += [(residual - least) * there, least * there]
        minima.append(_least(residual) * there[..., 0])
    residual, veil = _fit_tiles(of_tiles[..., :3, :, :], distance, of_tiles[..., 3, :, :])
    least = residual.min(axis=-1, keepdims=True)
    parts += [residual - least, least, veil]
    minima.append(_least(residual))
    veils.append(_at(veil, minima[-1]))
    parts.append(_decay(q, of_bins[..., len(QUANTILES)], distance, weight))
    parts.append(np.stack((*minima, *veils), axis=-1))
    return np.concatenate(parts, axis=-1).astype(np.float32)


def _least(residual: NDArray[np.floating]) -> NDArray[np.floating]:
    """ln thickness where residuals over the grid are least, by a parabola, (...)."""
    middle = np.clip(residual.argmin(axis=-1), 1, len(THICKNESS) - 2)[..., np.newaxis]
    before, here, after = (
        np.take_along_axis(residual, middle + k, axis=-1)[..., 0] for k in (-1, 0, 1))
    bend = np.maximum(before - 2.0 * here + after, 1e-6)
    step = np.clip(0.5 * (before - after) / bend, -1.0, 1.0)
    return np.asarray(LOG_THICKNESS[0] + (middle[..., 0] + step) * STEP)


def _at(values: NDArray[np.floating], log_thickness: NDArray[np.floating]) -> NDArray[np.floating]:
    """Values over the grid, interpolated at a thickness."""
    place = np.clip((log_thickness - LOG_THICKNESS[0]) / STEP, 0.0, len(THICKNESS) - 1.001)
    below = place.astype(int)[..., np.newaxis]
    first, second = (np.take_along_axis(values, below + k, axis=-1)[..., 0] for k in (0, 1))
    return np.asarray(first + (place - below[..., 0]) * (second - first))


def _gradient(
    of_channels: NDArray[np.floating], of_image: NDArray[np.floating]
) -> NDArray[np.floating]:
    """ln of open water's light at the rows of the bins, over that near the scene, (..., 3, BINS).

    The slope between the halves of open water is taken to go on below it.
    """
    upper, lower = of_image[..., UPPER_ROW], of_image[..., LOWER_ROW]
    apart = np.minimum(upper - lower, -LEAST_APART)[..., np.newaxis]
    slope = (of_channels[..., SKY_WATER] - of_channels[..., SEEN_WATER]) / apart
    below = of_image[..., np.newaxis, ROWS] - lower[..., np.newaxis, np.newaxis]
    return np.clip(slope[..., np.newaxis] * below, -MOST_CHANGE, MOST_CHANGE)


def _fit_to_water(
    q: NDArray[np.floating], distance: NDArray[np.floating], weight: NDArray[np.floating],
    veil: NDArray[np.floating],
) -> NDArray[np.floating]:
    """ln of the mean squared residual, (..., 3, G), with the veil (..., 3, BINS or 1) of water."""
    own = (q - veil[..., np.newaxis]) * weight[..., np.newaxis]
    total = np.maximum(weight.sum(axis=-1), 1.0) * q.shape[-1]
    energy = (own**2).sum(axis=(-1, -2))
    residuals = []
    for thickness in THICKNESS:
        left = np.exp(-thickness * distance)[..., np.newaxis, :] * weight
        square = np.maximum((left**2).sum(axis=-1), 1e-12)
        along = np.einsum("...ik,...i->...k", own, left)
        residuals.append((energy - (along**2).sum(axis=-1) / square) / total)
    return np.log(np.maximum(np.stack(residuals, axis=-1), 0.0) + PRECISION**2)


def _fit_tiles(
    mean: NDArray[np.floating], distance: NDArray[np.floating], weight: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """ln of the mean squared residual and ln B, (..., 3, G), with a c for each tile.

    `mean` (..., 3, TILES, BINS), `weight` (..., TILES, BINS).
    """
    residuals, veils = [], []
    total = np.maximum(weight.sum(axis=(-1, -2)), 1e-3)[..., np.newaxis]
    of_all = weight.sum(axis=-1)
    shown = weight[..., np.newaxis, :, :] * mean
    first, square = shown.sum(axis=-1), (shown * mean).sum(axis=-1)
    for thickness in THICKNESS:
        left = np.exp(-thickness * distance)
        weighed = weight * left[..., np.newaxis, :]
        one_left, left_left = weighed.sum(axis=-1), np.maximum(
            (weighed * left[..., np.newaxis, :]).sum(axis=-1), 1e-12)
        own_left = np.einsum("...cti,...ti->...ct", mean, weighed)
        part = one_left / left_left
        # Inner products of what e^(−βd) leaves of 1 and of the means.
        one_one = np.maximum((of_all - one_left * part).sum(axis=-1), 1e-9)[..., np.newaxis]
        one_own = (first - own_left * part[..., np.newaxis, :]).sum(axis=-1)
        own_own = (square - own_left**2 / left_left[..., np.newaxis, :]).sum(axis=-1)
        veil = one_own / one_one
        residuals.append(np.maximum(own_own - veil * one_own, 0.0) / total)
        veils.append(veil)
    residual = np.log(np.stack(residuals, axis=-1) + PRECISION**2)
    return residual, np.log(np.clip(np.stack(veils, axis=-1), 0.5 * FLOOR, 8.0))


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
