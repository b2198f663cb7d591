# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""How well the light model fits the statistics over range, for a grid of attenuations.

If surfaces at all ranges are alike, each quantile of irradiance follows

    q_k(d) = B(v) (1 − e^(−βd)) + c_k e^(−βd),

with one β and a veil B that may change with the row v, B(v) = B_0 + B_1 v (eq. 4 for any
reflectance). For a given β that is linear in B_0, B_1 and c_k. So do the means of a tile of the
image, whose surfaces are more alike than those of all the image. Open water shows B where nothing
is left of surfaces. Contrast follows C² e^(−2βd) + N², with noise N, whatever the veil. The
network's inputs are the residuals over β and the veil of each, so that it need not learn
exponentials.
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
DARK, ALL, BLACK = (1, 4), (1, 7), (1, 2)
# Pairs of quantiles whose difference shows contrast.
SPREADS = ((6, 2), (5, 3), (4, 1))
# Weight of open water in a fit, in bins: it determines the veil and its gradient, or contributes.
FIXED, FREE = 1000.0, 30.0
# Rounding and noise, relative to the brightest, and relative error of a contrast: smaller residuals
# have no information.
PRECISION, CONTRAST_PRECISION = 0.003, 0.05
# Change of the veil from the upper to the lower edge, relative to the brightest, that is as likely
# as a residual of PRECISION in one bin.
GRADIENT = 0.5
# Distance of the halves of open water, in heights, at which the veil's gradient has half weight.
LEAST_APART = 0.03
# Increase of ln mean squared residual at which open water has half weight, and the steepness of the
# transition.
MOST_WORSE, STEEP = 0.6, 5.0
# A veil's growth over β as multiple scattering has it: 0.35 to 0.9 in path-traced water.
SLOWER = 0.6
# Exponent of sRGB as a whole (IEC 61966-2-1).
GAMMA = 2.2
# Every third value of the veil over the grid is kept.
KEPT = slice(1, None, 3)
# Contrasts that are fitted, by place in a bin's statistics.
CONTRASTS = (LOCAL, COARSE, WITHIN_TILE)


class GridFit(NamedTuple):
    """One fit of the light model over the grid, see `_fit_veil`."""

    # what is fitted, from the first place in QUANTILES to before the last; tiles where empty
    quantiles: tuple[int, int] | tuple[()]
    of_water: float = 0.0  # weight of open water
    gradient: bool = False  # whether the veil has a gradient
    black: bool = False  # whether surfaces are black
    keeps_veil: bool = False  # whether the network sees the veil too
    # rate at which the veil grows with range, over β: multiple scattering makes it slower
    growth: float = 1.0
    exponent: float = 1.0  # of irradiance, for cameras whose curve is another than was told


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
# Fits of the tiles by which the veil is levelled: with open water, and without.
LEVEL_FITS = (GridFit((), FIXED, gradient=True), GridFit(()))
# Fits whose veil the network sees, and that are of open water, by place in FITS.
KEEP_VEIL = [place for place, fit in enumerate(FITS) if fit.keeps_veil]
NEEDS_WATER = [place for place, fit in enumerate(FITS) if fit.of_water == FIXED]
OF_CURVES = (
    BINS * OF_BIN + 1 + (len(FITS) + len(CONTRASTS)) * (len(THICKNESS) + 2)
    + len(KEEP_VEIL) * (len(THICKNESS[KEPT]) + 1) + 2 * (len(SPREADS) + 1))


class Levelled(NamedTuple):
    """Statistics corrected for the veil's gradient, which open water shows."""

    of_bins: NDArray[np.float32]  # (..., 3, BINS, OF_BIN), see `Statistics`
    of_tiles: NDArray[np.float32]  # (..., 5, TILES, BINS), see `Statistics`
    water: NDArray[np.float32]  # (..., 3, 2), light of the two halves of open water; near 0 without
    slope: NDArray[np.float32]  # (..., 3), B_1 that was removed, relative to the brightest


def level(
    of_bins: NDArray[np.floating], of_tiles: NDArray[np.floating],
    of_channels: NDArray[np.floating], of_image: NDArray[np.floating],
) -> Levelled:
    """Remove the gradient of the veil, so that it is that of the middle row everywhere.

    Between the halves of open water B changes by B_1 a row; before surfaces by B_1 v (1 − e^(−βd)),
    with the β that fits the tiles best with that veil. What looks like open water may be a smooth
    surface that was not matched: where the tiles fit worse with that veil, it is ignored. The
    arrays are those of `Statistics`.
    """
    distance = np.exp(of_image[..., RANGES])
    probability = of_channels[..., IS_WATER, np.newaxis]
    there = (probability > 0.0).astype(np.float32)
    seen = (np.exp(of_channels[..., (UPPER_WATER, LOWER_WATER)]) - FLOOR) * there
    rows = of_image[..., (UPPER_ROW, LOWER_ROW)]
    bins = np.array(of_bins, np.float32)
    light = np.exp(bins[..., :len(QUANTILES)]) - FLOOR
    residuals, _ = _fit_all(
        LEVEL_FITS, light, bins[..., -1], of_tiles, seen, there[..., 0], of_image)
    residual, without = residuals[..., 0, :], residuals[..., 1, :]
    worse = residual.min(axis=-1) - without.min(axis=-1)
    apart = np.maximum(rows[..., 1] - rows[..., 0], 0.0)
    sure = probability[..., 0] * (apart / (apart**2 + LEAST_APART**2))[..., np.newaxis] / (
        1.0 + np.exp(STEEP * np.clip(worse - MOST_WORSE, -9.0, 9.0)))
    most = seen.max(axis=-1)
    slope = np.clip((seen[..., 1] - seen[..., 0]) * sure, -most, most)
    thickness = np.exp(_least(residual))
    lost = slope[..., np.newaxis] * (
        1.0 - np.exp(-thickness[..., np.newaxis] * distance[..., np.newaxis, :]))
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
    """Fit `Statistics` over range for each attenuation of a grid: (..., 3, OF_CURVES).

    Statistics of the bins and what was taken away, see `level`; logarithms of residuals and of
    veils over the grid, where residuals are least, and the decay of contrast.
    """
    distance = np.exp(of_image[..., RANGES])
    of_bins, of_tiles, seen, slope = level(of_bins, of_tiles, of_channels, of_image)
    there = of_bins[..., -1]
    q = np.exp(of_bins[..., :len(QUANTILES)]) - FLOOR
    water = of_channels[..., IS_WATER] > 0.0
    residual, veil = _fit_all(FITS, q, there, of_tiles, seen, water, of_image)
    residual[..., NEEDS_WATER, :] *= water[..., np.newaxis, np.newaxis]
    square = np.exp(2.0 * np.moveaxis(of_bins[..., CONTRASTS], -1, -2))
    of_contrast = np.empty((*square.shape[:-1], len(THICKNESS)), np.float32)
    _fit_contrasts(
        *(np.ascontiguousarray(np.broadcast_to(each, square.shape)).reshape(-1, BINS) for each in (
            square, there[..., np.newaxis, :], distance[..., np.newaxis, np.newaxis, :])),
        of_contrast.reshape(-1, len(THICKNESS)))
    # (..., 3, fits, grid)
    residual = np.concatenate((residual, of_contrast), axis=-2)
    least, at = residual.min(axis=-1), _least(residual)
    log_veil = np.log(np.clip(veil[..., KEEP_VEIL, :], 0.5 * FLOOR, 8.0))
    flat = (*of_bins.shape[:-2], -1)
    return np.concatenate((
        of_bins.reshape(flat), slope[..., np.newaxis],
        (residual - least[..., np.newaxis]).reshape(flat), least, at,
        log_veil[..., KEPT].reshape(flat), _at(log_veil, at[..., KEEP_VEIL]),
        _decay(q, of_bins[..., LOCAL], distance, there)), axis=-1).astype(np.float32)


def _least(residual: NDArray[np.floating]) -> NDArray[np.floating]:
    """ln thickness where residuals over the grid are least, by a parabola, (...)."""
    middle = np.clip(residual.argmin(axis=-1), 1, len(THICKNESS) - 2)[..., np.newaxis]
    before, here, after = np.moveaxis(
        np.take_along_axis(residual, middle + np.arange(-1, 2), axis=-1), -1, 0)
    bend = np.maximum(before - 2.0 * here + after, 1e-6)
    step = np.clip(0.5 * (before - after) / bend, -1.0, 1.0)
    return np.asarray(LOG_THICKNESS[0] + (middle[..., 0] + step) * STEP)


def _at(values: NDArray[np.floating], log_thickness: NDArray[np.floating]) -> NDArray[np.floating]:
    """Values over the grid, interpolated at a thickness."""
    place = np.clip((log_thickness - LOG_THICKNESS[0]) / STEP, 0.0, len(THICKNESS) - 1.001)
    below = place.astype(int)
    first, second = np.moveaxis(
        np.take_along_axis(values, below[..., np.newaxis] + np.arange(2), axis=-1), -1, 0)
    return np.asarray(first + (place - below) * (second - first))


def _fit_all(
    fits: tuple[GridFit, ...], light: NDArray[np.floating], there: NDArray[np.floating],
    of_tiles: NDArray[np.floating], seen: NDArray[np.floating], water: NDArray[Any],
    of_image: NDArray[np.floating],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Residuals and veils of fits, (..., 3, fits, G) each.

    `light` (..., 3, BINS, K) are quantiles, with the weight `there` of each bin; `seen`
    (..., 3, 2) is open water's light, where there is `water`, (..., 3).
    """
    exponents = list(dict.fromkeys(fit.exponent for fit in fits))
    powers = np.stack([
        light if each == 1.0 else np.maximum(light, 0.0) ** each for each in exponents], axis=-3)
    places = [(*(fit.quantiles or (0, 0)), exponents.index(fit.exponent)) for fit in fits]
    numbers = [(fit.of_water, fit.gradient, fit.black, fit.growth) for fit in fits]
    flat = [
        np.ascontiguousarray(each, np.float32).reshape(-1, *each.shape[each.ndim - axes:])
        for each, axes in (
            (powers.swapaxes(-1, -2), 3), (there[..., np.newaxis, :], 2), (of_tiles, 3),
            (np.exp(of_image[..., RANGES]), 1), (of_image[..., np.newaxis, ROWS], 2), (seen, 1),
            (water, 0), (of_image[..., (UPPER_ROW, LOWER_ROW)], 1))]
    shape = (*there.shape[:-1], len(fits), len(THICKNESS))
    residual, veil = np.empty((2, len(flat[0]), *shape[-2:]), np.float32)
    _fit_veils(*flat, np.array(places), np.array(numbers), residual, veil)
    return residual.reshape(shape), veil.reshape(shape)


@njit(nogil=True)
def _fit_veils(
    light: Any, there: Any, tiles: Any, distance: Any, bin_row: Any, seen: Any, water: Any,
    rows: Any, places: Any, numbers: Any, residual: Any, veil: Any,
) -> None:
    """`_fit_veil` for all images, channels and fits."""
    transmission = np.empty((len(THICKNESS), distance.shape[1]), np.float32)
    for i in range(len(light)):
        image, c = i // 3, i % 3
        for g in range(len(THICKNESS)):
            for n in range(distance.shape[1]):
                transmission[g, n] = np.exp(-THICKNESS[g] * distance[image, n])
        for f in range(len(places)):
            first, last, power = places[f]
            if first < last:
                mean, weight, row = light[i, power, first:last], there[i], bin_row[image]
            else:
                mean, weight, row = tiles[image, c], tiles[image, WEIGHT], tiles[image, ROW]
            of_water, gradient, black, growth = numbers[f]
            _fit_veil(
                mean, weight, row, transmission, seen[i], rows[image],
                np.float32(of_water) * water[i], gradient > 0.0, black > 0.0, growth,
                residual[i, f], veil[i, f])


@njit(nogil=True)
def _fit_veil(
    mean: Any, weight: Any, row: Any, transmission: Any, seen: Any, rows: Any, of_seen: Any,
    gradient: bool, black: bool, growth: float, residual: Any, veil: Any,
) -> None:
    """ln of the mean squared residual, and B_0, for each thickness.

    With `black`, c is −B: surfaces reflect nothing. Without `gradient`, B_1 is 0. `seen` is what
    two parts of open water show at `rows`, with the weight `of_seen`. All `mean`, (K, N), have the
    weight and row of the first where there is no more, (1, N).
    """
    unveiled = np.empty(mean.shape[1], np.float32)
    for g in range(len(THICKNESS)):
        for n in range(mean.shape[1]):
            left = transmission[g, n]
            unveiled[n] = left if growth == 1.0 else left**growth
        # Normal equations of B_0 and B_1.
        a00, a01, a11, b0, b1, energy, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(mean.shape[0]):
            ll, l0, l1, ly = 0.0, 0.0, 0.0, 0.0
            own = min(k, len(weight) - 1)
            for n in range(mean.shape[1]):
                w = weight[own, n]
                if w <= 0.0:
                    continue
                left, missing = transmission[g, n], unveiled[n]
                y = mean[k, n]
                # What B_0 and B_1 are multiplied with; c includes −B_0 if the rates are one.
                of_0 = 1.0 - missing if black or growth != 1.0 else 1.0
                of_1 = row[own, n] * (1.0 - missing)
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
            energy += of_seen * seen[j] ** 2
            a00 += of_seen
            a01 += of_seen * rows[j]
            a11 += of_seen * rows[j] ** 2
            b0 += of_seen * seen[j]
            b1 += of_seen * rows[j] * seen[j]
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
        residual[g] = np.log(max(rest, 0.0) / max(total, 1e-3) + PRECISION**2)
        veil[g] = level


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
    x = distance[..., np.newaxis, :]
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
