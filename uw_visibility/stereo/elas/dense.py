# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense matching: the best disparity near the mesh's plane or a support point's.

Section 2.2 of Geiger, Roser and Urtasun, "Efficient Large-Scale Stereo Matching",
ACCV 2010, doi:10.1007/978-3-642-19315-6_3: maximum a posteriori over the disparities
that the prior deems likely.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uw_visibility.parallel import Workers
from uw_visibility.stereo.elas.absolute_difference import BYTES, absolute_difference

# Side of the cells that collect the support points' disparities, px.
CELL = 20
# Descriptors reach two pixels to each side, and the border's repeats prove nothing.
BORDER = 2
# Energy and disparity share one integer, energy above, so that the best of both
# is one minimum without a branch; of equal energies the smaller disparity stays.
_DISPARITY_BITS = 11
_DISPARITY_MASK = (1 << _DISPARITY_BITS) - 1
_NOTHING = np.int32((1 << 30) - 1)


@dataclass(frozen=True)
class DenseSettings:
    """Weights of likelihood and prior; see `StereoConfig` for their meaning."""

    likelihood: float
    plane_radius: int
    plane_deviation: float
    outlier: float

    def prior(self) -> NDArray[np.int32]:
        """Energy by distance from the plane, in units of descriptor difference.

        Returns
        -------
        ndarray
            ``(plane_radius + 1,)`` int32, at most 0.
        """
        distance = np.arange(self.plane_radius + 1)
        probability = self.outlier + np.exp(-(distance**2) / (2 * self.plane_deviation**2))
        energy = -(np.log(probability) - np.log(self.outlier)) / self.likelihood
        return np.round(energy).astype(np.int32)


class CellCandidates:
    """Disparities that the support points around each cell propose.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    disparities : int
        Number of disparities, from 0 on.
    """

    def __init__(self, shape: tuple[int, int], disparities: int) -> None:
        rows, columns = -(-shape[0] // CELL), -(-shape[1] // CELL)
        self._seen = np.empty((rows, columns, disparities), np.bool_)
        self.count: NDArray[np.int32] = np.empty((rows, columns), np.int32)
        self.values: NDArray[np.int16] = np.empty((rows, columns, disparities), np.int16)

    def fill(self, points: NDArray[np.float32]) -> None:
        """Collect the candidates from points ``(N, 3)``: u, v, disparity."""
        _fill_cells(points, self._seen, self.count, self.values)


def match(
    here: NDArray[np.uint8],
    there: NDArray[np.uint8],
    sign: int,
    plane: NDArray[np.float32],
    candidates: CellCandidates,
    disparities: tuple[int, int],
    settings: DenseSettings,
    disparity: NDArray[np.int16],
    workers: Workers,
) -> None:
    """Match every pixel of one view.

    Parameters
    ----------
    here, there : ndarray
        Descriptors of this and of the other view, ``(H * W * 16,)`` uint8.
    sign : int
        1 where this is the left view, -1 where it is the right one.
    plane : ndarray
        ``(H, W)`` float32, the mesh's disparity in this view, NaN outside.
    candidates : CellCandidates
        What the support points propose in this view.
    disparities : tuple of int
        Smallest and largest disparity, inclusive, px.
    settings : DenseSettings
        Weights.
    disparity : ndarray
        ``(H, W)`` int16, overwritten; -1 where nothing was tried.
    workers : Workers
        Threads.
    """
    workers.rows(
        _match, disparity.shape[0], here, there, sign, plane, candidates.count,
        candidates.values, disparities[0], disparities[1], settings.prior(), disparity,
    )


@njit(nogil=True, cache=True)
def _fill_cells(points: Any, seen: Any, count: Any, values: Any) -> None:
    rows, columns, disparities = seen.shape
    seen[:] = False
    for i in range(points.shape[0]):
        column = int(points[i, 0]) // CELL
        row = int(points[i, 1]) // CELL
        d = int(points[i, 2] + 0.5)
        for y in range(max(row - 1, 0), min(row + 2, rows)):
            for x in range(max(column - 1, 0), min(column + 2, columns)):
                for near in range(max(d - 1, 0), min(d + 2, disparities)):
                    seen[y, x, near] = True
    for y in range(rows):
        for x in range(columns):
            n = 0
            for d in range(disparities):
                if seen[y, x, d]:
                    values[y, x, n] = d
                    n += 1
            count[y, x] = n


@njit(nogil=True, cache=True)
def _match(
    start: int, stop: int, here: Any, there: Any, sign: int, plane: Any, count: Any,
    candidates: Any, low: int, high: int, prior: Any, disparity: Any,
) -> None:
    height, width = disparity.shape
    radius = len(prior) - 1
    best = np.empty(width, np.int32)
    middle = np.empty(width, np.int32)
    for y in range(start, stop):
        for x in range(width):
            best[x] = _NOTHING
            mean = plane[y, x]
            middle[x] = np.int32(mean + 0.5) if mean == mean else np.int32(-2 * radius - 2)
        if BORDER <= y < height - BORDER:
            for column in range(count.shape[1]):
                x_first = max(column * CELL, BORDER)
                x_last = min((column + 1) * CELL, width - BORDER)
                for i in range(count[y // CELL, column]):
                    d = np.int32(candidates[y // CELL, column, i])
                    if low <= d <= high:
                        _try_disparity(here, there, y * width, sign, d, x_first, x_last, width,
                                       best)
            for offset in range(-radius, radius + 1):
                _try_plane(here, there, y * width, sign, offset, low, high, width, middle,
                           prior[abs(offset)], best)
        for x in range(width):
            disparity[y, x] = -1 if best[x] == _NOTHING else best[x] & _DISPARITY_MASK


@njit(nogil=True, cache=True)
def _try_disparity(
    here: Any, there: Any, at: int, sign: int, d: int, x_first: int, x_last: int, width: int,
    best: Any,
) -> None:
    """Offer one disparity to the pixels of a cell's row.

    The prior is left out: where it is below zero, `_try_plane` offers the same
    disparity with it.
    """
    if sign > 0:
        x_first = max(x_first, d + BORDER)
    else:
        x_last = min(x_last, width - BORDER - d)
    shift = sign * d
    for x in range(x_first, x_last):
        energy = absolute_difference(here, (at + x) * BYTES, there, (at + x - shift) * BYTES)
        best[x] = min(best[x], np.int32((energy << _DISPARITY_BITS) + d))


@njit(nogil=True, cache=True)
def _try_plane(
    here: Any, there: Any, at: int, sign: int, offset: int, low: int, high: int, width: int,
    middle: Any, prior: int, best: Any,
) -> None:
    """Offer each pixel of a row the disparity at one distance from its plane."""
    for x in range(BORDER, width - BORDER):
        d = middle[x] + offset
        other = x - sign * d
        if d < low or d > high or other < BORDER or other >= width - BORDER:
            continue
        energy = prior + absolute_difference(
            here, (at + x) * BYTES, there, (at + other) * BYTES)
        best[x] = min(best[x], np.int32((energy << _DISPARITY_BITS) + d))
