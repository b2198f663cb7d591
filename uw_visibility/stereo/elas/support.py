# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Support points: matches on a grid that are textured, unique and mutual.

Section 2.1 of Geiger, Roser and Urtasun, "Efficient Large-Scale Stereo Matching",
ACCV 2010, doi:10.1007/978-3-642-19315-6_3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array, Image8, Points
from uw_visibility.stereo.airlight import AirlightPrior
from uw_visibility.stereo.elas.absolute_difference import BYTES, absolute_difference
from uw_visibility.stereo.elas.descriptors import MIDDLE
from uw_visibility.stereo.elas.evidence import MEAN_OF_NORMAL
from uw_visibility.stereo.elas.support_filter import keep_consistent, mark_vertices, smooth

FEWEST_SUPPORT_POINTS = 10
"""Fewer of them make no mesh worth a plane."""

# A support point is compared at the four corners of a square of this half side,
# so that its window reaches 9 x 9 pixels.
REACH = 2
# Neighbours of the best disparity are the same minimum of the cost.
SAME_MINIMUM = 1
_HUGE = np.int32(1 << 30)
# Every this many rows of the grid tell the order of the images.
_ORDER_STRIDE = 8
# Part of the grid below which its points are few.
_FEW = 0.1
# Deviation of a support disparity: this over the curvature of its cost, px.
_COST_NOISE = np.float32(60.0)
# Least texture over that of noise alone: less is hardly ever the scene's.
_SIGNAL = 0.75
# A disparity this near to that of an earlier match is the same one, px.
_SAME_MATCH = np.float32(1.0)
# Where there is an earlier match the search reaches this far around it, px.
_AROUND = 16
# Stands for earlier matches where there are none.
_NOWHERE = np.empty((0, 0), np.float32)
# Stands for bounds and thickness where airlight bounds nothing.
_NO_BOUND = (np.empty((0, 0), np.float32), np.empty(0, np.float32))


@dataclass(frozen=True)
class SupportPoints:
    """Robust matches of a pair.

    Attributes
    ----------
    points : ndarray
        ``(N, 3)`` float32: column u, row v in the left image and disparity, px,
        row by row.
    vertices : ndarray
        ``(N,)`` bool: the points that the mesh needs. Within flat regions a
        lattice of them is enough, and the triangulation costs a fraction.
    """

    points: Points
    vertices: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True)
class SupportSettings:
    """Thresholds of the support points; see `StereoConfig` for their meaning."""

    step: int
    texture: int
    uniqueness: float
    consistency_cells: int
    consistency_disparity: float
    consistency_count: int


class SupportGrid:
    """Grid search for support points, in memory that is allocated once.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    settings : SupportSettings
        Thresholds.
    """

    def __init__(self, shape: tuple[int, int], settings: SupportSettings) -> None:
        height, width = shape
        self._shape = shape
        self._settings = settings
        step = settings.step
        rows, columns = max(height // step, 1), max(width // step, 1)
        self._found = np.empty((rows, columns), np.float32)
        self._kept = np.empty((rows, columns), np.float32)
        self._deviation = np.empty((rows, columns), np.float32)
        self._smoothed = np.empty((rows, columns), np.float32)
        self._vertices = np.empty((rows, columns), np.bool_)
        self._agreed = np.empty((rows, columns), np.float32)
        self._texture = np.full((rows, columns), settings.texture, np.int32)

    def swapped_ratio(
        self,
        left: Image8,
        right: Image8,
        disparities: tuple[int, int],
        workers: Workers,
    ) -> float:
        """Compare how often the pair matches with its images exchanged.

        Only every eighth row of the grid is searched, but all where few points match, since
        a sample of those says little.

        Parameters
        ----------
        left, right, disparities, workers
            As in `search`, which was called for the same pair before.

        Returns
        -------
        float
            Matches of the exchanged pair over those of the pair, ten added to both
            so that a few chance matches say nothing.
        """
        settings = self._settings
        height, width = self._shape
        few = np.count_nonzero(self._found >= 0) < _FEW * self._found.size
        stride = 1 if few else _ORDER_STRIDE
        rows = -(-self._found.shape[0] // stride)
        exchanged = np.empty((2, rows, self._found.shape[1]), np.float32)
        workers.rows(
            _search, rows, stride, right, left, width, height, settings.step,
            disparities[0], disparities[1], self._texture, np.float32(settings.uniqueness),
            *_NO_BOUND, _NOWHERE, exchanged[0], exchanged[1],
        )
        in_order = np.count_nonzero(self._found[::stride] >= 0)
        return float((np.count_nonzero(exchanged[0] >= 0) + 10) / (in_order + 10))

    def search(
        self,
        left: Image8,
        right: Image8,
        disparities: tuple[int, int],
        workers: Workers,
        airlight: AirlightPrior | None = None,
        earlier: NDArray[np.float32] | None = None,
        noise: Array | None = None,
    ) -> SupportPoints:
        """Find the support points of a described pair.

        Parameters
        ----------
        left, right : ndarray
            Descriptors of the two views, ``(H * W * 16,)`` uint8.
        disparities : tuple of int
            Smallest and largest disparity, inclusive, px.
        workers : Workers
            Threads.
        airlight : AirlightPrior, optional
            Leaves out disparities of ranges that the airlight excludes.
        earlier : ndarray, optional
            ``(N, 3)`` float32, column, row and disparity, px, of matches of the same
            scene in other images of it. Beside one the search is limited to disparities
            around it, and where the best match is the same, it needs no uniqueness of
            its own.
        noise : ndarray, optional
            float64, standard deviation of the gradient responses that noise makes at each
            point of the grid. Texture that is much less than noise alone would be is none.
        """
        settings = self._settings
        height, width = self._shape
        rows = self._found.shape[0]
        agreed = _NOWHERE
        if earlier is not None:
            agreed = self._agreed
            _spread(earlier, settings.step, agreed)
        self._texture[:] = settings.texture
        if noise is not None:
            least = _SIGNAL * MEAN_OF_NORMAL * BYTES * noise[:rows, : width // settings.step]
            np.maximum(self._texture, least.astype(np.int32), out=self._texture)
        bound = _NO_BOUND if airlight is None else (airlight.farthest, airlight.thickness)
        workers.rows(
            _search, rows, 1, left, right, width, height, settings.step, disparities[0],
            disparities[1], self._texture, np.float32(settings.uniqueness), bound[0], bound[1],
            agreed, self._found, self._deviation,
        )
        workers.rows(
            keep_consistent, rows, self._found, settings.consistency_cells,
            np.float32(settings.consistency_disparity), settings.consistency_count, self._kept,
        )
        workers.rows(smooth, rows, self._kept, self._deviation, self._smoothed)
        workers.rows(mark_vertices, rows, self._smoothed, self._vertices)
        v, u = np.nonzero(self._smoothed >= disparities[0])
        points = np.empty((len(u), 3), np.float32)
        points[:, 0] = u * settings.step + settings.step // 2
        points[:, 1] = v * settings.step + settings.step // 2
        points[:, 2] = np.minimum(self._smoothed[v, u], points[:, 0])
        return SupportPoints(points, self._vertices[v, u])


@njit(nogil=True)
def _spread(points: Any, step: int, agreed: Any) -> None:
    """Write each point's disparity to its place on the grid and to those around it."""
    rows, columns = agreed.shape
    agreed[:] = -_HUGE
    for i in range(points.shape[0]):
        row, column = int(points[i, 1]) // step, int(points[i, 0]) // step
        for y in range(max(row - 1, 0), min(row + 2, rows)):
            for x in range(max(column - 1, 0), min(column + 2, columns)):
                if agreed[y, x] < 0 or (y == row and x == column):
                    agreed[y, x] = points[i, 2]


@njit(nogil=True)
def _texture(descriptors: Any, at: int) -> np.int32:
    total = np.int32(0)
    for i in range(BYTES):
        total += abs(np.int32(descriptors[at + i]) - MIDDLE)
    return total


@njit(nogil=True)
def _scan(
    here: Any, there: Any, u: int, v: int, width: int, sign: int, low: int, high: int, cost: Any
) -> int:
    """Costs of pixel (u, v) of one view against (u - sign * d, v) of the other, d from low on.

    The costs are stored, not reduced on the fly: the store keeps LLVM from
    moving half of the absolute difference out of the loop, which would break
    its vector form.
    """
    a = ((v - REACH) * width + u - REACH) * BYTES
    b = a + 2 * REACH * BYTES
    c = ((v + REACH) * width + u - REACH) * BYTES
    e = c + 2 * REACH * BYTES
    count = high - low + 1
    for k in range(count):
        shift = -sign * (low + k) * BYTES
        cost[k] = (
            absolute_difference(here, a, there, a + shift)
            + absolute_difference(here, b, there, b + shift)
            + absolute_difference(here, c, there, c + shift)
            + absolute_difference(here, e, there, e + shift)
        )
    return count


@njit(nogil=True)
def _least(cost: Any, start: int, stop: int) -> Any:
    best = _HUGE
    for k in range(start, stop):
        best = min(best, cost[k])
    return best


@njit(nogil=True)
def _position(cost: Any, value: Any) -> int:
    k = 0
    while cost[k] != value:
        k += 1
    return k


@njit(nogil=True)
def _is_unique(cost: Any, count: int, at: int, uniqueness: Any, floor: Any) -> bool:
    """Uniqueness test: whether no rival comes near the cost of the best.

    The best is taken as it is sampled, a rival as low as it could lie between
    two pixels: on sharp edges a true match half a pixel off costs more than
    another edge that happens to fall on a whole one, as on a checkerboard.
    """
    floor[0] = cost[0]
    floor[count - 1] = cost[count - 1]
    for k in range(1, count - 1):
        before, here, after = cost[k - 1], cost[k], cost[k + 1]
        # The bottom of the V that a shifted edge makes around a minimum.
        depth = np.int32(abs(after - before) >> 1)
        floor[k] = here - (depth if here <= before and here <= after else np.int32(0))
    rival = min(
        _least(floor, 0, at - SAME_MINIMUM), _least(floor, at + SAME_MINIMUM + 1, count)
    )
    return np.float32(cost[at]) < uniqueness * np.float32(rival)


@njit(nogil=True)
def vertex_of_parabola(before: Any, at: Any, after: Any) -> float:
    """Offset of the minimum of a parabola through three equidistant costs, within 0.5."""
    curvature = before - 2.0 * at + after
    if curvature <= 0.0:
        return 0.0
    return min(max(0.5 * (before - after) / curvature, -0.5), 0.5)


@njit(nogil=True)
def _least_disparity(farthest: Any, thickness: Any, low: int, high: int) -> int:
    """Return the disparity before the first that airlight allows; it counts as a rival."""
    d = low
    while d < high and thickness[d] > farthest:
        d += 1
    return max(d - 1, low)


@njit(nogil=True)
def _search(
    start: int, stop: int, stride: int, left: Any, right: Any, width: int, height: int, step: int,
    lowest: int, high: int, texture: Any, uniqueness: Any, farthest: Any, thickness: Any,
    agreed: Any, found: Any, deviation: Any,
) -> None:
    cost = np.empty(high - lowest + 1, np.int32)
    floor = np.empty(high - lowest + 1, np.int32)
    for row in range(start, stop):
        v = row * stride * step + step // 2
        for column in range(found.shape[1]):
            found[row, column] = -1.0
            u = column * step + step // 2
            if not (REACH <= v < height - REACH and REACH <= u < width - REACH):
                continue
            if _texture(left, (v * width + u) * BYTES) < texture[row * stride, column]:
                continue
            last = min(high, u - REACH)
            low, top = lowest, high
            if thickness.size > 0:
                low = _least_disparity(farthest[v, u], thickness, lowest, last)
            if agreed.size > 0 and agreed[row, column] >= 0:
                low = max(low, int(agreed[row, column]) - _AROUND)
                top = min(top, int(agreed[row, column]) + _AROUND)
                last = min(last, top)
            if last - low < 2 * SAME_MINIMUM + 2:
                continue
            count = _scan(left, right, u, v, width, 1, low, last, cost)
            at = _position(cost, _least(cost, 0, count))
            if not _is_unique(cost, count, at, uniqueness, floor) and (
                agreed.size == 0 or abs(low + at - agreed[row, column]) > _SAME_MATCH
            ):
                continue
            before, here, after = cost[max(at - 1, 0)], cost[at], cost[min(at + 1, count - 1)]
            x = u - low - at
            count = _scan(
                right, left, x, v, width, -1, low, min(top, width - REACH - 1 - x), cost)
            if abs(_position(cost, _least(cost, 0, count)) - at) > 1:
                continue
            offset = 0.0
            if 0 < at < last - low:
                offset = vertex_of_parabola(
                    np.float64(before), np.float64(here), np.float64(after)
                )
            found[row, column] = low + at + offset
            deviation[row, column] = _COST_NOISE / np.float32(max(before + after - 2 * here, 1))
