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
    place = np.empty(width, np.int32)
    coloured = False
    margin = margins[1]
    stride = max(1, round(np.sqrt(height * width / PIXELS_READ_WHOLE)))
    for y in range(margin + (stride - 1) // 2, height - margin, stride):
        if np.isinf(tolerance):
            _place_row(range_map[y], low, cells_per_metre, place)
        else:
            _place_smooth_row(
                range_map[y], inverse, y, low, cells_per_metre, tolerance, noise, margins, place
            )
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
    for x in range(len(here)):
        cell = (here[x] - low) * cells_per_metre
        place[x] = np.int32(cell) if cell >= 0 and cell < CELLS else np.int32(-1)


@njit(nogil=True)
def _place_smooth_row(
    here: Any, inverse: Any, y: int, low: float, cells_per_metre: float, tolerance: float,
    noise: float, margins: tuple[int, int], place: Any,
) -> None:
    """Write the cell of range of each pixel of a row that lies on a smooth surface, or -1.

    The inverse of range is linear over a plane; at a jump its second
    difference is as large as the jump. Beside unknown pixels, comparisons are
    false. Without branches, the loop vectorises.
    """
    near, far = margins
    middle = inverse[y]
    up, down, top, bottom = inverse[y - near], inverse[y + near], inverse[y - far], inverse[y + far]
    place[:] = -1
    for x in range(far, len(here) - far):
        twice = middle[x] + middle[x]
        limit = tolerance * middle[x] + noise
        steep = MAX_SLOPE * middle[x]
        smooth = (
            (abs(middle[x - near] + middle[x + near] - twice) <= limit)
            & (abs(middle[x - far] + middle[x + far] - twice) <= limit)
            & (abs(up[x] + down[x] - twice) <= limit)
            & (abs(top[x] + bottom[x] - twice) <= limit)
            & (abs(up[x - near] + down[x + near] - twice) <= limit)
            & (abs(up[x + near] + down[x - near] - twice) <= limit)
            & (abs(top[x - far] + bottom[x + far] - twice) <= limit)
            & (abs(top[x + far] + bottom[x - far] - twice) <= limit)
            & (abs(middle[x + far] - middle[x - far]) <= steep)
            & (abs(top[x] - bottom[x]) <= steep)
        )
        cell = (here[x] - low) * cells_per_metre
        place[x] = np.int32(cell) if smooth & (cell >= 0) & (cell < CELLS) else np.int32(-1)


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
