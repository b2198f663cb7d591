# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What an image says about the water: dark and bright envelopes over range (eq. 4-5)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri

from uw_visibility.water.noise import noise_stddev
from uw_visibility.water.transfer import linear_table

# Noise beyond the first of these, in 8-bit code values, would make up the dark
# envelope: the image is then filtered by a median, which also takes the flakes of
# marine snow. The quantiles move inwards, by the factors below at the second.
NOISY = (0.6, 1.5)
MEDIAN_SIZE = 3
MEDIAN_NOISE_GAIN = 0.42
NOISY_DARK_FACTOR = 2.0
NOISY_BRIGHT_FACTOR = 3.0
# The quantile that shows how steep the dark end of a bin is, over that of the envelope.
STEEPNESS_FACTOR = 10.0
# Calibration and fixed pattern that no filter takes, in 8-bit code values.
FIXED_PATTERN = 1.0

# 16-bit codes are counted in groups of 16: a group spans a sixteenth of an
# 8-bit step, and the histogram still fits into the cache.
LEVELS_16_BIT = 4096
# Ranges beyond these quantiles are mostly wrong matches; they get no bin.
RANGE_QUANTILES = (0.005, 0.995)
RANGE_SAMPLES = 4096
# Pixels this close to a jump of range often carry the range of the other side.
EDGE_DISTANCE = 2
# Larger images are read in every second row, every third ...: quantiles of so
# many pixels do not gain from more.
MAX_PIXELS = 200_000
# The mean range of a bin is taken over every such column.
RANGE_STRIDE = 4


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
    """

    range: NDArray[np.float64]
    count: NDArray[np.int64]
    dark: NDArray[np.float64]
    bright: NDArray[np.float64]
    step: NDArray[np.float64]
    deviation: NDArray[np.float64]
    noise: NDArray[np.float64]
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
    denoise: bool = True,
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
    denoise : bool
        Whether to take the effect of noise out of the envelopes.

    Returns
    -------
    Envelopes
        Perhaps without any bin. Padded pixels (0 in all channels) do not
        count, nor do saturated channels.
    """
    table = levels(transfer, image.dtype)
    noise = noise_stddev(image)
    code_8_bit = len(table.of_code) // 256
    left = noise if denoise else np.zeros(3)
    worst = noise.max() / code_8_bit
    if denoise and worst > NOISY[0]:
        image = cv2.medianBlur(image, MEDIAN_SIZE)
        left = MEDIAN_NOISE_GAIN * noise
        dark_quantile *= np.interp(worst, NOISY, (1.0, NOISY_DARK_FACTOR))
        bright_quantile = 1.0 - (1.0 - bright_quantile) * np.interp(
            worst, NOISY, (1.0, NOISY_BRIGHT_FACTOR))
    mask = np.ones((1, 1), np.bool_) if valid is None else valid
    low, high = _range_limits(range_map, mask, valid is not None)
    histogram = np.zeros((bins, 3, len(table.step)), np.int32)
    range_sum = np.zeros((bins, 2))
    coloured = high > low and _accumulate(
        image, range_map, mask, valid is not None, table.of_code, np.float32(low),
        np.float32(bins / (high - low)), np.float32(edge_tolerance), histogram, range_sum,
    )
    count = histogram[:, 0].sum(axis=1, dtype=np.int64)
    pixels = int(count.sum())
    share = 1.0 / max(pixels, 1)
    dark, steep, bright, step = np.empty((4, 3, bins))
    quantiles = (dark_quantile, min(STEEPNESS_FACTOR * dark_quantile, 0.5), bright_quantile)
    _quantiles(
        histogram, table.edges, table.step, min_pixels, quantiles, count, dark, steep, bright,
        step,
    )
    shift = _noise_shift(left[:, np.newaxis] * step, steep - dark, quantiles)
    full = (count >= min_pixels) & (range_sum[:, 1] > 0)
    return Envelopes(
        range=range_sum[full, 0] / range_sum[full, 1],
        count=count[full],
        dark=(dark + shift)[:, full],
        bright=bright[:, full],
        step=step[:, full],
        deviation=np.sqrt(
            step**2 * (1 / 12 + (FIXED_PATTERN * code_8_bit)**2) + (0.5 * shift)**2)[:, full],
        noise=noise,
        pixels=pixels,
        saturated=histogram[:, :, -1].sum(axis=0) * share,
        zero=histogram[:, :, 0].sum(axis=0) * share,
        grey=pixels > 0 and not coloured,
    )


def _noise_shift(
    noise: NDArray[np.float64], rise: NDArray[np.float64], quantiles: tuple[float, float, float]
) -> NDArray[np.float64]:
    """How far noise moves the dark envelope below the darkest light.

    Where the dark end is as steep as noise alone makes it, the envelope lies
    at the noise's own quantile; where the scene itself makes a long tail, the
    noise moves it by less, in proportion to the steepness.
    """
    outer, inner = -ndtri(quantiles[0]), -ndtri(quantiles[1])
    steepness = np.minimum((outer - inner) * noise / np.maximum(rise, 1e-9), 1.0)
    return np.asarray(outer * noise * steepness)


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


@njit(nogil=True, cache=True)
def _accumulate(
    image: Any, range_map: Any, mask: Any, masked: bool, level_of: Any, low: float,
    bins_per_metre: float, tolerance: float, histogram: Any, range_sum: Any,
) -> bool:
    """Count levels by range bin and channel, in one pass; return whether any pixel has colour."""
    height, width = range_map.shape
    bins = histogram.shape[0]
    bin_of = np.empty(width, np.int32)
    coloured = False
    stride = max(1, round(height * width / MAX_PIXELS))
    for y in range(stride // 2, height, stride):
        _place_row(range_map, y, low, bins_per_metre, tolerance, bins, bin_of)
        for x in range(width):
            at = bin_of[x]
            if at < 0 or (masked and not mask[y, x]):
                continue
            red, green, blue = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            if (red | green | blue) == 0:
                continue
            coloured |= (red != green) | (green != blue)
            if x % RANGE_STRIDE == 0:
                range_sum[at, 0] += range_map[y, x]
                range_sum[at, 1] += 1
            counts = histogram[at]
            counts[0, level_of[red]] += 1
            counts[1, level_of[green]] += 1
            counts[2, level_of[blue]] += 1
    return coloured


@njit(nogil=True, cache=True)
def _place_row(
    range_map: Any, y: int, low: float, bins_per_metre: float, tolerance: float, bins: int,
    bin_of: Any,
) -> None:
    """Write the range bin of each pixel of a row, or -1: without branches, so it vectorises."""
    height, width = range_map.shape
    here = range_map[y]
    above = range_map[max(y - EDGE_DISTANCE, 0)]
    below = range_map[min(y + EDGE_DISTANCE, height - 1)]
    bin_of[:] = -1
    for x in range(EDGE_DISTANCE, width - EDGE_DISTANCE):
        distance = here[x]
        jump = tolerance * distance
        # Comparisons with an unknown neighbour are false: it is no edge.
        edge = (
            (abs(above[x] - distance) > jump)
            | (abs(below[x] - distance) > jump)
            | (abs(here[x - EDGE_DISTANCE] - distance) > jump)
            | (abs(here[x + EDGE_DISTANCE] - distance) > jump)
        )
        place = (distance - low) * bins_per_metre
        counts = (distance >= low) & (place < bins) & ~edge
        bin_of[x] = np.int32(place) if counts else np.int32(-1)


@njit(nogil=True, cache=True)
def _quantiles(
    histogram: Any, edges: Any, code_step: Any, min_pixels: int,
    quantiles: tuple[float, float, float], count: Any, dark: Any, steep: Any, bright: Any,
    step: Any,
) -> None:
    """Take the quantiles of each histogram, leaving out its saturated level."""
    bins, channels, number = histogram.shape
    for at in range(bins):
        for channel in range(channels):
            column = histogram[at, channel]
            total = count[at] - column[number - 1]
            if total < min_pixels:
                dark[channel, at] = np.nan
                steep[channel, at] = np.nan
                bright[channel, at] = np.nan
                step[channel, at] = np.nan
                continue
            level, inside = _find(column, max(quantiles[0] * total, 0.5))
            # Counts that fall smoothly towards darkness place the quantile
            # inside its level. At a sharp end the true darkest value may lie
            # anywhere in the level: its middle is right on average.
            before = column[level - 1] if level > 0 else 0
            smooth = min(1.0, 2.0 * before / column[level])
            inside = smooth * inside + (1.0 - smooth) * 0.5
            dark[channel, at] = edges[level] + inside * (edges[level + 1] - edges[level])
            step[channel, at] = code_step[level]
            level, inside = _find(column, max(quantiles[1] * total, 0.5))
            steep[channel, at] = edges[level] + inside * (edges[level + 1] - edges[level])
            level, inside = _find(column, quantiles[2] * total)
            # What is reached at least, since it bounds the ambient light.
            bright[channel, at] = edges[level]


@njit(nogil=True, cache=True)
def _find(column: Any, rank: float) -> tuple[int, float]:
    """Level at which the running count reaches a rank, and where inside it."""
    running = 0
    level = 0
    while running + column[level] < rank:
        running += column[level]
        level += 1
    return level, (rank - running) / column[level]
