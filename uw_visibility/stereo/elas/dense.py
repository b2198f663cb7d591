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
from numpy.typing import NDArray

from uw_visibility.kernel_cache import njit
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
    descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    plane: NDArray[np.float32],
    candidates: CellCandidates,
    disparities: tuple[int, int],
    settings: DenseSettings,
    best: NDArray[np.int16],
    workers: Workers,
) -> None:
    """Match every pixel of the left view, and every one of the right view with it.

    A pixel of the right view takes the best of the pairs that were tried for
    the left view: its own search would try nearly the same ones again.

    Parameters
    ----------
    descriptors : tuple of ndarray
        Of the left and of the right view, ``(H * W * 16,)`` uint8.
    plane : ndarray
        ``(H, W)`` float32, the mesh's disparity in the left view, NaN outside.
    candidates : CellCandidates
        What the support points propose.
    disparities : tuple of int
        Smallest and largest disparity, inclusive, px.
    settings : DenseSettings
        Weights.
    best : ndarray
        ``(2, H, W)`` int16, overwritten: disparity at the pixels of the left and
        of the right view, -1 where nothing was tried.
    workers : Workers
        Threads.
    """
    workers.rows(
        _match, plane.shape[0], descriptors[0], descriptors[1], plane, candidates.count,
        candidates.values, disparities[0], disparities[1], settings.prior(), best[0], best[1],
    )


@njit(nogil=True)
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


@njit(nogil=True)
def _match(
    start: int, stop: int, left: Any, right: Any, plane: Any, count: Any, candidates: Any,
    low: int, high: int, prior: Any, best_left: Any, best_right: Any,
) -> None:
    height, width = plane.shape
    radius = len(prior) - 1
    here = np.empty(width, np.int32)
    there = np.empty(width, np.int32)
    middle = np.empty(width, np.int32)
    for y in range(start, stop):
        for x in range(width):
            here[x] = _NOTHING
            there[x] = _NOTHING
            mean = plane[y, x]
            middle[x] = np.int32(mean + np.float32(0.5)) if mean == mean else np.int32(-1 << 20)
        if BORDER <= y < height - BORDER:
            at = y * width * BYTES
            for column in range(count.shape[1]):
                for i in range(count[y // CELL, column]):
                    d = np.int32(candidates[y // CELL, column, i])
                    if low <= d <= high:
                        _try_disparity(
                            left, right, at, d, max(column * CELL, d + BORDER),
                            min((column + 1) * CELL, width - BORDER), here, there,
                        )
            for offset in range(-radius, radius + 1):
                _try_plane(
                    left, right, at, offset, low, high, middle, prior[abs(offset)], here, there)
        for x in range(width):
            best_left[y, x] = _disparity_of(here[x])
            best_right[y, x] = _disparity_of(there[x])


@njit(nogil=True)
def _disparity_of(key: Any) -> Any:
    return np.int16(-1) if key == _NOTHING else np.int16(key & _DISPARITY_MASK)


@njit(nogil=True)
def _try_disparity(
    left: Any, right: Any, at: int, d: int, first: int, last: int, here: Any, there: Any
) -> None:
    """Offer one disparity to the pixels of a cell's row.

    The prior is left out: where it is below zero, `_try_plane` offers the same
    disparity with it.
    """
    shift = d * BYTES
    for x in range(first, last):
        i = at + x * BYTES
        key = np.int32((absolute_difference(left, i, right, i - shift) << _DISPARITY_BITS) + d)
        here[x] = min(here[x], key)
        there[x - d] = min(there[x - d], key)


@njit(nogil=True)
def _try_plane(
    left: Any, right: Any, at: int, offset: int, low: int, high: int, middle: Any, prior: int,
    here: Any, there: Any,
) -> None:
    """Offer each pixel of a row the disparity at one distance from its plane."""
    width = here.size
    for x in range(BORDER, width - BORDER):
        d = middle[x] + offset
        if d < low or d > min(high, x - BORDER):
            continue
        i = at + x * BYTES
        energy = prior + absolute_difference(left, i, right, i - d * BYTES)
        key = np.int32((energy << _DISPARITY_BITS) + d)
        here[x] = min(here[x], key)
        there[x - d] = min(there[x - d], key)
