# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Discontinuity-preserving gap filling (Hirschmüller 2008, section 2.6.3).

doi 10.1109/TPAMI.2007.1166
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError

# Directions that one sweep over the rows looks in; along a row there are two more.
DIRECTIONS = 3
# How far (px) a disparity of the right map may miss a pixel of the left one and
# still count as lying on it.
TOLERANCE = 1


class GapFiller:
    """Gap filling in disparity maps of one size; see `fill`.

    Holds its buffers: one call at a time.

    Parameters
    ----------
    shape : tuple of int
        Height and width.
    max_gap : int
        How far a pixel looks for disparities, px.
    workers : Workers, optional
        Threads; one by default.
    """

    def __init__(
        self, shape: tuple[int, int], max_gap: int = 40, workers: Workers | None = None
    ) -> None:
        self.shape = shape
        self._max_gap = max_gap
        self._workers = workers or Workers(1)
        self._seen = np.empty((2, DIRECTIONS, *shape), np.float32)

    def fill(
        self, left: NDArray[np.float32], right: NDArray[np.float32] | None = None
    ) -> NDArray[np.float32]:
        """Fill gaps from the eight directions around each pixel.

        An occluded pixel takes the second lowest of what it sees, so it
        belongs to the background; a mismatched one takes their median, so a
        hole in the foreground stays foreground.

        Parameters
        ----------
        left : (H, W) float32 ndarray
            Left disparity map, px; NaN = a gap.
        right : (H, W) float32 ndarray, optional
            Right disparity map **before** the left/right check, positive px, NaN =
            unknown. Where none of its disparities points at a pixel, that pixel
            is occluded. Without it, all gaps are taken as occluded.

        Returns
        -------
        (H, W) float32 ndarray
            A new map; NaN stays where fewer than three directions meet a
            disparity within `max_gap`.

        Raises
        ------
        InputError
            If a map has another shape.
        """
        if left.shape != self.shape or (right is not None and right.shape != self.shape):
            raise InputError(f"disparity maps are not of the shape {self.shape} expected")
        self._workers.rows(_sweep, 2, left, self._max_gap, self._seen)
        filled = np.empty_like(left)
        other = left[:0] if right is None else right
        self._workers.rows(_choose, left.shape[0], left, other, self._max_gap, self._seen, filled)
        return filled


def fill_gaps(
    left: NDArray[np.float32],
    right: NDArray[np.float32] | None = None,
    max_gap: int = 40,
    workers: Workers | None = None,
) -> NDArray[np.float32]:
    """Fill gaps of one map; see `GapFiller`, which keeps its buffers."""
    return GapFiller((left.shape[0], left.shape[1]), max_gap, workers).fill(left, right)


def occluded(
    left: NDArray[np.float32], right: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Occlusion mask: gaps of the left map that no disparity of the right one points at.

    Parameters
    ----------
    left, right : (H, W) float32 ndarray
        As in `GapFiller.fill`.

    Returns
    -------
    (H, W) bool ndarray
        True at gaps of `left` that no disparity of `right` points at.
    """
    hidden = np.empty(left.shape, np.bool_)
    _mark_occluded(0, left.shape[0], left, right, hidden)
    return hidden


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
def _look_along(disparity: Any, max_gap: int, first: int, step: int, out: Any) -> None:
    """Carry the last disparity met along a row, from its pixel ``first`` on; inf = none."""
    carried = np.float32(np.inf)
    age = 0
    x = first
    for _ in range(disparity.size):
        d = disparity[x]
        age += 1
        out[x] = carried if age <= max_gap else np.float32(np.inf)
        if not np.isnan(d):
            carried = d
            age = 0
        x += step


@njit(nogil=True, error_model="numpy")
def _point_at(right: Any, hit: Any) -> None:
    """Mark the pixels of a row that a disparity of the right row points at."""
    width = right.size
    hit[:] = False
    for q in range(width):
        d = right[q]
        if np.isnan(d) or d < 0 or d > width:
            continue
        x = q + int(d + np.float32(0.5))
        for near in range(max(x - TOLERANCE, 0), min(x + TOLERANCE + 1, width)):
            hit[near] = True


@njit(nogil=True, error_model="numpy")
def _mark_occluded(start: int, stop: int, left: Any, right: Any, hidden: Any) -> None:
    """Mark gaps that no disparity of the right map points at."""
    width = left.shape[1]
    hit = np.empty(width, np.bool_)
    for y in range(start, stop):
        _point_at(right[y], hit)
        for x in range(width):
            hidden[y, x] = np.isnan(left[y, x]) and not hit[x]


@njit(nogil=True, error_model="numpy")
def _order(a: Any, b: Any) -> tuple[Any, Any]:
    return (a, b) if a < b else (b, a)


@njit(nogil=True, error_model="numpy")
def _choose_row(here: Any, around: Any, hit: Any, filled: Any) -> None:
    """Fill a row of gaps from the (8, W) disparities around them; inf = none.

    The eight are sorted with Batcher's network (doi 10.1145/1468075.1468121),
    which has no branches, so many pixels are sorted at once.
    """
    v0, v1, v2, v3 = around[0], around[1], around[2], around[3]
    v4, v5, v6, v7 = around[4], around[5], around[6], around[7]
    most = np.float32(np.inf)
    nothing = np.float32(np.nan)
    for x in range(here.size):
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
        value = value if c < most else nothing
        known = here[x]
        filled[x] = value if known != known else known


@njit(nogil=True, error_model="numpy")
def _choose(
    start: int, stop: int, left: Any, right: Any, max_gap: int, seen: Any, filled: Any
) -> None:
    """Fill each gap from the up to eight disparities around it."""
    width = left.shape[1]
    hit = np.zeros(width, np.bool_)
    around = np.empty((8, width), np.float32)
    for y in range(start, stop):
        if right.shape[0] > 0:
            _point_at(right[y], hit)
        for k in range(DIRECTIONS):
            around[k] = seen[0, k, y]
            around[DIRECTIONS + k] = seen[1, k, y]
        _look_along(left[y], max_gap, 0, 1, around[6])
        _look_along(left[y], max_gap, width - 1, -1, around[7])
        _choose_row(left[y], around, hit, filled[y])
