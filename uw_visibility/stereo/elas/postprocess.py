# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Post-processing of disparity: consistency, sub-pixel, small segments, small gaps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.elas.absolute_difference import BYTES, absolute_difference
from uw_visibility.stereo.elas.dense import BORDER


def check_and_refine(
    best: NDArray[np.int16],
    descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    tolerance: int,
    disparity: NDArray[np.float32],
    workers: Workers,
) -> None:
    """Left/right check and sub-pixel refinement.

    Parameters
    ----------
    best : ndarray
        ``(2, H, W)`` int16, disparities of the left and of the right view, -1
        where there is none.
    descriptors : tuple of ndarray
        Of the left and of the right view, ``(H * W * 16,)`` uint8.
    tolerance : int
        Largest difference of the two views' disparities, px.
    disparity : ndarray
        ``(H, W)`` float32, overwritten; NaN where the views disagree.
    workers : Workers
        Threads.
    """
    workers.rows(
        _check_and_refine, disparity.shape[0], best[0], best[1], descriptors[0], descriptors[1],
        tolerance, disparity,
    )


class SegmentFilter:
    """Removal of small segments, in memory that is allocated once.

    A segment is a set of pixels that are joined by neighbours (above, below,
    left or right) whose disparities differ by at most a threshold.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        pixels = shape[0] * shape[1]
        # The run of pixels of a row that each pixel belongs to, and of each run one that
        # came before it and belongs to the same segment, and its number of pixels.
        self._run = np.empty(shape, np.int32)
        self._parent = np.empty(pixels, np.int32)
        self._size = np.empty(pixels, np.int32)

    def remove(
        self, disparity: NDArray[np.float32], size: int, difference: float, workers: Workers
    ) -> None:
        """Set segments of fewer than ``size`` pixels to NaN, in place."""
        _join_runs(disparity, np.float32(difference), self._run, self._parent, self._size)
        workers.rows(
            _remove_small, disparity.shape[0], self._run, self._parent, self._size, size,
            disparity,
        )


def fill_small_gaps(
    disparity: NDArray[np.float32], width: int, difference: float, workers: Workers
) -> None:
    """Bridge gaps of at most ``width`` pixels within rows, then within columns, in place.

    Where the two sides differ by at most ``difference`` px the gap is
    interpolated; at a depth edge it takes the farther side, as an occlusion
    would.
    """
    workers.rows(_fill_row_gaps, disparity.shape[0], disparity, width, np.float32(difference))
    transposed = disparity.T
    workers.rows(_fill_row_gaps, disparity.shape[1], transposed, width, np.float32(difference))


@njit(nogil=True)
def _check_and_refine(
    start: int, stop: int, best_left: Any, best_right: Any, left: Any, right: Any,
    tolerance: int, disparity: Any,
) -> None:
    width = best_left.shape[1]
    for y in range(start, stop):
        for x in range(width):
            disparity[y, x] = np.nan
            d = np.int32(best_left[y, x])
            if d < 0 or abs(best_right[y, x - d] - d) > tolerance:
                continue
            offset = 0.0
            if BORDER < x - d < width - BORDER - 1:
                i = (y * width + x) * BYTES
                j = i - d * BYTES
                offset = meeting_of_lines(
                    absolute_difference(left, i, right, j + BYTES),
                    absolute_difference(left, i, right, j),
                    absolute_difference(left, i, right, j - BYTES),
                )
            disparity[y, x] = max(d + offset, 0.0)


@njit(nogil=True)
def meeting_of_lines(before: Any, at: Any, after: Any) -> float:
    """Offset of the minimum between three equidistant costs, within 0.5.

    It is where two lines of opposite slope through them meet: sums of absolute
    differences fall and rise linearly, so that a parabola draws disparities to whole
    pixels (Shimizu and Okutomi, ICCV 2001, doi:10.1109/ICCV.2001.937503).
    """
    slope = max(before, after) - at
    if slope <= 0:
        return 0.0
    return min(max(0.5 * (before - after) / slope, -0.5), 0.5)


@njit(nogil=True)
def _root(parent: Any, at: int) -> int:
    while parent[at] != at:
        parent[at] = parent[parent[at]]
        at = parent[at]
    return at


@njit(nogil=True)
def _join_runs(disparity: Any, difference: Any, run: Any, parent: Any, size: Any) -> None:
    """Find the runs of each row, and join those that touch in neighbouring rows."""
    height, width = disparity.shape
    count = 0
    for y in range(height):
        last, last_above = -1, -1
        for x in range(width):
            d = disparity[y, x]
            if d != d:
                run[y, x] = -1
                continue
            if x > 0 and abs(disparity[y, x - 1] - d) <= difference:
                here = run[y, x - 1]
            else:
                here = np.int32(count)
                parent[count] = count
                size[count] = 0
                count += 1
            run[y, x] = here
            size[here] += 1
            if y > 0 and abs(disparity[y - 1, x] - d) <= difference:
                above = run[y - 1, x]
                if here != last or above != last_above:
                    last, last_above = here, above
                    a, b = _root(parent, here), _root(parent, above)
                    # The earlier run becomes the root, so that roots do not depend on
                    # the order of the joins.
                    parent[max(a, b)] = min(a, b)
    for at in range(count):
        # Parents come first, so that theirs is a root by now.
        root = parent[parent[at]]
        parent[at] = root
        if root != at:
            size[root] += size[at]


@njit(nogil=True)
def _remove_small(
    start: int, stop: int, run: Any, parent: Any, size: Any, least: int, disparity: Any
) -> None:
    for y in range(start, stop):
        for x in range(disparity.shape[1]):
            if run[y, x] >= 0 and size[parent[run[y, x]]] < least:
                disparity[y, x] = np.nan


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
            if 0 < gap <= widest and last >= 0:
                before = disparity[y, last]
                if abs(before - d) <= difference:
                    value = np.float32(0.5) * (before + d)
                else:
                    value = min(before, d)
                for inside in range(last + 1, x):
                    disparity[y, inside] = value
            last = x
