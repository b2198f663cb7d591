# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Disparity interpolation: gaps (Hirschmüller 2008), then large areas by inpainting (section II-E).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.images.cells import fold, spread

# Directions that one sweep over the rows looks in; along a row there are two more.
DIRECTIONS = 3
# How far (px) a disparity of the right map may miss a pixel of the left one and
# still count as lying on it.
TOLERANCE = 1


class GapFiller:
    """Discontinuity-preserving gap filling (Hirschmüller 2008, section 2.6.3).

    doi 10.1109/TPAMI.2007.1166. Holds its buffers: one call at a time. `max_gap` is how far a
    pixel looks for disparities, px.
    """

    def __init__(self, shape: tuple[int, int], max_gap: int, workers: Workers) -> None:
        self.shape = shape
        self._max_gap = max_gap
        self._workers = workers
        self._seen = np.empty((2, DIRECTIONS, *shape), np.float32)

    def fill(self, left: NDArray[np.float32], right: NDArray[np.float32]) -> NDArray[np.float32]:
        """Fill gaps from the eight directions around each pixel.

        An occluded pixel takes the second lowest of what it sees, so it
        belongs to the background; a mismatched one takes their median, so a
        hole in the foreground stays foreground.

        left: (H, W) float32, left disparity map, px; NaN = a gap.
        right: (H, W) float32, right disparity map **before** the left/right check, positive px, NaN
            = unknown. Where none of its disparities points at a pixel, that pixel is occluded.
        Returns (H, W) float32, a new map; NaN stays where fewer than three directions meet a
        disparity within `max_gap`.
        """
        if left.shape != self.shape or right.shape != self.shape:
            raise InputError(f"disparity maps are not of the shape {self.shape} expected")
        self._workers.rows(_sweep, 2, left, self._max_gap, self._seen)
        filled = np.empty_like(left)
        self._workers.rows(_choose, left.shape[0], left, right, self._max_gap, self._seen, filled)
        return filled


@njit(nogil=True, error_model="numpy")
def _sweep(start: int, stop: int, disparity: Any, max_gap: int, seen: Any) -> None:
    """Carry the last disparity met along three directions over the map.

    Sweep 0 goes down and looks up-left, up and up-right; sweep 1 goes up and
    looks the other way; inf where they meet none. Whole rows at a time, since
    that makes vector code.
    """
    height, width = disparity.shape
    nothing = np.float32(np.inf)
    limit = np.int32(max_gap)
    for sweep in range(start, stop):
        # A column more on either side, so that leaning directions end there.
        value = np.full((2, DIRECTIONS, width + 2), nothing, np.float32)
        age = np.zeros((2, DIRECTIONS, width + 2), np.int32)
        for row in range(height):
            y = row if sweep == 0 else height - 1 - row
            here = disparity[y]
            for k in range(DIRECTIONS):
                old_value = value[1 - row % 2, k, k:]
                old_age = age[1 - row % 2, k, k:]
                new_value = value[row % 2, k, 1:]
                new_age = age[row % 2, k, 1:]
                out = seen[sweep, k, y]
                for x in range(width):
                    d = here[x]
                    a = old_age[x] + np.int32(1)
                    v = old_value[x] if a <= limit else nothing
                    new_value[x] = v if d != d else d
                    new_age[x] = a if d != d else np.int32(0)
                    out[x] = v


@njit(nogil=True, error_model="numpy")
def _find_gaps(here: Any, columns: Any) -> int:
    """Write the columns of a row's gaps; return how many there are."""
    count = 0
    for x in range(here.size):
        # Written in any case, since a branch costs more.
        columns[count] = x
        count += here[x] != here[x]
    return count


@njit(nogil=True, error_model="numpy")
def _look_along(here: Any, columns: Any, max_gap: int, before: Any, after: Any) -> None:
    """Write what is on either side of each gap of a row; inf = nothing within `max_gap`."""
    count = columns.size
    nothing = np.float32(np.inf)
    known = -1
    for i in range(count):
        x = columns[i]
        if i == 0 or columns[i - 1] != x - 1:
            known = x - 1
        before[i] = here[known] if known >= 0 and x - known <= max_gap else nothing
    for i in range(count - 1, -1, -1):
        x = columns[i]
        if i == count - 1 or columns[i + 1] != x + 1:
            known = x + 1
        after[i] = here[known] if known < here.size and known - x <= max_gap else nothing


@njit(nogil=True, error_model="numpy")
def _point_at(right: Any, hit: Any) -> None:
    """Mark the pixels of a row that a disparity of the right row points at, within `TOLERANCE`.

    ``hit`` reaches twice as many columns beyond the row on either side.
    """
    width = right.size
    hit[:] = False
    for q in range(width):
        d = right[q]
        # Comparisons with NaN are false.
        if d >= 0 and d <= width:
            x = q + index_of(d + np.float32(0.5), 0, width)
            if x < width + TOLERANCE:
                for near in range(x + TOLERANCE, x + 3 * TOLERANCE + 1):
                    hit[near] = True


@njit(nogil=True, error_model="numpy", inline="always")
def _order(a: Any, b: Any) -> tuple[Any, Any]:
    return (a, b) if a < b else (b, a)


@njit(nogil=True, error_model="numpy")
def _choose_of_eight(around: Any, hit: Any, chosen: Any) -> None:
    """Choose for each of N gaps from the (8, N) disparities around it; inf = none.

    The eight are sorted with Batcher's network (doi 10.1145/1468075.1468121),
    which has no branches, so many pixels are sorted at once.
    """
    v0, v1, v2, v3 = around[0], around[1], around[2], around[3]
    v4, v5, v6, v7 = around[4], around[5], around[6], around[7]
    most = np.float32(np.inf)
    nothing = np.float32(np.nan)
    for x in range(chosen.size):
        a, b = _order(v0[x], v1[x])
        c, d = _order(v2[x], v3[x])
        e, f = _order(v4[x], v5[x])
        g, h = _order(v6[x], v7[x])
        a, c = _order(a, c)
        b, d = _order(b, d)
        e, g = _order(e, g)
        f, h = _order(f, h)
        b, c = _order(b, c)
        f, g = _order(f, g)
        a, e = _order(a, e)
        b, f = _order(b, f)
        c, g = _order(c, g)
        d, h = _order(d, h)
        c, e = _order(c, e)
        d, f = _order(d, f)
        b, c = _order(b, c)
        d, e = _order(d, e)
        f, g = _order(f, g)
        # The lower median of 3 or 4 values is the second, of 5 or 6 the third,
        # of 7 or 8 the fourth: always a value that was seen.
        median = c if e < most else b
        median = d if g < most else median
        value = median if hit[x] else b
        chosen[x] = value if c < most else nothing


@njit(nogil=True, error_model="numpy")
def _choose(
    start: int, stop: int, left: Any, right: Any, max_gap: int, seen: Any, filled: Any
) -> None:
    """Fill each gap from the up to eight disparities around it."""
    width = left.shape[1]
    hit = np.zeros(width + 4 * TOLERANCE, np.bool_)
    columns = np.empty(width, np.int32)
    around = np.empty((8, width), np.float32)
    hit_gap = np.empty(width, np.bool_)
    chosen = np.empty(width, np.float32)
    for y in range(start, stop):
        here = left[y]
        filled[y] = here
        count = _find_gaps(here, columns)
        _point_at(right[y], hit)
        for i in range(count):
            x = columns[i]
            hit_gap[i] = hit[x + 2 * TOLERANCE]
            for k in range(DIRECTIONS):
                around[k, i] = seen[0, k, y, x]
                around[DIRECTIONS + k, i] = seen[1, k, y, x]
        _look_along(
            here, columns[:count], max_gap, around[2 * DIRECTIONS, :count],
            around[2 * DIRECTIONS + 1, :count])
        _choose_of_eight(around[:, :count], hit_gap[:count], chosen[:count])
        for i in range(count):
            filled[y, columns[i]] = chosen[i]


# Pixels per cell of the grid that large areas are inpainted on.
CELL = 8
# Radius (cells) that the inpainting takes values from.
REACH = 3.0


def inpaint(disparity: DisparityMap) -> NDArray[np.float32]:
    """Inpainting of all that is open (Bertalmio et al., doi 10.1109/CVPR.2001.990497).

    Done on a coarse grid of cells: what is left at this stage is large and has
    no detail to restore. OpenCV's other method, Telea's, does not even carry a
    constant into a hole, and differs between its versions.

    Returns a new map: known pixels unchanged, the others within the extremes of
    those known; NaN everywhere if none is known.
    """
    known = np.isfinite(disparity)
    count = fold(known.astype(np.float32), CELL, 0.0)
    holes = count == 0
    if holes.all():
        return disparity.copy()
    low, high = disparity[known].min(), disparity[known].max()
    total = fold(np.where(known, disparity, np.float32(0)), CELL, 0.0)
    small = np.where(holes, low, total / np.maximum(count, np.float32(1)))
    if holes.any():
        small = cv2.inpaint(small, holes.astype(np.uint8), REACH, cv2.INPAINT_NS)
        # Beside single known cells OpenCV may divide nothing by nothing.
        small[~np.isfinite(small)] = low
    return np.where(
        known, disparity, np.clip(spread(small, CELL, disparity.shape), low, high))
