# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dark and bright envelopes of an image over range (eq. 4-5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array
from uw_visibility.optics.transfer import linear_table
from uw_visibility.water.blocks import FEWEST_OF_BIN, Blocks, known_ranges, place_by_range

# Largest and least number of bins; on average one has twice the fewest blocks of a bin.
BINS = 32
FEWEST_BINS = 6
# The dark envelope is the third darkest block of a bin: two may have a wrong range. The paper
# takes 1 % of the pixels (eq. 4).
DARKEST = 3
BRIGHT_QUANTILE = 0.99
BRIGHT_BINS = 3
# Quantile that shows how steep the dark end of a bin is, beside the envelope.
STEEPNESS_QUANTILE = 0.1
# Errors of calibration and fixed pattern, which averages do not reduce, in 8-bit code values.
FIXED_PATTERN = 0.5


@dataclass(frozen=True)
class Envelopes:
    """Dark and bright envelope of each channel over range.

    Attributes
    ----------
    range : (N,) float64 ndarray
        Mean range of the blocks in each bin, m, rising.
    count : (N,) int64 ndarray
        Blocks in each bin.
    dark, bright : (3, N) float64 ndarray
        Irradiance of the dark and of the bright envelope.
    dark_range : (3, N) float64 ndarray
        Mean range of the blocks that make up the dark envelope, m.
    step : (3, N) float64 ndarray
        Irradiance that one code value of the camera's spans at the dark envelope.
    deviation : (3, N) float64 ndarray
        Standard deviation of the dark envelope from rounding and noise.
    saturated, zero : (3,) float64 ndarray
        Fraction of the image's pixels at the largest code value, and at 0.
    grey : bool
        Whether all blocks are grey.
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
    saturated: Array
    zero: Array
    grey: bool
    limits: tuple[float, float] = (0.0, 0.0)
    range_error: float = 0.0

    def least_light(self, channel: int) -> float:
        """Lower bound of the light: the third brightest bin of the bright envelope (eq. 7).

        One or two bins may hold an animal's reflection, or wrong ranges.
        """
        ordered = np.sort(self.bright[channel])
        return float(ordered[-min(BRIGHT_BINS, len(ordered))])

    def brightest_near(self, channel: int) -> tuple[float, float]:
        """Irradiance and range, m, of the brightest patch in the nearest quarter of the bins."""
        near = self.bright[channel, :-(-len(self.range) // 4)]
        at = int(near.argmax())
        return float(near[at]), float(self.range[at])


def observe(blocks: Blocks, range_error: float = 0.0) -> Envelopes:
    """Bin blocks by range and take the envelopes of each bin and channel (eq. 4-5).

    `range_error` is the standard deviation of range over its square, 1/m; 0 for exact ranges. There
    may be no bin.
    """
    near, order = known_ranges(blocks)
    counted = np.isfinite(blocks.light[..., 0])
    red, green, blue = np.moveaxis(blocks.light, 2, 0)
    # NaN, where a block does not count, equals nothing.
    grey = bool(counted.any()) and np.array_equal((red == green) & (green == blue), counted)
    if len(order) == 0:
        nothing = np.empty((3, 0))
        return Envelopes(
            np.empty(0), np.empty(0, np.int64), *(nothing,) * 5, blocks.clipped, blocks.black,
            grey, range_error=range_error)
    number = min(max(len(order) // (2 * FEWEST_OF_BIN), FEWEST_BINS), BINS)
    place, mean_range, count, limits = place_by_range(blocks.range, near, order, number)
    full = np.flatnonzero(count >= FEWEST_OF_BIN)
    ends = np.cumsum(count).astype(np.int64)
    inner = np.maximum(np.rint(STEEPNESS_QUANTILE * count).astype(int), DARKEST + 1)
    light = np.empty((3, ends[-1]), np.float32)
    darkest = np.full((2, 3, number, DARKEST), np.inf, np.float32)
    starts = ends - count.astype(np.int64)
    _sort_into_bins(blocks.light, blocks.range, place, starts.copy(), light, *darkest)
    ranks = starts + np.stack((inner - 1, (BRIGHT_QUANTILE * (count - 1)).astype(int)))
    for at in full:
        light[:, starts[at]:ends[at]].sort(axis=1)
    steep, bright = light[:, ranks[:, full]].astype(np.float64).swapaxes(0, 1)
    dark = darkest[0][:, full, -1].astype(np.float64)
    table = linear_table(
        "srgb" if blocks.encoded else "linear", np.uint16 if blocks.deep else np.uint8
    ).astype(np.float64)
    scale = _slope(table, dark)
    # Noise as a part of full scale.
    of_codes = blocks.noise / _slope(table, table[len(table) // 2])
    noise = scale * (of_codes / blocks.size)[:, np.newaxis]
    quantiles = np.array((np.full(len(full), DARKEST), inner[full])) / (count[full] + 1.0)
    dark = dark + _noise_shift(noise, steep - dark, quantiles)
    return Envelopes(
        mean_range[full], count[full].astype(np.int64), dark,
        darkest[1][:, full].mean(axis=2).astype(np.float64), bright, scale * blocks.step,
        np.hypot(scale * FIXED_PATTERN / 255.0, noise), blocks.clipped, blocks.black, grey, limits,
        range_error)


@njit(nogil=True)
def _sort_into_bins(
    light: Any, ranges: Any, place: Any, next_of: Any, ordered: Any, darkest: Any, of_darkest: Any
) -> None:
    """Sort irradiance by channel and bin; find the darkest blocks, with their range.

    `next_of` is the start of each bin, and is changed. Of equals, upper and left ones are darker.
    """
    for y in range(place.shape[0]):
        for x in range(place.shape[1]):
            if place[y, x] < 0:
                continue
            i = index_of(place[y, x], 0, len(next_of) - 1)
            for c in range(3):
                value = light[y, x, c]
                ordered[c, next_of[i]] = value
                k = DARKEST - 1
                if not value < darkest[c, i, k]:
                    continue
                while k > 0 and value < darkest[c, i, k - 1]:
                    darkest[c, i, k] = darkest[c, i, k - 1]
                    of_darkest[c, i, k] = of_darkest[c, i, k - 1]
                    k -= 1
                darkest[c, i, k] = value
                of_darkest[c, i, k] = ranges[y, x]
            next_of[i] += 1


def _slope(table: Array, irradiance: Array) -> Array:
    """Irradiance over code values, as parts of full scale, at an irradiance."""
    above = np.clip(np.searchsorted(table, irradiance), 1, len(table) - 1)
    return np.asarray((table[above] - table[above - 1]) * (len(table) - 1))


def _noise_shift(noise: Array, rise: Array, quantiles: Array) -> Array:
    """Bias of the dark envelope by noise.

    If noise alone makes the dark end, the envelope is a quantile of the noise. If the scene has a
    long dark tail, the bias is smaller, in proportion to the steepness.
    """
    outer, inner = -ndtri(quantiles)
    steepness = np.minimum((outer - inner) * noise / np.maximum(rise, 1e-9), 1.0)
    return np.asarray(outer * noise * steepness)
