# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""How well the light model fits the statistics over range, for a grid of attenuations.

If surfaces at all ranges are alike, each quantile of irradiance follows

    q_k(d) = B(v) (1 − e^(−βd)) + c_k e^(−βd),

with one β and a veil B that may change with the row v, B(v) = B_0 + B_1 v (eq. 4 for any
reflectance). For a given β that is linear in B_0, B_1 and c_k. So do the means of a tile of the
image, whose surfaces are more alike than those of all the image. Open water shows B where nothing
is left of surfaces. Contrast follows C² e^(−2βd) + N², with noise N, whatever the veil. The network
sees the residuals over β, with the veil that belongs to each, and need not learn what an
exponential is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.water.daylight.statistics import (
    BINS,
    COARSE,
    FLOOR,
    IS_WATER,
    LOCAL,
    LOWER_ROW,
    LOWER_WATER,
    OF_BIN,
    QUANTILES,
    RANGES,
    ROW,
    ROWS,
    UPPER_ROW,
    UPPER_WATER,
    WEIGHT,
    WITHIN_TILE,
)

# Optical thickness at the median range, of the grid.
THICKNESS = np.geomspace(0.03, 4.0, 18).astype(np.float32)
LOG_THICKNESS = np.log(THICKNESS)
STEP = float(LOG_THICKNESS[1] - LOG_THICKNESS[0])
# Quantiles of the fits, by place in QUANTILES: of the dark ones, of all but the extremes, and the
# one that is taken for black.
DARK, ALL, BLACK = (1, 2, 3), (1, 2, 3, 4, 5, 6), (1,)
# Pairs of quantiles whose difference shows contrast.
SPREADS = ((6, 2), (5, 3), (4, 1))
# Weight of open water in a fit, in bins: it decides on the veil and its gradient, or has a part.
FIXED, FREE = 1000.0, 30.0
# Rounding and noise, relative to the brightest, and relative error of a contrast: smaller residuals
# say nothing.
PRECISION, CONTRAST_PRECISION = 0.003, 0.05
# Change of the veil from the upper to the lower edge, relative to the brightest, that is as likely
# as a residual of PRECISION in one bin.
GRADIENT = 0.5
# Halves of open water that are so many heights apart tell half of the veil's gradient.
LEAST_APART = 0.03
# Open water counts half where ln of the mean squared residual is so much worse with it, and how
# steeply that changes.
MOST_WORSE, STEEP = 0.6, 5.0
# A veil's growth over β as multiple scattering has it: 0.35 to 0.9 in path-traced water.
SLOWER = 0.6
# Exponent of sRGB as a whole (IEC 61966-2-1).
GAMMA = 2.2
# Of the veil every third value of the grid is kept.
KEPT = slice(1, None, 3)
# Contrasts that are fitted, by place in a bin's statistics.
CONTRASTS = (LOCAL, COARSE, WITHIN_TILE)


class GridFit(NamedTuple):
    """One fit of the light model over the grid, see `_fit_veil`.

    Attributes
    ----------
    quantiles : tuple of int
        What is fitted, by place in QUANTILES; tiles where empty.
    of_water : float
        Weight of open water.
    gradient, black : bool
        Whether the veil has a gradient, and surfaces are black.
    keeps_veil : bool
        Whether the network sees the veil too.
    growth : float
        Rate at which the veil grows with range, over β: multiple scattering makes it slower.
    exponent : float
        Of irradiance, for cameras whose curve is another than was told.
    """

    quantiles: tuple[int, ...]
    of_water: float = 0.0
    gradient: bool = False
    black: bool = False
    keeps_veil: bool = False
    growth: float = 1.0
    exponent: float = 1.0


FITS = (
    GridFit(ALL, keeps_veil=True),
    GridFit(DARK),
    GridFit(BLACK, black=True, keeps_veil=True),
    GridFit(ALL, FIXED),
    GridFit(BLACK, FIXED, black=True),
    GridFit((), FIXED),
    GridFit(ALL, FREE, gradient=True, keeps_veil=True),
    GridFit(BLACK, FREE, gradient=True, black=True, keeps_veil=True),
    GridFit((), keeps_veil=True),
    GridFit((), FREE, gradient=True, keeps_veil=True),
    GridFit((), growth=SLOWER),
    GridFit((), FREE, growth=SLOWER),
    GridFit(ALL, exponent=GAMMA),
    GridFit(ALL, exponent=1.0 / GAMMA),
)
# Fits whose veil the network sees, by place in FITS.
KEEP_VEIL = [place for place, fit in enumerate(FITS) if fit.keeps_veil]
OF_CURVES = (
    BINS * OF_BIN + 1 + (len(FITS) + len(CONTRASTS)) * (len(THICKNESS) + 2)
    + len(KEEP_VEIL) * (len(THICKNESS[KEPT]) + 1) + 2 * (len(SPREADS) + 1))


class Levelled(NamedTuple):
    """Statistics without the gradient of the veil that open water shows.

    Attributes
    ----------
    of_bins : (..., 3, BINS, OF_BIN) float32 ndarray
    of_tiles : (..., 5, TILES, BINS) float32 ndarray
        See `Statistics`.
    water : (..., 3, 2) float32 ndarray
        Light of the two halves of open water; near 0 without.
    slope : (..., 3) float32 ndarray
        B_1 that was taken away, relative to the brightest.
    """

    of_bins: NDArray[np.float32]
    of_tiles: NDArray[np.float32]
    water: NDArray[np.float32]
    slope: NDArray[np.float32]


def level(
    of_bins: NDArray[np.floating], of_tiles: NDArray[np.floating],
    of_channels: NDArray[np.floating], of_image: NDArray[np.floating],
) -> Levelled:
    """Take the gradient of the veil away, so that it looks as in the middle row everywhere.

    Between the halves of open water B changes by B_1 a row; before surfaces by B_1 v (1 − e^(−βd)),
    with the β that fits the tiles best with that veil. What looks like open water may be a smooth
    surface that was not matched: where that veil fits the tiles worse than any other, it does not
    count. For the arrays see `curves`.
    """
    distance = np.exp(of_image[..., RANGES])
    probability = of_channels[..., IS_WATER, np.newaxis]
    there = (probability > 0.0).astype(np.float32)
    seen = (np.exp(of_channels[..., (UPPER_WATER, LOWER_WATER)]) - FLOOR) * there
    rows = of_image[..., (UPPER_ROW, LOWER_ROW)]
    tiles = (
        of_tiles[..., :3, :, :], of_tiles[..., np.newaxis, WEIGHT, :, :],
        of_tiles[..., np.newaxis, ROW, :, :], distance, seen, rows)
    of_seen = np.broadcast_to(there, seen.shape)
    residual, _ = _over_batch(*tiles, FIXED * of_seen, True, False)
    without, _ = _over_batch(*tiles, 0.0 * of_seen, False, False)
    worse = residual.min(axis=-1) - without.min(axis=-1)
    apart = np.maximum(rows[..., 1] - rows[..., 0], 0.0)
    sure = probability[..., 0] * (apart / (apart**2 + LEAST_APART**2))[..., np.newaxis] / (
        1.0 + np.exp(STEEP * np.clip(worse - MOST_WORSE, -9.0, 9.0)))
    most = seen.max(axis=-1)
    slope = np.clip((seen[..., 1] - seen[..., 0]) * sure, -most, most)
    thickness = np.exp(_least(residual))
    lost = slope[..., np.newaxis] * (
        1.0 - np.exp(-thickness[..., np.newaxis] * distance[..., np.newaxis, :]))
    bins = np.array(of_bins, np.float32)
    light = np.exp(bins[..., :len(QUANTILES)]) - FLOOR
    light -= (lost * of_image[..., np.newaxis, ROWS])[..., np.newaxis]
    bins[..., :len(QUANTILES)] = np.log(np.maximum(light, 0.0) + FLOOR) * bins[..., -1:]
    level_tiles = np.array(of_tiles, np.float32)
    level_tiles[..., :3, :, :] -= lost[..., np.newaxis, :] * of_tiles[..., np.newaxis, ROW, :, :]
    water = seen - slope[..., np.newaxis] * rows[..., np.newaxis, :]
    return Levelled(bins, level_tiles, water.astype(np.float32), slope.astype(np.float32))


def curves(
    of_bins: NDArray[np.floating], of_tiles: NDArray[np.floating],
    of_channels: NDArray[np.floating], of_image: NDArray[np.floating],
) -> NDArray[np.float32]:
    """Fit the statistics over range for each attenuation of a grid.

    Parameters
    ----------
    of_bins : (..., 3, BINS, OF_BIN) float32 ndarray
    of_tiles : (..., 5, TILES, BINS) float32 ndarray
    of_channels : (..., 3, OF_CHANNEL) float32 ndarray
    of_image : (..., OF_IMAGE) float32 ndarray
        See `Statistics`.

    Returns
    -------
    (..., 3, OF_CURVES) float32 ndarray
        Statistics of the bins and what was taken away, see `level`; logarithms of residuals and of
        veils over the grid, where residuals are least, and the decay of contrast.
    """
    distance = np.exp(of_image[..., RANGES])
    of_bins, of_tiles, seen, slope = level(of_bins, of_tiles, of_channels, of_image)
    there = of_bins[..., -1]
    q = np.exp(of_bins[..., :len(QUANTILES)]) - FLOOR
    water = of_channels[..., IS_WATER, np.newaxis] > 0.0
    # Groups that have a c of their own: quantiles, (..., 3, K, BINS), or tiles.
    bins = there[..., np.newaxis, :], of_image[..., np.newaxis, np.newaxis, ROWS]
    tiles = (of_tiles[..., np.newaxis, WEIGHT, :, :], of_tiles[..., np.newaxis, ROW, :, :])
    rows = of_image[..., (UPPER_ROW, LOWER_ROW)]
    residuals, veils = [], []
    for fit in FITS:
        mean = (
            np.moveaxis(q[..., fit.quantiles], -1, -2) if fit.quantiles
            else of_tiles[..., :3, :, :])
        weight, row = bins if fit.quantiles else tiles
        residual, veil = _over_batch(
            mean if fit.exponent == 1.0 else np.maximum(mean, 0.0) ** fit.exponent, weight, row,
            distance, seen, rows, np.broadcast_to(fit.of_water * water, seen.shape), fit.gradient,
            fit.black, fit.growth)
        residuals.append(residual * water if fit.of_water == FIXED else residual)
        if fit.keeps_veil:
            veils.append(veil)
    for place in CONTRASTS:
        residual = np.zeros((*there.shape[:-1], len(THICKNESS)), np.float32)
        _fit_contrasts(
            *(np.ascontiguousarray(each, np.float32).reshape(-1, each.shape[-1]) for each in (
                np.exp(2.0 * of_bins[..., place]), there,
                np.broadcast_to(distance[..., np.newaxis, :], there.shape))),
            residual.reshape(-1, len(THICKNESS)))
        residuals.append(residual)
    # (..., 3, fits, grid)
    residual, veil = np.stack(residuals, axis=-2), np.stack(veils, axis=-2)
    least, at = residual.min(axis=-1), _least(residual)
    log_veil = np.log(np.clip(veil, 0.5 * FLOOR, 8.0))
    flat = (*of_bins.shape[:-2], -1)
    return np.concatenate((
        of_bins.reshape(flat), slope[..., np.newaxis],
        (residual - least[..., np.newaxis]).reshape(flat), least, at,
        log_veil[..., KEPT].reshape(flat), _at(log_veil, at[..., KEEP_VEIL]),
        _decay(q, of_bins[..., LOCAL], distance, there)), axis=-1).astype(np.float32)


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


def _over_batch(
    mean: NDArray[np.floating], weight: NDArray[np.floating], row: NDArray[np.floating],
    distance: NDArray[np.floating], seen: NDArray[np.floating], rows: NDArray[np.floating],
    of_seen: NDArray[np.floating], gradient: bool, black: bool, growth: float = 1.0,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """`_fit_veil` for `mean` (..., 3, K, N): residuals and veils, (..., 3, G) each."""
    before, (groups, bins) = mean.shape[:-2], mean.shape[-2:]
    flat = [
        np.ascontiguousarray(np.broadcast_to(each, (*before, *end)), np.float32).reshape(-1, *end)
        for each, end in (
            (mean, (groups, bins)), (weight, (groups, bins)), (row, (groups, bins)),
            (distance[..., np.newaxis, :], (bins,)), (seen, (2,)), (rows[..., np.newaxis, :], (2,)),
            (of_seen, (2,)))]
    residual = np.empty((len(flat[0]), len(THICKNESS)), np.float32)
    veil = np.empty_like(residual)
    _fit_veil(*flat, gradient, black, growth, residual, veil)
    shape = (*before, len(THICKNESS))
    return residual.reshape(shape), veil.reshape(shape)


@njit(nogil=True)
def _fit_veil(
    mean: Any, weight: Any, row: Any, distance: Any, seen: Any, rows: Any, of_seen: Any,
    gradient: bool, black: bool, growth: float, residual: Any, veil: Any,
) -> None:
    """ln of the mean squared residual, and B_0, for each thickness.

    With `black`, c is −B: surfaces reflect nothing. Without `gradient`, B_1 is 0. `seen` is what
    two parts of open water show at `rows`, with the weights `of_seen`.
    """
    many, groups, bins = mean.shape
    transmission, unveiled = np.empty(bins, np.float32), np.empty(bins, np.float32)
    for i in range(many):
        for g in range(len(THICKNESS)):
            for n in range(bins):
                transmission[n] = np.exp(-THICKNESS[g] * distance[i, n])
                unveiled[n] = transmission[n] if growth == 1.0 else transmission[n]**growth
            # Normal equations of B_0 and B_1.
            a00, a01, a11, b0, b1, energy, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(groups):
                ll, l0, l1, ly = 0.0, 0.0, 0.0, 0.0
                for n in range(bins):
                    w = weight[i, k, n]
                    if w <= 0.0:
                        continue
                    left, missing = transmission[n], unveiled[n]
                    y = mean[i, k, n]
                    # What B_0 and B_1 are multiplied with; c includes −B_0 if the rates are one.
                    of_0 = 1.0 - missing if black or growth != 1.0 else 1.0
                    of_1 = row[i, k, n] * (1.0 - missing)
                    total += w
                    energy += w * y * y
                    a00 += w * of_0 * of_0
                    a01 += w * of_0 * of_1
                    a11 += w * of_1 * of_1
                    b0 += w * of_0 * y
                    b1 += w * of_1 * y
                    if not black:
                        ll += w * left * left
                        l0 += w * left * of_0
                        l1 += w * left * of_1
                        ly += w * left * y
                if ll > 1e-12:
                    energy -= ly * ly / ll
                    a00 -= l0 * l0 / ll
                    a01 -= l0 * l1 / ll
                    a11 -= l1 * l1 / ll
                    b0 -= l0 * ly / ll
                    b1 -= l1 * ly / ll
            for j in range(2):
                w = of_seen[i, j]
                energy += w * seen[i, j] ** 2
                a00 += w
                a01 += w * rows[i, j]
                a11 += w * rows[i, j] ** 2
                b0 += w * seen[i, j]
                b1 += w * rows[i, j] * seen[i, j]
            a11 += (PRECISION / GRADIENT) ** 2
            a00 = max(a00, 1e-9)
            slope = 0.0
            if gradient:
                determinant = a00 * a11 - a01 * a01
                if determinant > 1e-9 * a00 * a11:
                    slope = (a00 * b1 - a01 * b0) / determinant
            level = (b0 - a01 * slope) / a00
            rest = energy - 2.0 * (level * b0 + slope * b1) + (
                level * level * a00 + 2.0 * level * slope * a01 + slope * slope * a11)
            residual[i, g] = np.log(max(rest, 0.0) / max(total, 1e-3) + PRECISION**2)
            veil[i, g] = level


@njit(nogil=True)
def _fit_contrasts(square: Any, weight: Any, distance: Any, residual: Any) -> None:
    """ln of the mean squared relative residual of C² e^(−2βd) + N², neither below 0."""
    many, bins = square.shape
    for i in range(many):
        total = weight[i].sum()
        for g in range(len(THICKNESS)):
            a00, a01, a11, b0, b1 = 0.0, 0.0, 0.0, 0.0, 0.0
            for n in range(bins):
                if weight[i, n] <= 0.0:
                    continue
                one = 1.0 / max(square[i, n], 1e-12)
                left = np.exp(-2.0 * THICKNESS[g] * distance[i, n]) * one
                a00 += left * left
                a01 += left * one
                a11 += one * one
                b0 += left
                b1 += one
            contrast, noise = 0.0, 0.0
            determinant = a00 * a11 - a01 * a01
            if determinant > 1e-9 * a00 * a11:
                contrast = (a11 * b0 - a01 * b1) / determinant
                noise = (a00 * b1 - a01 * b0) / determinant
            if noise <= 0.0 and a00 > 0.0:
                contrast, noise = b0 / a00, 0.0
            elif contrast < 0.0 and a11 > 0.0:
                contrast, noise = 0.0, b1 / a11
            rest = total - 2.0 * (contrast * b0 + noise * b1) + (
                contrast * contrast * a00 + 2.0 * contrast * noise * a01 + noise * noise * a11)
            residual[i, g] = np.log(max(rest, 0.0) / max(total, 1.0) + CONTRAST_PRECISION**2)


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
