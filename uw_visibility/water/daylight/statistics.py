# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of an image over range, from which the posterior is inferred.

The image is reduced to blocks of some 160 × 120. Blocks are binned by range; each bin and channel
has quantiles of irradiance, contrast, and the differences between halves of the image; each bin of
each tile of the image has a mean. Irradiance is relative to the channel's brightest, range
to the median range, so that neither exposure nor the unit of length matters.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.water.blocks import (
    FEWEST_BLOCKS,
    FEWEST_OF_BIN,
    Blocks,
    known_ranges,
    place_by_range,
)

BINS = 12
# Fewest blocks of half a bin that have statistics.
FEWEST_OF_HALF = 16
QUANTILES = np.array((0.003, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99))
# Quantiles that are compared between halves, by place in QUANTILES.
COMPARED = (2, 4)
# Left and right, top and bottom, middle and surroundings.
HALVES = 3
# Tiles along rows and columns of the image: within one, surfaces are more alike.
TILES_ACROSS = 4
TILES = TILES_ACROSS**2
# A tile's mean of so many blocks has half of the weight of one of many.
HALF_WEIGHT = 20.0
# What is added before a logarithm, relative to the brightest: about one 8-bit code value.
FLOOR = 0.004
# Quantile of a channel's irradiance that stands for its brightest, and the least it may be.
BRIGHTEST, LEAST_BRIGHTEST = 0.995, 0.002
# Blocks without range above all surfaces, in this smoothest part of the image, may be open water.
SMOOTHEST = 0.3
FEWEST_OF_WATER = 60
# Log odds that they are: a constant, and factors of ln raggedness of their lower edge and of their
# width. Unmatched ground has a ragged edge. Fitted by `python -m
# uw_visibility_lab.posterior.open_water POOL`.
WATER_ODDS = (-7.73, -2.09, 2.78)
# What is added to raggedness before the logarithm; part of the rows from which a column is open.
LEAST_RAGGED, LEAST_OPEN = 0.01, 0.05
# Local contrast beyond this is an edge of light and shade, not texture.
MOST_CONTRAST = 0.3
# Distance of the blocks between which contrast is taken a second time. Light scattered by a few
# degrees blurs what is finer than its spread, so fine contrast falls faster with range than coarse.
COARSE_STEP = 4
# Squared distance from the middle of an image, in heights and widths, of half of its area.
MIDDLE = 0.5 / math.pi
# Levels of ln (irradiance + FLOOR): from black to four times the brightest.
LEVELS = 768
LOWEST = math.log(FLOOR)
PER_LEVEL = LEVELS / (math.log(4.0) - LOWEST)
# Places of a bin's statistics: after the quantiles, contrast between neighbours, between blocks
# COARSE_STEP apart, and within a tile; then the halves; last, whether there are any.
LOCAL = len(QUANTILES)
COARSE = LOCAL + 1
WITHIN_TILE = LOCAL + 2
BETWEEN_HALVES = LOCAL + 3
OF_BIN = BETWEEN_HALVES + len(COMPARED) * HALVES + 1
OF_CHANNEL = 13
# Places in `Statistics.of_channels`: open water's light, its scatter, its probability; noise;
# contrast; colour and level of the brightest; parts of the pixels that are clipped, and 0; optical
# thickness of clear water; open water's light above, near the scene, and its contrast.
(WATER, WATER_SCATTER, IS_WATER, NOISE, CONTRAST, COLOUR, BRIGHTNESS, CLIPPED, ZEROS, CLEAR,
 UPPER_WATER, LOWER_WATER, WATER_CONTRAST) = range(OF_CHANNEL)
# Mean rows of the upper and lower half of open water, by place in `Statistics.of_image`.
UPPER_ROW, LOWER_ROW = 6, 7
# Places in `Statistics.of_tiles`, after the channels: weight and mean row.
WEIGHT, ROW = 3, 4
# Places in `Statistics.of_image`, after its scalars: of bins, ln range over the median, ln count
# over the mean, and mean row, -0.5 above to 0.5 below.
SCALARS = 13
RANGES = slice(SCALARS, SCALARS + BINS)
ROWS = slice(SCALARS + 2 * BINS, SCALARS + 3 * BINS)
OF_IMAGE = SCALARS + 3 * BINS


class Statistics(NamedTuple):
    """Statistics of one image."""

    # (3, BINS, OF_BIN), for each channel and bin: logarithms of the quantiles of irradiance, of
    # contrast between neighbours, over COARSE_STEP and within tiles; differences between halves;
    # whether the bin has statistics
    of_bins: NDArray[np.float32]
    # (5, TILES, BINS), mean irradiance of each channel by tile and bin; its weight, 0..1; mean
    # row, -0.5 above to 0.5 below
    of_tiles: NDArray[np.float32]
    # (3, OF_CHANNEL), open water, noise, brightness, clipped parts, and ln of clear water's
    # optical thickness
    of_channels: NDArray[np.float32]
    # (OF_IMAGE,), median range, known part, range error, open water, ranges, counts and rows of
    # bins
    of_image: NDArray[np.float32]
    brightest: Array  # (3,), irradiance that the quantiles are relative to
    median_range: float  # m


class Appearance(NamedTuple):
    """Parts of the statistics that do not depend on the ranges."""

    counted: Mask  # (h, w), blocks that count
    brightest: Array  # (3,), irradiance that stands for the brightest of a channel
    relative: NDArray[np.float32]  # (3, h, w), irradiance over the brightest
    logarithm: Array  # (3, h, w), ln of that and FLOOR
    # (3, h, w), half the second difference between neighbours along rows; NaN at the ends
    contrast: NDArray[np.float32]
    texture: NDArray[np.float32]  # (3,), ln of the median contrast
    smooth: Mask  # (h, w), blocks of the smoothest part


def appearance_of(light: NDArray[np.float32]) -> Appearance:
    """Appearance of blocks of irradiance, (h, w, 3), of which one at least counts."""
    counted = np.isfinite(light[..., 0])
    planes = np.ascontiguousarray(np.moveaxis(light, 2, 0))
    # Selecting by a mask of two axes takes six times as long.
    known = np.compress(counted.ravel(), planes.reshape(3, -1), axis=1)
    brightest: Array = np.maximum(np.quantile(known, BRIGHTEST, axis=1), LEAST_BRIGHTEST)
    relative = (planes / brightest[:, np.newaxis, np.newaxis]).astype(np.float32)
    contrast = np.full_like(relative, np.nan)
    contrast[..., 1:-1] = np.abs(
        relative[..., 1:-1] - 0.5 * (relative[..., :-2] + relative[..., 2:]))
    mean = contrast.mean(axis=0)
    there = mean[np.isfinite(mean)]
    with np.errstate(invalid="ignore"):
        smooth = mean <= (np.quantile(there, SMOOTHEST) if len(there) else 0.0)
    texture = np.array([np.median(each[np.isfinite(each)]) for each in contrast])
    return Appearance(
        counted, brightest, relative, np.log(np.add(relative, FLOOR, dtype=np.float64)), contrast,
        np.log(texture + FLOOR / 4), smooth)


def summarise(
    blocks: Blocks, range_error: float, clear_water: Array,
    appearance: Callable[[], Appearance] | None = None,
) -> Statistics | None:
    """Summarise an image and its ranges; None where too few ranges are known.

    `range_error` is the standard deviation of range over its square, 1/m, `clear_water` κ, (3,),
    1/m; `appearance` returns `appearance_of` the blocks' light, if computed before.
    """
    near, order = known_ranges(blocks)
    if len(order) < FEWEST_BLOCKS:
        return None
    counted, brightest, relative, logarithm, contrast, texture, smooth = (
        appearance() if appearance else appearance_of(blocks.light))
    middle = len(order) // 2
    median = float(order[[len(order) - 1 - middle, middle]].astype(np.float64).mean())
    place, mean_range, count, _ = place_by_range(blocks.range, near, order, BINS)
    of_bins = np.zeros((3, BINS, OF_BIN), np.float32)
    _summarise_bins(logarithm, contrast, place, QUANTILES, QUANTILES[list(COMPARED)], of_bins)
    of_tile, means, rows = np.zeros((TILES, BINS)), np.zeros((4, TILES, BINS)), np.zeros(BINS)
    off, number, coarse = np.zeros((3, 3, BINS))
    _sum_up(relative, place, of_tile, means, off, rows, number, coarse)
    of_bins[..., WITHIN_TILE] = np.log(np.sqrt(off / np.maximum(count, 1.0)) + 0.5 * FLOOR)
    level = np.log(np.sqrt(coarse / np.maximum(number, 1.0)) + 0.5 * FLOOR)
    # A bin with few contrasts has that of its neighbours.
    for c, many in enumerate(number >= FEWEST_OF_BIN):
        of_bins[c, :, COARSE] = level[c] if not many.any() else np.interp(
            np.arange(BINS), np.flatnonzero(many), level[c, many])
    of_tiles = np.stack((*means[:3], of_tile / (of_tile + HALF_WEIGHT), means[3]))
    water, ragged, width = open_water(blocks.range, counted, smooth)
    of_channels = np.zeros((3, OF_CHANNEL), np.float32)
    seen_water = int(water.sum())
    upper_row, lower_row = 0.0, 0.0
    if seen_water >= FEWEST_OF_WATER:
        # By rows: the first half is nearer the zenith, the second nearer the far surfaces.
        shown = np.ascontiguousarray(relative[:, water].T)
        half = seen_water // 2
        of_channels[:, UPPER_WATER] = np.log(np.median(shown[:half], axis=0) + FLOOR)
        of_channels[:, LOWER_WATER] = np.log(np.median(shown[half:], axis=0) + FLOOR)
        of_channels[:, WATER] = np.log(np.median(shown, axis=0) + FLOOR)
        of_channels[:, WATER_SCATTER] = np.log(shown.std(axis=0) + FLOOR)
        of_channels[:, IS_WATER] = expit(np.dot(WATER_ODDS, (1.0, ragged, width)))
        steps = np.ascontiguousarray(contrast[:, water].T)
        of_channels[:, WATER_CONTRAST] = np.log(np.sqrt(np.nanmean(steps**2, axis=0)) + 0.5 * FLOOR)
        at = np.nonzero(water)[0] / len(water) - 0.5
        upper_row, lower_row = float(at[:half].mean()), float(at[half:].mean())
    of_channels[:, NOISE] = np.log(blocks.noise / brightest + FLOOR / 4)
    of_channels[:, CONTRAST] = texture
    of_channels[:, COLOUR] = np.log(brightest / brightest.mean())
    of_channels[:, BRIGHTNESS] = np.log(brightest)
    of_channels[:, CLIPPED] = blocks.clipped
    of_channels[:, ZEROS] = blocks.black
    of_channels[:, CLEAR] = np.log(clear_water * median)
    of_image = np.concatenate((
        (math.log(median), blocks.known, float(near.mean()),
         math.log(range_error * median + 1e-3), float(seen_water / counted.sum()),
         float(seen_water >= FEWEST_OF_WATER), upper_row, lower_row, float(blocks.encoded),
         float(blocks.deep), float(counted.mean()), ragged, width),
        np.log(mean_range / median), np.log1p(count) - math.log1p(len(order) / BINS),
        rows / np.maximum(count, 1.0)))
    return Statistics(
        of_bins, of_tiles.astype(np.float32), of_channels, of_image.astype(np.float32), brightest,
        median)


def open_water(
    ranges: NDArray[np.float32], counted: Mask, smooth: Mask
) -> tuple[Mask, float, float]:
    """Blocks that may be open water, ln of how ragged their lower edge is, and their width.

    `smooth` are the blocks of the smoothest part. Width is the part of the columns that are open.
    """
    unknown = np.isnan(ranges)
    # A single block with a range is a false match in open water, or a fish.
    surface = cv2.morphologyEx(
        (~unknown).astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    above = (np.maximum.accumulate(surface, axis=0) == 0) & counted
    depth = above.mean(axis=0)
    ragged = np.abs(np.diff(depth)).mean() / max(depth.mean(), 2.0 * LEAST_RAGGED)
    return (
        above & unknown & smooth, math.log(ragged + LEAST_RAGGED),
        float((depth > LEAST_OPEN).mean()))


@njit(nogil=True)
def _summarise_bins(
    logarithm: Any, contrast: Any, place: Any, quantiles: Any, compared: Any, of_bins: Any
) -> None:
    """Fill the statistics of bins, from histograms of ln (irradiance + FLOOR)."""
    height, width = place.shape
    # Of a whole bin, then of its part in the first half of each split.
    levels = np.zeros((BINS, 3, 1 + HALVES, LEVELS), np.int32)
    energy, steps = np.zeros((BINS, 3)), np.zeros((BINS, 3), np.int64)
    for y in range(height):
        v = (y + 0.5) / height - 0.5
        for x in range(width):
            if place[y, x] < 0:
                continue
            i = index_of(place[y, x], 0, BINS - 1)
            u = (x + 0.5) / width - 0.5
            middle = u * u + v * v < MIDDLE
            for c in range(3):
                level = index_of((logarithm[c, y, x] - LOWEST) * PER_LEVEL, 0, LEVELS - 1)
                counts = levels[i, c]
                counts[0, level] += 1
                counts[1, level] += u < 0.0
                counts[2, level] += v < 0.0
                counts[3, level] += middle
                step = contrast[c, y, x]
                if step < MOST_CONTRAST:
                    energy[i, c] += step * step
                    steps[i, c] += 1
    other = np.empty(LEVELS, np.int32)
    of_one, of_other = np.empty(len(COMPARED)), np.empty(len(COMPARED))
    for i in range(BINS):
        for c in range(3):
            whole = levels[i, c, 0]
            total = whole.sum()
            if total < FEWEST_OF_BIN:
                continue
            row = of_bins[c, i]
            _quantiles(whole, total, quantiles, row)
            row[LOCAL] = np.log(np.sqrt(energy[i, c] / max(steps[i, c], 1)) + 0.5 * FLOOR)
            for half in range(HALVES):
                one = levels[i, c, 1 + half]
                inside = one.sum()
                if min(inside, total - inside) < FEWEST_OF_HALF:
                    continue
                for level in range(LEVELS):
                    other[level] = whole[level] - one[level]
                _quantiles(one, inside, compared, of_one)
                _quantiles(other, total - inside, compared, of_other)
                for j in range(len(COMPARED)):
                    row[BETWEEN_HALVES + half * len(COMPARED) + j] = of_one[j] - of_other[j]
            row[OF_BIN - 1] = 1.0


@njit(nogil=True)
def _sum_up(
    relative: Any, place: Any, count: Any, means: Any, off: Any, rows: Any, number: Any,
    coarse: Any,
) -> None:
    """Sum up numbers and means of tiles; by bin, squared deviations from these, and rows.

    Also the number and squares of contrasts between blocks COARSE_STEP apart along rows, of blocks
    at most one bin apart, by channel and bin.
    """
    height, width = place.shape
    half, most = np.float32(0.5), np.float32(MOST_CONTRAST)
    for means_are_known in (False, True):
        for y in range(height):
            row = y / height - 0.5
            for x in range(width):
                if place[y, x] < 0:
                    continue
                i = index_of(place[y, x], 0, BINS - 1)
                at = y * TILES_ACROSS // height * TILES_ACROSS + x * TILES_ACROSS // width
                if not means_are_known:
                    count[at, i] += 1.0
                    rows[i] += row
                    for c in range(4):
                        means[c, at, i] += relative[c, y, x] if c < 3 else row
                    continue
                before, after = x - COARSE_STEP, x + COARSE_STEP
                alike = before >= 0 and after < width and (
                    min(place[y, before], place[y, after]) >= max(i - 1, 0)
                    and max(place[y, before], place[y, after]) <= i + 1)
                for c in range(3):
                    off[c, i] += (relative[c, y, x] - means[c, at, i]) ** 2
                    if alike:
                        step = abs(relative[c, y, x] - half * (
                            relative[c, y, before] + relative[c, y, after]))
                        if step < most:
                            number[c, i] += 1.0
                            coarse[c, i] += step * step
        if not means_are_known:
            means /= np.maximum(count, 1.0)


@njit(nogil=True)
def _quantiles(counts: Any, total: int, quantiles: Any, found: Any) -> None:
    """Rising quantiles of a histogram, by linear interpolation inside their levels."""
    running, level = 0, 0
    for q in range(len(quantiles)):
        rank = quantiles[q] * total
        while level < LEVELS and not (counts[level] > 0 and running + counts[level] >= rank):
            running += counts[level]
            level += 1
        within = (rank - running) / counts[level] if level < LEVELS else 0.0
        found[q] = LOWEST + (level + within) / PER_LEVEL
