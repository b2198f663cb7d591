# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Histograms of irradiance by range, and their quantiles."""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit

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
    low, cells_per_metre : float
        Least range, m, and fineness of `bin_of_cell`.
    bin_of_cell : (CELLS,) int32 ndarray
        Bin of each cell of range.
    tolerance, noise : float
        Departure of inverse range from a plane that is an edge: `tolerance`
        times the inverse range, plus `noise`, 1/m. An infinite tolerance
        keeps all pixels.
    margins : tuple of int
        How far from a pixel edges and unknown ranges are looked for, px: the
        nearer and the farther neighbours.
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
        place[x] = np.int32(cell) if (cell >= zero) & (cell < cells) else nothing


@njit(nogil=True)
def _mark_smooth(
    inverse: Any, y: int, tolerance: float, noise: float, margins: tuple[int, int], limit: Any,
    smooth: Any,
) -> None:
    """Mark the pixels of a row, without its margins, that lie on a smooth surface by 1.

    The inverse of range is linear over a plane; at a jump its second
    difference is as large as the jump. Beside unknown pixels, comparisons are
    false.
    """
    near, far = margins
    row, top, bottom = inverse[y], inverse[y - far], inverse[y + far]
    inner = slice(far, row.size - far)
    middle = row[inner]
    _start(middle, tolerance, noise, limit, smooth)
    for reach in (near, far):
        up, down = inverse[y - reach], inverse[y + reach]
        before, after = far - reach, far + reach
        _keep_straight(
            row[before:], row[after:], up[inner], down[inner], middle, limit, smooth)
        _keep_straight(
            up[before:], down[after:], up[after:], down[before:], middle, limit, smooth)
    _keep_flat(row, row[2 * far:], top[inner], bottom[inner], middle, smooth)


@njit(nogil=True)
def _start(middle: Any, tolerance: float, noise: float, limit: Any, smooth: Any) -> None:
    for x in range(middle.size):
        limit[x] = tolerance * middle[x] + noise
        smooth[x] = 1


@njit(nogil=True)
def _keep_straight(
    a: Any, b: Any, c: Any, d: Any, middle: Any, limit: Any, smooth: Any
) -> None:
    """Keep pixels midway between a and b, and c and d; of few arrays compilers make vector code."""
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

    Parameters
    ----------
    histogram : (bins, 3, L) int64 ndarray
        See `CELL_BITS`.
    edges, code_step : (L + 1,), (L,) float64 ndarray
        See `Levels`.
    min_pixels : int
        Pixels that a bin needs, else its values are NaN.
    ranks : (2, 3, bins) float64 ndarray
        Pixels that are darker than the dark envelope, and than its steepness's
        second point.
    bright_quantile : float
        That of the bright envelope.
    dark, dark_cell, steep, bright, step : (3, bins) float64 ndarray
        Filled: dark envelope, mean cell of the pixels below it, the second
        point, bright envelope, and a code's step at the dark one.
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
    """Level at which the running count reaches a rank, and where inside it."""
    running = 0
    level = 0
    while running + column[level] < rank:
        running += column[level]
        level += 1
    return level, (rank - running) / column[level]
