# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Statistics of smooth surfaces over range, in one pass: local contrast, levels by region."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask

# Pixels that are read.
PIXELS_READ = 45_000
# Bins of equal ratio, and how many of them contrast and regions take together.
BINS = 48
CONTRAST_GROUP = 2
REGION_GROUP = 3
# Neighbours that are compared are so many parts of the image's width away, px at least.
DISTANCE_PART = 160
DISTANCE_LEAST = 2
# Neighbours of one surface: their ranges differ by less than this part.
SAME_SURFACE = 0.04
# Left or right, upper or lower, middle or surroundings: a bit each.
REGIONS = 8
# Of the pixels that are read, one in so many rows and columns tells where those of a range lie.
SPARSE = 4
# Levels of the square root of irradiance.
LEVELS = 128
# Columns of `SurfaceStatistics.contrast`.
DIFFERENCE, STEP, RANGE, COUNT = slice(0, 3), slice(3, 6), 6, 7
COLUMNS = 8


class SurfaceStatistics(NamedTuple):
    """Sums over the pixels whose neighbours are of one surface with them.

    Attributes
    ----------
    contrast : (N, 8) float64 ndarray
        For each bin of range, over unsaturated pixels: sum of the squared difference of
        irradiance to the neighbours' mean and of the squared step of a code, both of
        three channels; sum of ranges, m; pixels.
    levels : (M, 8, 3, 128) int32 ndarray
        For each bin of range, region and channel: pixels of each level.
    edges : (129,) float64 ndarray
        Irradiance where each level begins, and the last ends.
    places : (M, 8, 4) float64 ndarray
        For each of these bins and regions: sum of ranges, m; pixels; sums of rows and
        columns in parts of the image. Upper and lower regions are those of the bin's own
        pixels: of ground ahead, all that is at one range is in one half of the image.
    """

    contrast: Array
    levels: NDArray[np.int32]
    edges: Array
    places: Array


def surface_statistics(
    image: NDArray[Any], range_map: NDArray[np.float32], mask: Mask,
    irradiance: NDArray[np.float32], limits: tuple[float, float],
) -> SurfaceStatistics:
    """Sum up local contrast and levels over range.

    `mask` is (1, 1) for all pixels, `irradiance` that of each code value, `limits` the least and
    the largest range, m.
    """
    low, high = limits
    top = float(irradiance[-1])
    sums = np.zeros((BINS // CONTRAST_GROUP, COLUMNS))
    levels = np.zeros((BINS // REGION_GROUP, REGIONS, 3, LEVELS), np.int32)
    places = np.zeros((BINS // REGION_GROUP, REGIONS, 4))
    if high > low > 0:
        bins_per_log = np.float32(BINS / math.log(high / low))
        stride = max(1, round(math.sqrt(range_map.size / PIXELS_READ)))
        pixels = _Pixels(
            image, range_map, mask, irradiance,
            (np.sqrt(irradiance / top) * (LEVELS - 1)).astype(np.uint8))
        sampling = _Sampling(
            np.float32(low), bins_per_log,
            max(DISTANCE_LEAST, round(range_map.shape[1] / DISTANCE_PART)), stride)
        rows = _mean_rows(range_map, np.float32(low), bins_per_log, SPARSE * stride)
        _accumulate(pixels, sampling, rows, sums, levels, places)
    edges = top * (np.arange(LEVELS + 1) / (LEVELS - 1)) ** 2
    places[:, :, 2:] /= range_map.shape
    return SurfaceStatistics(sums, levels, edges, places)


class _Pixels(NamedTuple):
    """Pixels, their ranges, and irradiance and level of each code value."""

    image: NDArray[Any]
    range_map: NDArray[np.float32]
    mask: Mask
    irradiance: NDArray[np.float32]
    level_of: NDArray[np.uint8]


class _Sampling(NamedTuple):
    """Least range (m), bins of range, distance of neighbours and of the pixels read (px)."""

    low: np.float32
    bins_per_log: np.float32
    distance: int
    stride: int


@njit(nogil=True)
def _mean_rows(range_map: Any, low: float, bins_per_log: float, stride: int) -> Any:
    """Mean row of the pixels of each bin of `SurfaceStatistics.levels`."""
    rows = np.zeros(BINS // REGION_GROUP)
    count = np.zeros(BINS // REGION_GROUP)
    for y in range(stride // 2, range_map.shape[0], stride):
        for x in range(stride // 2, range_map.shape[1], stride):
            here = range_map[y, x]
            # Comparisons with NaN are false.
            if here >= low and here < np.inf:
                at = index_of(math.log(here / low) * bins_per_log, 0, BINS)
                if at < BINS:
                    rows[at // REGION_GROUP] += y
                    count[at // REGION_GROUP] += 1
    return rows / np.maximum(count, 1.0)


@njit(nogil=True)
def _accumulate(
    pixels: Any, sampling: Any, mean_rows: Any, sums: Any, levels: Any, places: Any
) -> None:
    """Fill the sums of `SurfaceStatistics`."""
    image, range_map, mask, irradiance, level_of = pixels
    low, bins_per_log, distance, stride = sampling
    height, width = range_map.shape
    masked = mask.size > 1
    top = irradiance.size - 1
    middle_y, middle_x = 0.5 * height, 0.5 * width
    # Half of the image is farther from its middle.
    ring = 0.5 * (middle_y**2 + middle_x**2) * 0.66
    for y in range(distance, height - distance, stride):
        above, below = y - distance, y + distance
        for x in range(distance, width - distance, stride):
            here = range_map[y, x]
            limit = np.float32(SAME_SURFACE) * here
            before, after = x - distance, x + distance
            # Comparisons with NaN are false.
            if not (
                here >= low
                and abs(range_map[above, x] - here) <= limit
                and abs(range_map[below, x] - here) <= limit
                and abs(range_map[y, before] - here) <= limit
                and abs(range_map[y, after] - here) <= limit
            ) or (masked and not mask[y, x]):
                continue
            at = index_of(math.log(here / low) * bins_per_log, 0, BINS)
            if at >= BINS:
                continue
            region = 0
            if x >= middle_x:
                region += 1
            if y >= mean_rows[at // REGION_GROUP]:
                region += 2
            if (y - middle_y) ** 2 + (x - middle_x) ** 2 >= ring:
                region += 4
            clipped = False
            for c in range(3):
                levels[at // REGION_GROUP, region, c, level_of[image[y, x, c]]] += 1
                clipped |= image[y, x, c] >= top
            place = places[at // REGION_GROUP, region]
            place[0] += here
            place[1] += 1
            place[2] += y
            place[3] += x
            if clipped:
                continue
            row = sums[at // CONTRAST_GROUP]
            for c in range(3):
                code = image[y, x, c]
                light = irradiance[code]
                difference = light - np.float32(0.25) * (
                    irradiance[image[above, x, c]] + irradiance[image[below, x, c]]
                    + irradiance[image[y, before, c]] + irradiance[image[y, after, c]])
                row[c] += difference * difference
                step = irradiance[code + 1] - light
                row[3 + c] += step * step
            row[RANGE] += here
            row[COUNT] += 1
