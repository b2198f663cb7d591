# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What an image says about the water: dark and bright envelopes over range (eq. 4-5)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uw_visibility.water.transfer import linear_table

# 16-bit codes are counted in groups of 16: a group spans a sixteenth of an
# 8-bit step, and the histogram still fits into the cache.
LEVELS_16_BIT = 4096
# Ranges beyond these quantiles are mostly wrong matches; they get no bin.
RANGE_QUANTILES = (0.005, 0.995)
RANGE_SAMPLES = 4096
# Pixels this close to a jump of range often carry the range of the other side.
EDGE_DISTANCE = 2


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
    step : (3, N) float64 ndarray
        Irradiance that one code value spans at the dark envelope.
    pixels : int
        Pixels with a range inside the bins, away from edges.
    saturated, zero : (3,) float64 ndarray
        Fraction of those pixels at the largest code, and at code 0.
    grey : bool
        Whether no pixel has any colour.
    """

    range: NDArray[np.float64]
    count: NDArray[np.int64]
    dark: NDArray[np.float64]
    bright: NDArray[np.float64]
    step: NDArray[np.float64]
    pixels: int
    saturated: NDArray[np.float64]
    zero: NDArray[np.float64]
    grey: bool


@dataclass(frozen=True)
class Levels:
    """How code values are grouped into the levels of the histogram.

    Attributes
    ----------
    of_code : (256,) or (65536,) uint16 ndarray
        Level of each code value.
    edges : (L + 1,) float64 ndarray
        Irradiance at the levels' edges, half a code beyond their codes.
    step : (L,) float64 ndarray
        Irradiance that one code value spans.
    """

    of_code: NDArray[np.uint16]
    edges: NDArray[np.float64]
    step: NDArray[np.float64]


@lru_cache(maxsize=8)
def levels(transfer: str, dtype: Any) -> Levels:
    """Return the levels of images of a type and transfer; see `Levels`."""
    irradiance = linear_table(transfer, dtype).astype(np.float64)
    group = len(irradiance) // min(len(irradiance), LEVELS_16_BIT)
    of_code = (np.arange(len(irradiance)) // group).astype(np.uint16)
    middles = 0.5 * (irradiance[1:] + irradiance[:-1])
    # The first and the last code span as much on their outer side.
    ends = 2 * irradiance[[0, -1]] - middles[[0, -1]]
    code_edges = np.concatenate((ends[:1], middles, ends[1:]))
    edges = code_edges[::group].copy()
    return Levels(of_code, edges, np.diff(edges) / group)


def observe(
    image: NDArray[Any],
    range_map: NDArray[np.float32],
    valid: NDArray[np.bool_] | None,
    *,
    transfer: str,
    bins: int,
    min_pixels: int,
    edge_tolerance: float,
    dark_quantile: float,
    bright_quantile: float,
) -> Envelopes:
    """Bin pixels by range and take the quantiles of each bin and channel (eq. 4-5).

    Parameters
    ----------
    image : (H, W, 3) uint8 or uint16 ndarray
        RGB code values.
    range_map : (H, W) float32 ndarray
        Range, m; NaN (or anything not above 0) where unknown.
    valid : (H, W) bool ndarray or None
        Pixels that may count; None for all.
    transfer : str
        ``"linear"`` or ``"srgb"``.
    bins : int
        Range bins, equally wide.
    min_pixels : int
        Pixels that a bin needs.
    edge_tolerance : float
        Pixels are left out where the range `EDGE_DISTANCE` px beside them
        differs by more than this fraction.
    dark_quantile, bright_quantile : float
        Quantiles of the envelopes, 0..1.

    Returns
    -------
    Envelopes
        Perhaps without any bin. Padded pixels (0 in all channels) do not
        count, nor do saturated channels.
    """
    table = levels(transfer, image.dtype)
    mask = np.ones((1, 1), np.bool_) if valid is None else valid
    low, high = _range_limits(range_map, mask, valid is not None)
    histogram = np.zeros((3, bins, len(table.step)), np.int32)
    range_sum = np.zeros(bins)
    tally = np.zeros(8, np.int64)
    if high > low:
        _accumulate(
            image, range_map, mask, valid is not None, table.of_code, low,
            bins / (high - low), np.float32(edge_tolerance), histogram, range_sum, tally,
        )
    pixels = int(tally[0])
    share = 1.0 / max(pixels, 1)
    count = np.zeros(bins, np.int64)
    dark, bright, step = np.empty((3, 3, bins))
    _quantiles(
        histogram, table.edges, table.step, min_pixels, dark_quantile, bright_quantile,
        dark, bright, step, count,
    )
    full = count >= min_pixels
    return Envelopes(
        range=range_sum[full] / count[full],
        count=count[full],
        dark=dark[:, full],
        bright=bright[:, full],
        step=step[:, full],
        pixels=pixels,
        saturated=tally[1:4] * share,
        zero=tally[4:7] * share,
        grey=pixels > 0 and int(tally[7]) == 0,
    )


def _range_limits(
    range_map: NDArray[np.float32], mask: NDArray[np.bool_], masked: bool
) -> tuple[float, float]:
    stride = max(1, math.isqrt(range_map.size // RANGE_SAMPLES))
    ranges = range_map[::stride, ::stride]
    known = np.isfinite(ranges) & (ranges > 0)
    if masked:
        known &= mask[::stride, ::stride]
    if not known.any():
        return 0.0, 0.0
    sorted_ranges = np.sort(ranges[known])
    last = len(sorted_ranges) - 1
    low, high = (float(sorted_ranges[round(q * last)]) for q in RANGE_QUANTILES)
    # A range equal to the upper limit belongs to the last bin.
    return low, high * (1 + 1e-6)


@njit(nogil=True, cache=True)  # type: ignore[untyped-decorator]
def _accumulate(
    image: Any, range_map: Any, mask: Any, masked: bool, level_of: Any, low: float,
    bins_per_metre: float, tolerance: float, histogram: Any, range_sum: Any, tally: Any,
) -> None:
    """Count levels by channel and range bin, in one pass over the pixels."""
    height, width = range_map.shape
    top = len(level_of) - 1
    bins = histogram.shape[1]
    for y in range(height):
        above = max(y - EDGE_DISTANCE, 0)
        below = min(y + EDGE_DISTANCE, height - 1)
        for x in range(width):
            distance = range_map[y, x]
            # Also refuses NaN, and what lies before the first bin.
            if not distance >= low or (masked and not mask[y, x]):
                continue
            place = (distance - low) * bins_per_metre
            if place >= bins:
                continue
            # Comparisons with an unknown neighbour are false: it is no edge.
            jump = tolerance * distance
            if (
                abs(range_map[above, x] - distance) > jump
                or abs(range_map[below, x] - distance) > jump
                or abs(range_map[y, max(x - EDGE_DISTANCE, 0)] - distance) > jump
                or abs(range_map[y, min(x + EDGE_DISTANCE, width - 1)] - distance) > jump
            ):
                continue
            red, green, blue = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            if red == 0 and green == 0 and blue == 0:
                continue
            at = int(place)
            tally[0] += 1
            range_sum[at] += distance
            if red != green or green != blue:
                tally[7] += 1
            for channel in range(3):
                code = image[y, x, channel]
                if code == 0:
                    tally[4 + channel] += 1
                if code == top:
                    tally[1 + channel] += 1
                histogram[channel, at, level_of[code]] += 1


@njit(nogil=True, cache=True)  # type: ignore[untyped-decorator]
def _quantiles(
    histogram: Any, edges: Any, code_step: Any, min_pixels: int, dark_quantile: float,
    bright_quantile: float, dark: Any, bright: Any, step: Any, count: Any,
) -> None:
    """Take the quantiles of each histogram, leaving out its saturated level."""
    channels, bins, number = histogram.shape
    for at in range(bins):
        for level in range(number):
            count[at] += histogram[0, at, level]
        for channel in range(channels):
            column = histogram[channel, at]
            total = count[at] - column[number - 1]
            if total < min_pixels:
                dark[channel, at] = np.nan
                bright[channel, at] = np.nan
                step[channel, at] = np.nan
                continue
            level, inside = _find(column, max(dark_quantile * total, 0.5))
            # Counts that fall smoothly towards darkness place the quantile
            # inside its level. At a sharp end the true darkest value may lie
            # anywhere in the level: its middle is right on average.
            before = column[level - 1] if level > 0 else 0
            smooth = min(1.0, 2.0 * before / column[level])
            inside = smooth * inside + (1.0 - smooth) * 0.5
            dark[channel, at] = edges[level] + inside * (edges[level + 1] - edges[level])
            step[channel, at] = code_step[level]
            level, inside = _find(column, bright_quantile * total)
            bright[channel, at] = 0.5 * (edges[level] + edges[level + 1])


@njit(nogil=True, cache=True)  # type: ignore[untyped-decorator]
def _find(column: Any, rank: float) -> tuple[int, float]:
    """Level at which the running count reaches a rank, and where inside it."""
    running = 0
    level = 0
    while running + column[level] < rank:
        running += column[level]
        level += 1
    return level, (rank - running) / column[level]
