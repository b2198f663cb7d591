# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dark and bright envelopes of an image over range (eq. 4-5)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.images.pair import read_only
from uw_visibility.images.view import ColourSamples
from uw_visibility.optics.transfer import linear_table
from uw_visibility.water.blocks import MAX_RANGE, MIN_RANGE

# 16-bit codes are counted in groups of 16: a group spans a sixteenth of an
# 8-bit step, and the histogram still fits into the cache.
LEVELS_16_BIT = 4096
# Means of 8-bit codes: theirs tell no finer.
LEVELS_OF_MEANS = 1024


@dataclass(frozen=True)
class Levels:
    """Groups of code values that the histogram counts as one level.

    Attributes
    ----------
    of_code : (256,) or (65536,) uint16 ndarray
        Level of each code value.
    edges : (L + 1,) float64 ndarray
        Irradiance at the levels' edges, half a code beyond their codes.
    step : (L,) float64 ndarray
        Irradiance of one code value.
    """

    of_code: NDArray[np.uint16]
    edges: Array
    step: Array


@lru_cache(maxsize=8)
def levels(transfer: str, dtype: Any, number: int = LEVELS_16_BIT) -> Levels:
    """Levels, at most `number`, of images of a type and transfer."""
    irradiance = linear_table(transfer, dtype).astype(np.float64)
    group = len(irradiance) // min(len(irradiance), number)
    of_code = (np.arange(len(irradiance)) // group).astype(np.uint16)
    middles = 0.5 * (irradiance[1:] + irradiance[:-1])
    # The first and the last code span as much on their outer side.
    ends = 2 * irradiance[[0, -1]] - middles[[0, -1]]
    code_edges = np.concatenate((ends[:1], middles, ends[1:]))
    edges = code_edges[::group].copy()
    return Levels(of_code, edges, np.diff(edges) / group)


# Fineness at which ranges are told apart before they are gathered in bins.
CELLS = 2048
# An entry of the histogram holds the number of pixels above these bits, and in
# them the sum of the pixels' cells of range: one addition counts a pixel.
CELL_BITS = 36
# Larger images are read in every second row, every third ...: the darkest of so
# many pixels do not gain much from more.
PIXELS_READ_WHOLE = 130_000
# Range that changes by more than this fraction between the two outer neighbours
# of a pixel is too steep to be sure of: a slope seen at a grazing angle, or a
# mesh that was spanned over a jump.
MAX_SLOPE = np.float32(0.2)


@njit(nogil=True)
def accumulate(
    image: Any, range_map: Any, inverse: Any, mask: Any, masked: bool, level_of: Any, low: float,
    cells_per_metre: float, bin_of_cell: Any, tolerance: float, noise: float,
    margins: tuple[int, int], histogram: Any,
) -> bool:
    """Count levels by range bin and channel, in one pass; return whether any pixel has colour.

    Parameters
    ----------
    image : (H, W, 3) ndarray
        Code values.
    range_map, inverse : (H, W) float32 ndarray
        m, NaN where unknown, and its inverse.
    mask : (H, W) bool ndarray
        Pixels that count, where `masked`.
    level_of : (L,) uint16 ndarray
        Level of each code value.
    low, cells_per_metre, bin_of_cell
        Least range, m, fineness of the cells of range, and the bin of each, (CELLS,) int32.
    tolerance, noise : float
        A departure of inverse range (1/m) from a plane by more than `tolerance` times it plus
        `noise` is an edge. An infinite tolerance keeps all pixels.
    margins : tuple of int
        Distances, px, at which edges and unknown ranges exclude a pixel: near and far.
    histogram : (bins, 3, L) int64 ndarray
        Filled; see `CELL_BITS`.
    """
    height, width = range_map.shape
    # Margins have no cell.
    place, smooth = np.full(width, -1, np.int32), np.empty(width, np.int32)
    limit = np.empty(width, np.float32)
    coloured = False
    margin = margins[1]
    stride = max(1, round(np.sqrt(height * width / PIXELS_READ_WHOLE)))
    for y in range(margin + (stride - 1) // 2, height - margin, stride):
        if np.isinf(tolerance):
            _place_row(range_map[y], low, cells_per_metre, place)
        else:
            _mark_smooth(inverse, y, tolerance, noise, margins, limit, smooth)
            inner = slice(margin, width - margin)
            _place_row(range_map[y][inner], low, cells_per_metre, place[inner])
            _keep(smooth, place[inner])
        for x in range(width):
            cell = place[x]
            if cell < 0 or (masked and not mask[y, x]):
                continue
            red, green, blue = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            if (red | green | blue) == 0:
                continue
            coloured |= (red != green) | (green != blue)
            counts = histogram[bin_of_cell[cell]]
            entry = (np.int64(1) << CELL_BITS) + cell
            counts[0, level_of[red]] += entry
            counts[1, level_of[green]] += entry
            counts[2, level_of[blue]] += entry
    return coloured


@njit(nogil=True)
def _place_row(here: Any, low: float, cells_per_metre: float, place: Any) -> None:
    """Write the cell of range of each pixel of a row, or -1."""
    zero, cells, nothing = np.float32(0), np.float32(CELLS), np.int32(-1)
    for x in range(place.size):
        cell = (here[x] - low) * cells_per_metre
        inside = (cell >= zero) & (cell < cells)
        place[x] = index_of(cell, 0, CELLS - 1) if inside else nothing


@njit(nogil=True)
def _mark_smooth(
    inverse: Any, y: int, tolerance: float, noise: float, margins: tuple[int, int], limit: Any,
    smooth: Any,
) -> None:
    """Mark the pixels of a row, without its margins, that lie on a smooth surface.

    The inverse of range is linear over a plane; at a jump its second difference is as large as the
    jump. Beside unknown pixels, comparisons are false.
    """
    near, far = margins
    row, top, bottom = inverse[y], inverse[y - far], inverse[y + far]
    inner = slice(far, row.size - far)
    middle = row[inner]
    _start(middle, tolerance, noise, limit, smooth)
    for reach in (near, far):
        up, down = inverse[y - reach], inverse[y + reach]
        before, after = far - reach, far + reach
        _keep_straight(row[before:], row[after:], up[inner], down[inner], middle, limit, smooth)
        _keep_straight(up[before:], down[after:], up[after:], down[before:], middle, limit, smooth)
    _keep_flat(row, row[2 * far:], top[inner], bottom[inner], middle, smooth)


@njit(nogil=True)
def _start(middle: Any, tolerance: float, noise: float, limit: Any, smooth: Any) -> None:
    for x in range(middle.size):
        limit[x] = tolerance * middle[x] + noise
        smooth[x] = 1


@njit(nogil=True)
def _keep_straight(a: Any, b: Any, c: Any, d: Any, middle: Any, limit: Any, smooth: Any) -> None:
    """Keep pixels midway between a and b, and c and d; few arrays make vector code."""
    for x in range(middle.size):
        twice = middle[x] + middle[x]
        straight = (abs(a[x] + b[x] - twice) <= limit[x]) & (abs(c[x] + d[x] - twice) <= limit[x])
        smooth[x] = smooth[x] if straight else np.int32(0)


@njit(nogil=True)
def _keep_flat(a: Any, b: Any, c: Any, d: Any, middle: Any, smooth: Any) -> None:
    for x in range(middle.size):
        steep = MAX_SLOPE * middle[x]
        flat = (abs(b[x] - a[x]) <= steep) & (abs(c[x] - d[x]) <= steep)
        smooth[x] = smooth[x] if flat else np.int32(0)


@njit(nogil=True)
def _keep(smooth: Any, place: Any) -> None:
    for x in range(place.size):
        place[x] = place[x] if smooth[x] != 0 else np.int32(-1)


@njit(nogil=True)
def take_quantiles(
    histogram: Any, edges: Any, code_step: Any, min_pixels: int, ranks: Any,
    bright_quantile: float, dark: Any, dark_cell: Any, steep: Any, bright: Any, step: Any,
) -> None:
    """Take the quantiles of each histogram, leaving out its saturated level.

    `edges` and `code_step` are those of `Levels`; `ranks` (2, 3, bins) are the numbers of pixels
    below the dark envelope and below its second point, which shows its steepness. Fills (3, bins)
    each: dark envelope, mean cell of the pixels below it, the second point, bright envelope, and a
    code's step at the dark one; NaN where a bin has fewer than `min_pixels`.
    """
    bins, channels, number = histogram.shape
    column = np.empty(number, np.int64)
    for at in range(bins):
        for channel in range(channels):
            column[:] = histogram[at, channel] >> CELL_BITS
            total = column[:number - 1].sum()
            if total < min_pixels:
                dark[channel, at] = np.nan
                dark_cell[channel, at] = np.nan
                steep[channel, at] = np.nan
                bright[channel, at] = np.nan
                step[channel, at] = np.nan
                continue
            level, inside = _find(column, ranks[0, channel, at])
            # Counts that fall smoothly towards darkness place the quantile
            # inside its level. At a sharp end the true darkest value may lie
            # anywhere in the level: its middle is right on average.
            before = column[level - 1] if level > 0 else 0
            smooth = min(1.0, 2.0 * before / column[level])
            inside = smooth * inside + (1.0 - smooth) * 0.5
            dark[channel, at] = edges[level] + inside * (edges[level + 1] - edges[level])
            step[channel, at] = code_step[level]
            # The darkest pixels lie at the near end of their bin.
            entries = histogram[at, channel, :level + 1] & ((np.int64(1) << CELL_BITS) - 1)
            dark_cell[channel, at] = entries.sum() / column[:level + 1].sum()
            level, inside = _find(column, ranks[1, channel, at])
            steep[channel, at] = edges[level] + inside * (edges[level + 1] - edges[level])
            level, inside = _find(column, bright_quantile * total)
            # What is reached at least, since it bounds the ambient light.
            bright[channel, at] = edges[level]


@njit(nogil=True)
def _find(column: Any, rank: float) -> tuple[int, float]:
    """Level at which the running count reaches a rank, and the place inside it."""
    running = 0
    level = 0
    while level < column.size - 1 and running + column[level] < rank:
        running += column[level]
        level += 1
    return level, (rank - running) / column[level]


# Noise beyond the first of these, in 8-bit code values, would make up the dark
# envelope: the image is then filtered by a median, which also takes the flakes of
# marine snow. The quantiles move inwards, to the values below at the second.
NOISY = (0.6, 1.5)
MEDIAN_SIZE = 3
MEDIAN_NOISE_GAIN = 0.42
NOISY_DARK_QUANTILE = 0.004
NOISY_BRIGHT_FACTOR = 3.0
# The quantile that shows how steep the dark end of a bin is, over that of the envelope.
STEEPNESS_FACTOR = 10.0
STEEPNESS_FACTOR_OF_FEWEST = 4.0
# Calibration and fixed pattern that no filter takes, in 8-bit code values.
FIXED_PATTERN = 0.5
# How well the noise's part in the dark envelope is known.
SHIFT_UNCERTAINTY = 0.5

# Ranges beyond these quantiles are mostly wrong matches; they get no bin.
RANGE_QUANTILES = (0.005, 0.995)
RANGE_SAMPLES = 4096
# How far from a pixel edges matter, px: as far as the camera, and the median,
# blur; with measured ranges, as far as a matcher's window takes a surface's
# range beyond its edge.
MARGINS_EXACT = (1, 2)
MARGINS_FILTERED = (2, 4)
MARGINS_MEASURED = (3, 6)


@dataclass(frozen=True)
class Envelopes:
    """Dark and bright envelope of each channel over range.

    Attributes
    ----------
    range : (N,) float64 ndarray
        Mean range of the pixels in each bin, m, rising.
    count : (N,) int64 ndarray
        Pixels in each bin.
    dark, bright : (3, N) float64 ndarray
        Irradiance of the dark and of the bright envelope; NaN where too few
        pixels of the bin are unsaturated in that channel.
    dark_range : (3, N) float64 ndarray
        Mean range of the pixels that make up the dark envelope, m.
    step : (3, N) float64 ndarray
        Irradiance that one code value of the camera's spans at the dark envelope.
    deviation : (3, N) float64 ndarray
        Standard deviation of the dark envelope by rounding and noise.
    noise : (3,) float64 ndarray
        Standard deviation of the image's noise, in code values.
    pixels : int
        Pixels read that have a range inside the bins, away from edges.
    saturated, zero : (3,) float64 ndarray
        Fraction of those pixels in the highest level, and in the lowest.
    grey : bool
        Whether no pixel has any colour.
    limits : tuple of float
        Where the bins begin and end, m; twice 0 without ranges.
    range_error : float
        Standard deviation of range over its square, 1/m; 0 for exact ranges.
    """

    range: Array
    count: NDArray[np.int64]
    dark: Array
    dark_range: Array
    bright: Array
    step: Array
    deviation: Array
    noise: Array
    pixels: int
    saturated: Array
    zero: Array
    grey: bool
    limits: tuple[float, float] = (0.0, 0.0)
    range_error: float = 0.0


def observe(
    samples: ColourSamples, range_map: NDArray[np.float32], valid: Mask | None, *, bins: int,
    min_pixels: int, edge_tolerance: float, dark_quantile: float, fewest_dark: float,
    bright_quantile: float, range_error: float = 0.0, plain: bool = False,
) -> Envelopes:
    """Bin pixels by range and take the quantiles of each bin and channel (eq. 4-5).

    Padded pixels (0 in all channels) and saturated channels do not count.

    Parameters
    ----------
    samples : ColourSamples
    range_map : (H, W) float32 ndarray
        Range, m; NaN (or anything not above 0) where unknown.
    valid : (H, W) bool ndarray or None
        Pixels that may count; None for all.
    bins : int
        Range bins, of equal ratio.
    min_pixels : int
        Pixels that a bin needs.
    edge_tolerance : float
        Pixels are left out where the range beside them departs from a plane by
        more than this fraction, or is unknown.
    dark_quantile, bright_quantile : float
        Quantiles of the envelopes, 0..1.
    fewest_dark : float
        Pixels below the dark envelope at least.
    range_error : float
        Standard deviation of range over its square, 1/m; 0 for exact ranges.
    plain : bool
        As the paper: bins of equal width of all pixels, whatever edges and noise.

    Returns
    -------
    Envelopes
        Perhaps without any bin.
    """
    image, noise, means = samples.pixels, samples.noise, samples.scale > 1
    table = levels(samples.transfer, image.dtype, LEVELS_OF_MEANS if means else LEVELS_16_BIT)
    code_8_bit = len(table.of_code) // 256
    left = np.zeros((3, 1)) if plain else noise[:, np.newaxis]
    worst = noise.max() / code_8_bit
    filtered = not plain and worst > NOISY[0]
    if filtered:
        # Read-only as all images are, or the kernel would be compiled once more, in flight.
        image = read_only(cv2.medianBlur(image, MEDIAN_SIZE))
        left = MEDIAN_NOISE_GAIN * left
        dark_quantile = max(
            dark_quantile, float(np.interp(worst, NOISY, (dark_quantile, NOISY_DARK_QUANTILE))))
        bright_quantile = 1.0 - (1.0 - bright_quantile) * float(np.interp(
            worst, NOISY, (1.0, NOISY_BRIGHT_FACTOR)))
    mask = np.ones((1, 1), np.bool_) if valid is None else valid
    low, high = _range_limits(range_map, mask, valid is not None)
    histogram = np.zeros((bins, 3, len(table.step)), np.int64)
    metres_per_cell = (high - low) / CELLS
    coloured = metres_per_cell > 0 and accumulate(
        image, range_map, _inverse(range_map), mask, valid is not None, table.of_code,
        np.float32(low), np.float32(1 / metres_per_cell), _bins_of_cells(low, high, bins, plain),
        np.float32(np.inf if plain else edge_tolerance), np.float32(range_error),
        (0, 0) if plain else _margins(range_error, filtered, samples), histogram)
    counts = histogram >> CELL_BITS
    count = counts[:, 0].sum(axis=1)
    pixels = int(count.sum())
    share = 1.0 / max(pixels, 1)
    quantiles = _quantiles(counts, dark_quantile, fewest_dark)
    dark, dark_cell, steep, bright, step = np.empty((5, 3, bins))
    take_quantiles(
        histogram, table.edges, table.step, min_pixels,
        quantiles * np.maximum(counts[:, :, :-1].sum(axis=2).T, 1), bright_quantile,
        dark, dark_cell, steep, bright, step)
    shift = _noise_shift(left * step, steep - dark, quantiles)
    deviation = np.sqrt(
        step**2 * (1 / 12 + (FIXED_PATTERN * code_8_bit) ** 2 + left**2)
        + (SHIFT_UNCERTAINTY * shift) ** 2)
    full = count >= min_pixels
    cells = (histogram[full, 0] & ((1 << CELL_BITS) - 1)).sum(axis=1) / count[full]
    mean_range = low + (cells + 0.5) * metres_per_cell
    return Envelopes(
        range=mean_range,
        count=count[full],
        dark=(dark + shift)[:, full],
        dark_range=np.tile(mean_range, (3, 1)) if plain
        else low + (dark_cell[:, full] + 0.5) * metres_per_cell,
        bright=(bright - ndtri(bright_quantile) * left * step)[:, full],
        step=step[:, full] * (code_8_bit if means else 1),
        deviation=deviation[:, full],
        noise=noise,
        pixels=pixels,
        saturated=counts[:, :, -1].sum(axis=0) * share,
        zero=counts[:, :, 0].sum(axis=0) * share,
        grey=pixels > 0 and not coloured,
        limits=(low, high),
        range_error=range_error)


def _quantiles(counts: NDArray[np.int64], dark_quantile: float, fewest: float) -> Array:
    """(2, 3, bins): quantile of the dark envelope and of its second point."""
    total = np.maximum(counts[:, :, :-1].sum(axis=2).T, 1)
    dark = np.minimum(np.maximum(dark_quantile, fewest / total), 0.5)
    steep = np.minimum(
        np.maximum(STEEPNESS_FACTOR * dark_quantile, STEEPNESS_FACTOR_OF_FEWEST * fewest / total),
        0.5)
    return np.stack((dark, np.maximum(steep, dark)))


def _noise_shift(noise: Array, rise: Array, quantiles: Array) -> Array:
    """Bias of the dark envelope by noise.

    Where noise alone makes the dark end, the envelope lies at the noise's own quantile; where the
    scene itself has a long tail, the bias is smaller in proportion to the steepness.
    """
    outer, inner = -ndtri(quantiles)
    steepness = np.minimum((outer - inner) * noise / np.maximum(rise, 1e-9), 1.0)
    return np.asarray(outer * noise * steepness)


def _margins(range_error: float, filtered: bool, samples: ColourSamples) -> tuple[int, int]:
    margins = MARGINS_FILTERED if filtered else MARGINS_EXACT
    near, far = MARGINS_MEASURED if range_error > 0 else margins
    return samples.margin(near), samples.margin(far)


def _inverse(range_map: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        return np.asarray(np.float32(1) / range_map)


def _bins_of_cells(low: float, high: float, bins: int, plain: bool) -> NDArray[np.int32]:
    """Bin of each cell of range: of equal width, or of equal ratio."""
    place = (np.arange(CELLS) + 0.5) / CELLS
    if not plain:
        place = np.log1p(place * (high / low - 1)) / math.log(high / low)
    return (np.minimum(place, 1 - 1e-9) * bins).astype(np.int32)


def _range_limits(range_map: NDArray[np.float32], mask: Mask, masked: bool) -> tuple[float, float]:
    """Where the bins begin and end, m; (0, 0) without ranges."""
    stride = max(1, math.isqrt(range_map.size // RANGE_SAMPLES))
    ranges = range_map[::stride, ::stride]
    known = (ranges > MIN_RANGE) & (ranges < MAX_RANGE)
    if masked:
        known &= mask[::stride, ::stride]
    if not known.any():
        return 0.0, 0.0
    sorted_ranges = np.sort(ranges[known])
    last = len(sorted_ranges) - 1
    low, high = (float(sorted_ranges[round(q * last)]) for q in RANGE_QUANTILES)
    # A range equal to the upper limit belongs to the last bin.
    return low, high * (1 + 1e-6)
