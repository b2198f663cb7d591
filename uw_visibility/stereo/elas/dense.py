# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense matching: the best disparity near that of the mesh's plane or of support points.

Section 2.2 of Geiger, Roser and Urtasun, "Efficient Large-Scale Stereo Matching",
ACCV 2010, doi:10.1007/978-3-642-19315-6_3: maximum a posteriori over candidate disparities.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.arrays import Points
from uw_visibility.stereo.elas.descriptors import BYTES, absolute_difference

# Width of the border that is not matched, px: descriptors there contain repeated border pixels.
BORDER = 2
# A key holds energy in its high bits and disparity in its low ones, so that the best disparity is
# found by a minimum without branches; of equal energies the smaller disparity is kept.
DISPARITY_BITS = 11
DISPARITY_MASK = (1 << DISPARITY_BITS) - 1
NOTHING = np.int32((1 << 30) - 1)
# Side of the cells that collect the support points' disparities, px.
CELL = 20


def plane_prior(config: StereoConfig) -> NDArray[np.int32]:
    """Energy by distance from the plane, px, in units of descriptor difference; at most 0."""
    distance = np.arange(config.plane_radius + 1)
    outlier = config.prior_outlier
    probability = outlier + np.exp(-(distance**2) / (2 * config.plane_deviation**2))
    energy = -(np.log(probability) - np.log(outlier)) / config.likelihood_weight
    return np.round(energy).astype(np.int32)


class DenseSearch:
    """Dense search in two parts, in memory that is allocated once.

    `try_candidates` needs no mesh, so that it can run while the mesh is built; `try_plane` follows
    both. A pixel of the right view takes the best of the pairs that were tried for the left view,
    since its own search would try nearly the same ones.

    best: (2, H, W) int16, disparity at the pixels of the left and of the right view, px; -1 where
        nothing was tried.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        disparities: tuple[int, int],
        config: StereoConfig,
        workers: Workers,
    ) -> None:
        self._disparities = disparities
        self._config = config
        self._workers = workers
        rows, columns = -(-shape[0] // CELL), -(-shape[1] // CELL)
        count = disparities[1] + 2
        self._seen = np.empty((rows, count, columns), np.bool_)
        self._count = np.empty(rows, np.int32)
        self._runs = np.empty((rows, count * -(-columns // 2), 3), np.int32)
        self._keys = np.empty((2, *shape), np.int32)
        self.best: NDArray[np.int16] = np.empty((2, *shape), np.int16)

    def try_candidates(
        self, descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]], points: Points
    ) -> None:
        """Try the disparities of the support points `points` (N, 3) at the pixels around them."""
        _collect_candidates(points, self._seen, self.best.shape[2], self._count, self._runs)
        self._workers.rows(
            _try_candidates, self.best.shape[1], *descriptors, self._count, self._runs,
            *self._disparities, *self._keys,
        )

    def try_plane(
        self,
        descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
        plane: NDArray[np.float32],
        steep: NDArray[np.bool_],
        refined: NDArray[np.float32],
    ) -> None:
        """Try the disparities near the mesh's plane, and write the best of all to `best`.

        `plane` is the mesh's disparity (H, W) in the left view, NaN outside. Where the mesh bridges
        a depth step, `steep`, its disparities are tried without the prior. `refined` (H, W) gets
        the left view's disparities at sub-pixel resolution, px.
        """
        self._workers.rows(
            _try_planes, plane.shape[0], *descriptors, plane, steep, *self._disparities,
            plane_prior(self._config), *self._keys, *self.best,
        )
        self._workers.rows(_refine, plane.shape[0], *descriptors, self.best[0], refined)


@njit(nogil=True)
def _try_candidates(
    start: int, stop: int, left: Any, right: Any, count: Any, runs: Any, low: int, high: int,
    keys_left: Any, keys_right: Any,
) -> None:
    height, width = keys_left.shape
    energy = np.empty(width, np.int32)
    for y in range(start, stop):
        here, there = keys_left[y], keys_right[y]
        here[:] = NOTHING
        there[:] = NOTHING
        if not BORDER <= y < height - BORDER:
            continue
        at = y * width * BYTES
        for i in range(count[y // CELL]):
            d = runs[y // CELL, i, 0]
            first = max(runs[y // CELL, i, 1], d + BORDER)
            last = min(runs[y // CELL, i, 2], width - BORDER)
            if not low <= d <= high or first >= last:
                continue
            _compare(left, right, at, d, first, last, energy)
            _offer(energy, d, first, last, here, there)


@njit(nogil=True)
def _try_planes(
    start: int, stop: int, left: Any, right: Any, plane: Any, steep: Any, low: int, high: int,
    prior: Any, keys_left: Any, keys_right: Any, best_left: Any, best_right: Any,
) -> None:
    height, width = plane.shape
    radius = len(prior) - 1
    middle = np.empty(width, np.int32)
    surface = np.empty(width, np.int32)
    for y in range(start, stop):
        here, there = keys_left[y], keys_right[y]
        if BORDER <= y < height - BORDER:
            at = y * width * BYTES
            for x in range(width):
                mean = plane[y, x]
                # NaN becomes a value far below every disparity.
                middle[x] = index_of(mean + np.float32(0.5), -1 << 20, 1 << 20)
                surface[x] = np.int32(0) if steep[y, x] else np.int32(1)
            for offset in range(-radius, radius + 1):
                _try_plane(
                    left, right, at, offset, low, high, middle, surface, prior[abs(offset)],
                    here, there,
                )
        for x in range(width):
            best_left[y, x] = disparity_of(here[x], 0)
            best_right[y, x] = disparity_of(there[x], 0)


@njit(nogil=True, inline="always")
def disparity_of(key: Any, low: int) -> Any:
    """Disparity of a key that counts from `low`; -1 where nothing was tried."""
    return np.int16(-1) if key == NOTHING else np.int16((key & DISPARITY_MASK) + low)


@njit(nogil=True)
def _refine(
    start: int, stop: int, left: Any, right: Any, best_left: Any, refined: Any
) -> None:
    """Write disparities at sub-pixel resolution; NaN where nothing was tried."""
    width = best_left.shape[1]
    for y in range(start, stop):
        for x in range(width):
            d = np.int32(best_left[y, x])
            if d < 0:
                refined[y, x] = np.nan
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
            refined[y, x] = max(d + offset, 0.0)


@njit(nogil=True, inline="always")
def meeting_of_lines(before: Any, at: Any, after: Any) -> float:
    """Offset of the minimum between three equidistant costs, within 0.5.

    It is the intersection of two lines of opposite slope through them: sums of absolute differences
    fall and rise linearly, so that a parabola would bias disparities towards whole pixels (Shimizu
    and Okutomi, ICCV 2001, doi:10.1109/ICCV.2001.937503).
    """
    slope = max(before, after) - at
    if slope <= 0:
        return 0.0
    return min(max(0.5 * (before - after) / slope, -0.5), 0.5)


@njit(nogil=True)
def _compare(
    left: Any, right: Any, at: int, d: int, first: int, last: int, energy: Any
) -> None:
    """Write the energies of a run of pixels; separate, so that `_offer` becomes vector code.

    It takes whole rows: counting the references of slices takes numba as long as a short run.
    """
    for x in range(first, last):
        i = at + x * BYTES
        energy[np.uint64(x)] = absolute_difference(left, i, right, i - d * BYTES)


@njit(nogil=True)
def _offer(energy: Any, d: int, first: int, last: int, here: Any, there: Any) -> None:
    """Update the best keys of a run of pixels with one disparity, without the prior.

    Where the prior is below zero, `_try_plane` tries the same disparity with it.
    """
    for x in range(first, last):
        at, other = np.uint64(x), np.uint64(x - d)
        key = np.int32((energy[at] << DISPARITY_BITS) + d)
        here[at] = min(here[at], key)
        there[other] = min(there[other], key)


@njit(nogil=True)
def _try_plane(
    left: Any, right: Any, at: int, offset: int, low: int, high: int, middle: Any, surface: Any,
    prior: int, here: Any, there: Any,
) -> None:
    """Update the best keys of a row with the disparities at one distance from the plane.

    The prior counts where ``surface`` is 1, not where it is 0.
    """
    width = here.size
    for x in range(BORDER, width - BORDER):
        # Unsigned, since numba checks whether signed indices are negative.
        column = np.uint64(x)
        d = middle[column] + offset
        if d < low or d > min(high, x - BORDER):
            continue
        i = at + x * BYTES
        energy = prior * surface[column] + absolute_difference(left, i, right, i - d * BYTES)
        key = np.int32((energy << DISPARITY_BITS) + d)
        other = np.uint64(x - d)
        here[column] = min(here[column], key)
        there[other] = min(there[other], key)


@njit(nogil=True)
def _collect_candidates(points: Any, seen: Any, width: int, count: Any, runs: Any) -> None:
    """Collect the disparities to try in each cell: of points in it and in adjacent cells, ±1 px.

    Adjacent cells share most of them, so that those of a row of cells are stored as runs
    (rows, N, 3): a disparity, the first column and the one after the last, px. `count` is the
    number of runs of each row.
    """
    rows, disparities, columns = seen.shape
    seen[:] = False
    for i in range(points.shape[0]):
        column = index_of(points[i, 0], 0, columns * CELL - 1) // CELL
        row = index_of(points[i, 1], 0, rows * CELL - 1) // CELL
        d = index_of(points[i, 2] + 0.5, 0, disparities - 1)
        for near in range(max(d - 1, 0), min(d + 2, disparities)):
            for y in range(max(row - 1, 0), min(row + 2, rows)):
                seen[y, near, column] = True
            for x in range(max(column - 1, 0), min(column + 2, columns)):
                seen[row, near, x] = True
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
