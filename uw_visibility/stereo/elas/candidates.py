# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Candidate disparities that support points propose for their surroundings.

Section 2.2 of Geiger, Roser and Urtasun, "Efficient Large-Scale Stereo Matching",
ACCV 2010, doi:10.1007/978-3-642-19315-6_3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Points

# Side of the cells that collect the support points' disparities, px.
CELL = 20


class CellCandidates:
    """Candidate disparities of each cell, from the support points around it.

    Neighbouring cells share most of their candidates, so that those of a row of cells
    are kept as runs: a disparity and the columns that it is tried at.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    disparities : int
        Number of disparities, from 0 on.

    Attributes
    ----------
    count : ndarray
        ``(rows,)`` int32, number of runs of each row of cells.
    runs : ndarray
        ``(rows, N, 3)`` int32: disparity, first column and the one after the last, px.
    """

    def __init__(self, shape: tuple[int, int], disparities: int) -> None:
        self._width = shape[1]
        rows, columns = -(-shape[0] // CELL), -(-shape[1] // CELL)
        self._seen = np.empty((rows, disparities, columns), np.bool_)
        self.count: NDArray[np.int32] = np.empty(rows, np.int32)
        self.runs: NDArray[np.int32] = np.empty(
            (rows, disparities * -(-columns // 2), 3), np.int32
        )

    def fill(self, points: Points) -> None:
        """Collect the candidates from points ``(N, 3)``: u, v, disparity."""
        _mark(points, self._seen)
        _collect_runs(self._seen, self._width, self.count, self.runs)


@njit(nogil=True)
def _mark(points: Any, seen: Any) -> None:
    """Mark each point's disparity, and those beside it, in its cell and the four next to it."""
    rows, disparities, columns = seen.shape
    seen[:] = False
    for i in range(points.shape[0]):
        column = int(points[i, 0]) // CELL
        row = int(points[i, 1]) // CELL
        d = int(points[i, 2] + 0.5)
        for near in range(max(d - 1, 0), min(d + 2, disparities)):
            for y in range(max(row - 1, 0), min(row + 2, rows)):
                seen[y, near, column] = True
            for x in range(max(column - 1, 0), min(column + 2, columns)):
                seen[row, near, x] = True


@njit(nogil=True)
def _collect_runs(seen: Any, width: int, count: Any, runs: Any) -> None:
    rows, disparities, columns = seen.shape
    for y in range(rows):
        n = 0
        for d in range(disparities):
            x = 0
            while x < columns:
                first = x
                while x < columns and seen[y, d, x]:
                    x += 1
                if x > first:
                    runs[y, n, 0] = d
                    runs[y, n, 1] = first * CELL
                    runs[y, n, 2] = min(x * CELL, width)
                    n += 1
                x += 1
        count[y] = n
