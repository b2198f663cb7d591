# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Contrast and envelopes of a lamp-lit image, over range and image column.

Each pixel is divided by the direct light of the lamps at its place, D of a reference
attenuation, so that what is left of range and direction is e^(−(β − β₀) (r + d)) and what
the water scatters. Contrast is the second difference along the row, between points of
equal distance on the scene: the veil adds the same to both sides, texture is compared at
one scale, and ground that falls away from the camera is not foreshortened along the row.
It is the product of two such differences, of pixels that are not the same, so that their
noise cancels whatever it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.images.noise import ROUNDING_VARIANCE
from uw_visibility.images.view import ColourSamples
from uw_visibility.optics.lamps import RANGES, LampTables, Table
from uw_visibility.optics.transfer import linear_table

# Cells: bins of range, of equal ratio, by columns of the image.
RANGE_BINS, COLUMNS = 24, 4
# Pixels read, and those that a cell needs.
PIXELS_READ = 100_000
FEWEST_PIXELS = 60
# Ranges beyond these quantiles are mostly wrong matches.
RANGE_QUANTILES = (0.005, 0.98)
RANGE_SAMPLES = 4096
# Distance of the compared points as a part of the image's width, at a range, m, and the
# largest one, near by; at least as many pixels as a camera's blur is wide. The same in all
# frames, so that many of them may be taken together.
FAR_PART, FAR_RANGE, NEAR_PART, LEAST_SEPARATION = 1 / 90, 12.0, 1 / 10, 3
# Farthest over nearest bin at least.
LEAST_RATIO = 1.5
# Light is the mean of nine pixels, as far from one another along the row as this part of
# that; of three where the ground falls away so steeply that its rows are farther apart.
BOX = 0.1
# Tangent of the slant beyond which the range beside a pixel is that of something else.
MOST_SLANT = 100.0
# Range beside a pixel departs from a line by less than this part, and from its own by less
# than the other.
BEND, SLOPE = np.float32(0.04), np.float32(0.12)
# Levels of E/D in which quantiles are found: so many per octave, from this part of the
# frame's median up. Where hardly any direct light is left, E/D is large.
LEVELS, PER_OCTAVE = 208, 8
# The same by a factor of e: the oldest numba knows no logarithm to the base 2.
PER_E_FOLD = PER_OCTAVE / math.log(2.0)
LOWEST = 2.0 ** -13
DARK_QUANTILE, BRIGHT_QUANTILE = 0.02, 0.95
# Columns of the sums of a cell: of three channels, from these on; then single ones.
PRODUCT, NOISE, LIGHT, ALIKE = 0, 3, 6, 9
COLUMN, ROW, LOG_RANGE, PIXELS, LOG_COSINE, SUMS = range(12, 18)
# Counts of pixels, the first two of three channels.
SATURATED, ZERO, READ = 0, 3, 6
# Terms of the series of the rounding error: the rest is 3 % of it where there is no noise.
ROUNDING_TERMS = 20


@dataclass(frozen=True)
class LampObservations:
    """What the cells of a lamp-lit image show, in units of D or S of a reference attenuation.

    Attributes
    ----------
    column, row, range : (N,) float64 ndarray
        Mean place of each cell's pixels: px, px, m.
    count : (N,) float64 ndarray
        Pixels read in each.
    contrast : (3, N) float64 ndarray
        Root of the mean product of two second differences over D; below 0 where that is.
    noise : (3, N) float64 ndarray
        What noise makes of the root mean square of one of all pixels.
    mean, bright : (3, N) float64 ndarray
        Mean and quantile of E/D.
    dark : (3, N) float64 ndarray
        Quantile of E/S, so that what is scattered differs little within a cell.
    saturated, zero : (3,) float64 ndarray
        Part of the pixels with a range that are saturated, or 0.
    limits : tuple of float
        Nearest and farthest range, m; twice 0 without any.
    log_cosine : (N,) float64 ndarray
        Mean logarithm of the cosine of incidence.
    """

    column: Array
    row: Array
    range: Array
    count: Array
    contrast: Array
    noise: Array
    mean: Array
    dark: Array
    bright: Array
    saturated: Array
    zero: Array
    limits: tuple[float, float]
    log_cosine: Array


def observe(
    samples: ColourSamples, range_map: NDArray[np.float32], valid: Mask | None, tables: LampTables,
    log_direct: Table, log_scattered: Table, row_angle: float, log_cosine: NDArray[np.float32],
) -> LampObservations:
    """Observe a lamp-lit image.

    Parameters
    ----------
    samples : ColourSamples
    range_map : (H, W) float32 ndarray
        Of the camera's pixels, m; NaN where unknown.
    valid : (H, W) bool ndarray or None
        Pixels that show the scene.
    tables : LampTables
        Of the camera's pixels.
    log_direct, log_scattered : (Y, X, R) float32 ndarray
        ln D and ln S of the reference attenuation.
    row_angle : float
        Angle between the camera's rows, rad.
    log_cosine : (h, w) float32 ndarray
        Of incidence, at nodes of equal distance over the samples.
    """
    ranges, valid = samples.reduce(range_map, valid)
    ranges = np.ascontiguousarray(ranges)
    mask = np.ones((1, 1), np.bool_) if valid is None else np.ascontiguousarray(valid)
    sums = np.zeros((RANGE_BINS * COLUMNS, SUMS))
    levels = np.zeros((2, RANGE_BINS * COLUMNS, 3, LEVELS), np.int32)
    clipped = np.zeros(7, np.int64)
    irradiance = linear_table(samples.transfer, samples.pixels.dtype)
    scale = samples.scale
    grid = table_grid(tables, scale)
    width = ranges.shape[1]
    stride = max(1, round(math.sqrt(ranges.size / PIXELS_READ)))
    limits, median = _few(
        samples, ranges, mask, irradiance, grid, (log_direct, log_scattered))
    if median.all():
        _accumulate(
            _Scene(samples.pixels, ranges, mask, irradiance, log_cosine),
            _Light(grid, log_direct, log_scattered, 1.0 / (LOWEST * median)),
            _Sampling(
                limits[0], limits[1], width * FAR_PART * FAR_RANGE, width * NEAR_PART, stride,
                row_angle * scale, samples.noise**2 + ROUNDING_VARIANCE,
                _common_rounding(samples.noise)),
            sums, levels, clipped)
    enough = sums[:, PIXELS] >= FEWEST_PIXELS
    sums, levels = sums[enough], levels[:, enough]
    count = sums[:, PIXELS, np.newaxis]
    # One square and half of two others.
    noise = 1.5 * sums[:, NOISE:NOISE + 3] / count
    variance = sums[:, PRODUCT:PRODUCT + 3] / count
    variance = variance - 1.5 * sums[:, ALIKE:ALIKE + 3] / count
    contrast = np.sign(variance) * np.sqrt(np.abs(variance))
    pixels = max(int(clipped[READ]), 1)
    mean = sums / count
    shift = 0.5 * (scale - 1)
    return LampObservations(
        column=mean[:, COLUMN] * scale + shift, row=mean[:, ROW] * scale + shift,
        range=np.exp(mean[:, LOG_RANGE]), count=count[:, 0], contrast=contrast.T,
        noise=np.sqrt(noise).T, mean=mean[:, LIGHT:LIGHT + 3].T,
        dark=_quantile(levels[1], DARK_QUANTILE) * median[1],
        bright=_quantile(levels[0], BRIGHT_QUANTILE) * median[0],
        saturated=clipped[SATURATED:SATURATED + 3] / pixels,
        zero=clipped[ZERO:ZERO + 3] / pixels, limits=limits, log_cosine=mean[:, LOG_COSINE])


def table_grid(tables: LampTables, scale: int) -> Array:
    """Origins and steps by which samples of a scale, and ln d, become places in tables."""
    # Coordinates of the nodes for a sample's middle.
    shift = 0.5 * (scale - 1)
    return np.array([
        (shift - tables.rows[0]) / (tables.rows[1] - tables.rows[0]),
        scale / (tables.rows[1] - tables.rows[0]),
        (shift - tables.columns[0]) / (tables.columns[1] - tables.columns[0]),
        scale / (tables.columns[1] - tables.columns[0]),
        math.log(RANGES[0]), 1.0 / math.log(RANGES[1] / RANGES[0])])


def _common_rounding(noise: Array) -> Array:
    """Covariance of the rounding errors of two pixels of one value, codes squared.

    By the Fourier series of the rounding error (Widrow and Kollar 2008, Quantization Noise,
    Cambridge University Press), with independent Gaussian noise of a standard deviation, (3,).
    """
    k = np.arange(1, ROUNDING_TERMS + 1)[:, np.newaxis]
    terms = np.exp(-((2 * math.pi * k * noise) ** 2)) / (2 * (math.pi * k) ** 2)
    return np.asarray(terms.sum(axis=0))


def _few(
    samples: ColourSamples, ranges: NDArray[np.float32], mask: Mask,
    irradiance: NDArray[np.float32], grid: Array, tables: tuple[Table, Table],
) -> tuple[tuple[float, float], Array]:
    """Limits of range, m, and medians of E/D and E/S, (2,), over a few pixels; 0 without any.

    Of each pixel the brightest channel counts.
    """
    stride = max(1, math.isqrt(ranges.size // RANGE_SAMPLES))
    few = ranges[::stride, ::stride]
    known = np.isfinite(few) & (few > 0)
    if mask.size > 1:
        known &= mask[::stride, ::stride]
    if not known.any():
        return (0.0, 0.0), np.zeros(2)
    low, high = np.quantile(few[known], RANGE_QUANTILES)
    y, x = np.nonzero(known)
    light = irradiance[samples.pixels[::stride, ::stride][known][::4]].max(axis=1)
    logarithm = np.array([
        [look_up(table, grid[0] + grid[1] * r * stride, grid[2] + grid[3] * c * stride,
                 (math.log(d) - grid[4]) * grid[5])
         for r, c, d in zip(y[::4], x[::4], few[known][::4], strict=True)]
        for table in tables])
    return (
        (float(low), float(high) * (1 + 1e-6)), np.median(light * np.exp(-logarithm), axis=1))


def _quantile(levels: NDArray[np.int32], quantile: float) -> Array:
    """Quantile of each cell and channel, (3, N), as part of the median."""
    if len(levels) == 0:
        return np.zeros((3, 0))
    summed = np.cumsum(levels, axis=2)
    wanted = quantile * summed[:, :, -1:]
    at = np.argmax(summed >= wanted, axis=2)
    below = np.take_along_axis(summed - levels, at[..., None], 2)[..., 0]
    inside = np.maximum(np.take_along_axis(levels, at[..., None], 2)[..., 0], 1)
    share = (wanted[..., 0] - below) / inside
    return np.asarray(LOWEST * 2.0 ** ((at + share) / PER_OCTAVE)).T


class _Scene(NamedTuple):
    """Pixels of one scale, with their ranges and the cosines of incidence at nodes."""

    image: NDArray[Any]
    ranges: NDArray[np.float32]
    mask: Mask
    irradiance: NDArray[np.float32]
    log_cosine: NDArray[np.float32]


class _Light(NamedTuple):
    """Tables of ln D and ln S, the grid of `table_grid`, and levels over the lowest of each."""

    grid: Array
    log_direct: Table
    log_scattered: Table
    inverse_lowest: Array


class _Sampling(NamedTuple):
    """Limits of range (m), distance of compared pixels, noise (codes squared)."""

    low: float
    high: float
    # Distance of compared pixels times range (px m), and at most (px).
    separation: float
    most: float
    stride: int
    row_angle: float
    noise: Array
    common_rounding: Array


@njit(nogil=True, error_model="numpy")
def look_up(table: Any, y: float, x: float, z: float) -> float:
    """Interpolate a table (Y, X, R) at a place in units of its nodes, clipped to them."""
    y = min(max(y, 0.0), table.shape[0] - 1.001)
    x = min(max(x, 0.0), table.shape[1] - 1.001)
    z = min(max(z, 0.0), table.shape[2] - 1.001)
    j = index_of(y, 0, table.shape[0] - 2)
    i = index_of(x, 0, table.shape[1] - 2)
    k = index_of(z, 0, table.shape[2] - 2)
    fy, fx, fz = y - j, x - i, z - k
    near = (1 - fx) * table[j, i, k] + fx * table[j, i + 1, k]
    near = (1 - fy) * near + fy * ((1 - fx) * table[j + 1, i, k] + fx * table[j + 1, i + 1, k])
    far = (1 - fx) * table[j, i, k + 1] + fx * table[j, i + 1, k + 1]
    far = (1 - fy) * far + fy * (
        (1 - fx) * table[j + 1, i, k + 1] + fx * table[j + 1, i + 1, k + 1])
    return (1 - fz) * near + fz * far


@njit(nogil=True, error_model="numpy")
def _accumulate(
    scene: Any, by: Any, sampling: Any, sums: Any, levels: Any, clipped: Any
) -> None:
    """Sum what `LampObservations` holds over the pixels of each cell."""
    image, ranges, mask, irradiance, cosine = scene
    grid, table, scattered, _ = by
    low, high, stride = sampling.low, sampling.high, sampling.stride
    height, width = ranges.shape
    masked = mask.size > 1
    top = irradiance.size - 1
    # Of the outer and of the inner columns of a square, whose noise differs.
    light, inner = np.empty((3, 3), np.float32), np.empty((3, 3), np.float32)
    least, largest = np.empty(3, np.int32), np.empty(3, np.int32)
    log_low = math.log(low)
    per_log = RANGE_BINS / math.log(max(high / low, LEAST_RATIO))
    for y in range(stride // 2, height, stride):
        for x in range(stride // 2, width, stride):
            d = ranges[y, x]
            if not (d >= low and d < high) or (masked and not mask[y, x]):
                continue
            clipped[READ] += 1
            full = False
            for c in range(3):
                code = image[y, x, c]
                full |= code >= top
                clipped[SATURATED + c] += code >= top
                clipped[ZERO + c] += code == 0
            distance = index_of(
                max(min(sampling.separation / d, sampling.most), LEAST_SEPARATION) + 0.5, 0, width)
            half = index_of(BOX * distance + 0.5, 1, width)
            if (full or x < distance + half or x + distance + half >= width
                    or y < half or y + half >= height):
                continue
            left, right = ranges[y, x - distance], ranges[y, x + distance]
            # Written so that unknown ranges fail.
            if not (abs(left + right - 2 * d) < BEND * d and abs(left - right) < SLOPE * d):
                continue
            if masked and not (mask[y, x - distance] and mask[y, x + distance]):
                continue
            # Ground that falls away is foreshortened along the column: a square on it.
            slant = abs(ranges[y + half, x] - ranges[y - half, x]) / (
                2 * half * d * sampling.row_angle)
            foreshortened = half / math.sqrt(1 + slant * slant)
            tall = index_of(foreshortened + 0.5, 0, half) if slant < MOST_SLANT else half
            light[:] = 0.0
            inner[:] = 0.0
            least[:] = top
            largest[:] = 0
            for k in range(3):
                middle = x + (k - 1) * distance
                for j in (y - tall, y, y + tall):
                    for c in range(3):
                        first, code, last = (
                            image[j, middle - half, c], image[j, middle, c],
                            image[j, middle + half, c])
                        full |= max(first, code, last) >= top
                        if k == 1:
                            least[c] = min(least[c], first, code, last)
                            largest[c] = max(largest[c], first, code, last)
                        light[k, c] += irradiance[first] + irradiance[last]
                        inner[k, c] += irradiance[code]
            if full:
                continue
            log_d = math.log(d)
            inverse = math.exp(-look_up(
                table, grid[0] + grid[1] * y, grid[2] + grid[3] * x,
                (log_d - grid[4]) * grid[5]))
            cell = index_of((log_d - log_low) * per_log, 0, RANGE_BINS - 1) * COLUMNS
            cell += x * COLUMNS // width
            for c in range(3):
                outside = light[1, c] - 0.5 * (light[0, c] + light[2, c])
                inside = inner[1, c] - 0.5 * (inner[0, c] + inner[2, c])
                sums[cell, PRODUCT + c] += inverse * inverse / 18.0 * outside * inside
                code = image[y, x, c]
                step = inverse * (irradiance[min(code + 1, top)] - irradiance[code])
                # Where a square is not of one code, rounding errors differ within it.
                alike = sampling.common_rounding[c] if largest[c] == least[c] else 0.0
                alone = sampling.noise[c] / (9.0 if tall else 3.0)
                sums[cell, NOISE + c] += step * step * (alone + alike)
                sums[cell, ALIKE + c] += step * step * alike
                light[1, c] += inner[1, c]
                value = inverse / 9.0 * light[1, c]
                sums[cell, LIGHT + c] += value
                value *= by.inverse_lowest[0]
                level = index_of(math.log(max(value, 1.0)) * PER_E_FOLD, 0, LEVELS - 1)
                levels[0, cell, c, level] += 1
            inverse = math.exp(-look_up(
                scattered, grid[0] + grid[1] * y, grid[2] + grid[3] * x,
                (log_d - grid[4]) * grid[5])) / 9.0
            for c in range(3):
                value = inverse * light[1, c] * by.inverse_lowest[1]
                level = index_of(math.log(max(value, 1.0)) * PER_E_FOLD, 0, LEVELS - 1)
                levels[1, cell, c, level] += 1
            sums[cell, COLUMN] += x
            sums[cell, ROW] += y
            sums[cell, LOG_RANGE] += log_d
            sums[cell, PIXELS] += 1
            sums[cell, LOG_COSINE] += cosine[
                y * cosine.shape[0] // height, x * cosine.shape[1] // width]
