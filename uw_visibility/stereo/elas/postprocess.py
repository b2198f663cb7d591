# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Post-processing of disparity: consistency, segments, gaps, occlusions."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.stereo.elas.dense import BORDER

# Largest difference of a gap's sides on one surface, px, and the factor on the width of gaps that
# are bridged there.
_ONE_SURFACE = np.float32(1.0)
_WIDER = 3
# Steps per pixel in which OpenCV compares disparities, and its value for unmatched pixels.
_STEPS, _OPEN = 16, -1
# Pixels that are nearer by more than this, px, hide others that fall on the same pixel of the right
# view. Pixels of a slanted surface also fall on one pixel, but differ by less.
_HIDES = np.float32(1.5)


def check(
    best: NDArray[np.int16], tolerance: int, disparity: DisparityMap, workers: Workers
) -> None:
    """Left/right check of the best disparities of both views, `best` (2, H, W), px.

    `disparity` (H, W) of the left view, at sub-pixel resolution, is set to NaN where the views
    differ by more than `tolerance`, px, in place. Where the disparity of the right view is too
    large to be tried at the left pixel, whose match is in the border, it replaces the left one.
    """
    workers.rows(_check, disparity.shape[0], best[0], best[1], tolerance, disparity)


def remove_segments(disparity: DisparityMap, size: int, difference: float) -> None:
    """Set segments of fewer than `size` pixels to NaN, in place.

    A segment is a set of pixels connected by neighbours (above, below, left or right) whose
    disparities differ by at most `difference`, px.
    """
    steps = np.rint(disparity * _STEPS)
    fixed = np.where(np.isfinite(steps), steps, _OPEN).astype(np.int16)
    cv2.filterSpeckles(fixed, _OPEN, size - 1, round(difference * _STEPS))
    disparity[fixed == _OPEN] = np.nan


def fill_small_gaps(
    disparity: DisparityMap, width: int, difference: float, workers: Workers
) -> None:
    """Bridge gaps of at most ``width`` pixels within rows, then within columns, in place.

    Where the two sides differ by at most ``difference`` px the gap is interpolated; at a depth edge
    it takes the farther side, like an occlusion. Gaps whose sides differ by at most `_ONE_SURFACE`
    may be `_WIDER` times as wide.
    """
    workers.rows(_fill_row_gaps, disparity.shape[0], disparity, width, np.float32(difference))
    transposed = disparity.T
    workers.rows(_fill_row_gaps, disparity.shape[1], transposed, width, np.float32(difference))


def remove_occluded(disparity: DisparityMap, workers: Workers) -> None:
    """Z-buffer test: set pixels that the right view does not show to NaN, in place.

    They are outside of it, or farther by more than `_HIDES` than another that falls on the same
    pixel of it. The test is made on the finished map, since gaps beside depth edges are filled, and
    edges moved, over occluded pixels.
    """
    workers.rows(_remove_occluded, disparity.shape[0], disparity)


@njit(nogil=True)
def _check(
    start: int, stop: int, best_left: Any, best_right: Any, tolerance: int, disparity: Any
) -> None:
    for y in range(start, stop):
        for x in range(best_left.shape[1]):
            d = np.int32(best_left[y, x])
            if d < 0 or abs(best_right[y, x - d] - d) > tolerance:
                disparity[y, x] = np.nan
            elif best_right[y, x - d] > x - BORDER:
                # The left one is only the largest that was tried.
                disparity[y, x] = best_right[y, x - d]


@njit(nogil=True)
def _fill_row_gaps(start: int, stop: int, disparity: Any, widest: int, difference: Any) -> None:
    width = disparity.shape[1]
    for y in range(start, stop):
        last = -1
        for x in range(width):
            d = disparity[y, x]
            if d != d:
                continue
            gap = x - last - 1
            if 0 < gap <= _WIDER * widest and last >= 0:
                before = disparity[y, last]
                step = d - before
                if abs(step) <= (difference if gap <= widest else _ONE_SURFACE):
                    for inside in range(last + 1, x):
                        share = np.float32(inside - last) / np.float32(gap + 1)
                        disparity[y, inside] = before + share * step
                elif gap <= widest:
                    for inside in range(last + 1, x):
                        disparity[y, inside] = min(before, d)
            last = x


@njit(nogil=True, error_model="numpy")
def _remove_occluded(start: int, stop: int, disparity: Any) -> None:
    width = disparity.shape[1]
    # Largest disparity at each column of the right view, after an entry for all outside of it.
    nearest = np.empty(width + 1, np.float32)
    over = np.empty(width, np.float32)
    column = np.empty(width, np.int32)
    for y in range(start, stop):
        row = disparity[y]
        columns_in_right(row, column)
        nearest[:] = 0
        for x in range(width):
            at = np.uint32(max(column[x] + 1, 0))
            if row[x] > nearest[at]:
                nearest[at] = row[x]
        for x in range(width):
            over[x] = nearest[np.uint32(max(column[x] + 1, 0))]
        _clear_hidden(over, column, row)


@njit(nogil=True, error_model="numpy")
def columns_in_right(row: Any, column: Any) -> None:
    """Write the column of the right view that each pixel matches, below 0 for none."""
    for x in range(row.size):
        d = row[x] if row[x] == row[x] else np.float32(x + 1)
        column[x] = np.int32(x) - index_of(d + np.float32(0.5), 0, x + 1)


@njit(nogil=True, error_model="numpy")
def _clear_hidden(nearest: Any, column: Any, row: Any) -> None:
    for x in range(row.size):
        hidden = (nearest[x] > row[x] + _HIDES) | (column[x] < 0)
        row[x] = np.float32(np.nan) if hidden else row[x]


def smooth(disparity: DisparityMap, radius: int, difference: float, workers: Workers) -> None:
    """Mean over neighbours of the same surface, in place: the last step of ELAS.

    A map (H, W) is smoothed over `radius` neighbours to each side, rows first, then columns; NaN
    stays NaN. A neighbour's weight falls linearly with the difference of the disparities and is
    zero from `difference`, px, on, so that depth edges stay.
    """
    if radius == 0:
        return
    height, between, limit = disparity.shape[0], np.empty_like(disparity), np.float32(difference)
    workers.rows(_smooth, height, disparity, radius, limit, True, between)
    workers.rows(_smooth, height, between, radius, limit, False, disparity)


@njit(nogil=True, error_model="numpy")
def _add_both(
    first: int, last: int, shift: int, here: Any, before: Any, after: Any, difference: Any,
    weights: Any, sums: Any,
) -> None:
    """Add the neighbours on both sides of each pixel of a row; NaN adds nothing."""
    for x in range(first, last):
        # Unsigned, since numba checks whether signed indices are negative.
        at = np.uint64(x)
        d = here[at]
        step = before[np.uint64(x - shift)] - d
        weight = _weight(step, difference)
        total = weights[at] + weight
        weighted = sums[at] + (weight * step if weight > 0 else np.float32(0))
        step = after[np.uint64(x + shift)] - d
        weight = _weight(step, difference)
        weights[at] = total + weight
        sums[at] = weighted + (weight * step if weight > 0 else np.float32(0))


@njit(nogil=True, error_model="numpy", inline="always")
def _weight(step: Any, difference: Any) -> Any:
    weight = difference - abs(step)
    return weight if weight > 0 else np.float32(0)


@njit(nogil=True, error_model="numpy")
def _smooth(
    start: int, stop: int, source: Any, radius: int, difference: Any, across: bool, target: Any
) -> None:
    """Average over the neighbours in the row, or else over those in the column."""
    height, width = source.shape
    weights = np.empty(width, np.float32)
    sums = np.empty(width, np.float32)
    for y in range(start, stop):
        weights[:] = 0
        sums[:] = 0
        row = source[y]
        # As far to both sides: at the image's border one side alone would bias the mean of a slope.
        reach = min(radius, (width - 1) // 2) if across else min(radius, y, height - 1 - y)
        for k in range(1, reach + 1):
            if across:
                _add_both(k, width - k, k, row, row, row, difference, weights, sums)
            else:
                _add_both(0, width, 0, row, source[y - k], source[y + k], difference, weights, sums)
        # The pixel itself adds to the weights only.
        for x in range(width):
            target[y, x] = row[x] + sums[x] / (weights[x] + difference)
