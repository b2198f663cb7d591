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

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.arrays import Array, DisparityMap, Image8, Points
from uw_visibility.stereo.elas.descriptors import BYTES, MIDDLE, absolute_difference
from uw_visibility.stereo.elas.evidence import MEAN_OF_NORMAL

FEWEST_SUPPORT_POINTS = 10
"""Least number of support points for a useful mesh."""

# Half side of the square at whose four corners a support point is compared, px: with the
# descriptors' own, the window is 9 x 9 pixels.
REACH = 2
# Distance from the best disparity that belongs to the same minimum of the cost, px.
SAME_MINIMUM = 1
_HUGE = np.int32(1 << 30)
# Every eighth row of the grid is searched to find swapped or shifted images.
_ORDER_STRIDE = 8
# Standard deviation of a support disparity, px, times the curvature of its cost.
_COST_NOISE = np.float32(60.0)
# Least texture over that of noise alone: less is hardly ever from the scene.
_SIGNAL = 0.75
# Largest difference from the disparity of an earlier match that confirms a match, px.
_SAME_MATCH = np.float32(1.0)
# Reach of the search to each side of an earlier match's disparity, px.
_AROUND = 16
# Stands for earlier matches if there are none.
_NOWHERE = np.empty((0, 0), np.float32)


@dataclass(frozen=True)
class SupportPoints:
    """Robust matches of a pair."""

    # (N, 3) float32, column u, row v in the left image and disparity, px, row by row
    points: Points
    # (N,) bool, points that the mesh needs: within flat regions a lattice of them is enough, and
    # triangulation is much faster.
    vertices: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points)


class SupportGrid:
    """Grid search for support points, in memory that is allocated once."""

    def __init__(
        self,
        shape: tuple[int, int],
        disparities: tuple[int, int],
        config: StereoConfig,
        workers: Workers,
    ) -> None:
        height, width = shape
        self._shape = shape
        self._disparities = disparities
        self._config = config
        self._workers = workers
        step = config.support_step
        rows, columns = max(height // step, 1), max(width // step, 1)
        self._found, self._deviation, self._kept, self._smoothed, self._agreed = np.empty(
            (5, rows, columns), np.float32)
        self._vertices = np.empty((rows, columns), np.bool_)
        self._texture = np.full((rows, columns), config.support_texture, np.int32)

    def ratio(self, left: Image8, right: Image8, *, consistent: bool) -> float:
        """Matches of other descriptors over those of the last `search`.

        Ten are added to both, so that a few chance matches do not count. Every eighth row of the
        grid is searched, or all, for the matches that are `consistent` with their neighbours.
        """
        stride = 1 if consistent else _ORDER_STRIDE
        rows = -(-self._found.shape[0] // stride)
        others = np.empty((2, rows, self._found.shape[1]), np.float32)
        self._match(rows, stride, left, right, _NOWHERE, *others)
        found = self._found[::stride]
        if consistent:
            found = self._kept
            self._keep_consistent(*others)
        kept = np.count_nonzero(others[int(consistent)] >= 0)
        return float((kept + 10) / (np.count_nonzero(found >= 0) + 10))

    def search(
        self,
        left: Image8,
        right: Image8,
        noise: Array,
        earlier: NDArray[np.float32] | None = None,
    ) -> SupportPoints:
        """Find the support points of a described pair.

        left, right: (H * W * 16,) uint8, descriptors of the two views.
        noise: float64, standard deviation of gradient responses to noise at each point of the
            grid. Points with much less texture than noise alone are not matched.
        earlier: (N, 3) float32, column, row and disparity, px, of matches in other images of the
            scene. Near one the search is limited to disparities around it, and a best match that
            agrees with it need not be unique.
        """
        config, workers = self._config, self._workers
        rows, columns = self._found.shape
        agreed = _NOWHERE
        if earlier is not None:
            agreed = self._agreed
            _spread(earlier, config.support_step, agreed)
        least = _SIGNAL * MEAN_OF_NORMAL * BYTES * noise[:rows, :columns]
        np.maximum(config.support_texture, least.astype(np.int32), out=self._texture)
        self._match(rows, 1, left, right, agreed, self._found, self._deviation)
        self._keep_consistent(self._found, self._kept)
        workers.rows(smooth, rows, self._kept, self._deviation, self._smoothed)
        workers.rows(mark_vertices, rows, self._smoothed, self._vertices)
        v, u = np.nonzero(self._smoothed >= self._disparities[0])
        points = np.empty((len(u), 3), np.float32)
        points[:, 0] = u * config.support_step + config.support_step // 2
        points[:, 1] = v * config.support_step + config.support_step // 2
        points[:, 2] = np.minimum(self._smoothed[v, u], points[:, 0])
        return SupportPoints(points, self._vertices[v, u])

    def _keep_consistent(self, found: DisparityMap, kept: DisparityMap) -> None:
        """Write the points with which enough neighbours agree; -1 elsewhere."""
        config = self._config
        self._workers.rows(
            keep_consistent, len(found), found, config.consistency_cells,
            np.float32(config.consistency_disparity), config.consistency_count, kept,
        )

    def _match(self, rows: int, stride: int, *arguments: Any) -> None:
        """Match every `stride`-th row of the grid; see `_search` for the arguments."""
        config = self._config
        self._workers.rows(
            _search, rows, stride, *self._shape, config.support_step, *self._disparities,
            self._texture, np.float32(config.support_uniqueness), *arguments,
        )


@njit(nogil=True)
def _spread(points: Any, step: int, agreed: Any) -> None:
    """Write each point's disparity to its place on the grid and to empty ones around it."""
    rows, columns = agreed.shape
    agreed[:] = -_HUGE
    for i in range(points.shape[0]):
        row = index_of(points[i, 1], 0, rows * step - 1) // step
        column = index_of(points[i, 0], 0, columns * step - 1) // step
        for y in range(max(row - 1, 0), min(row + 2, rows)):
            for x in range(max(column - 1, 0), min(column + 2, columns)):
                if agreed[y, x] < 0 or (y == row and x == column):
                    agreed[y, x] = points[i, 2]


@njit(nogil=True)
def _scan(
    here: Any, there: Any, u: int, v: int, width: int, sign: int, low: int, high: int, cost: Any
) -> int:
    """Write costs of pixel (u, v) against (u - sign * d, v) of the other view, d from low to high.

    They are stored, not reduced on the fly: the store keeps LLVM from moving half of the absolute
    difference out of the loop, which would prevent vector code.
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
    """Uniqueness test: whether the best cost is below `uniqueness` times that of any rival.

    A rival's cost is that of its minimum between two pixels, the best cost is not interpolated: at
    sharp edges, as on a checkerboard, a true match at half a pixel costs more than a wrong one that
    happens to be at a whole pixel.
    """
    floor[0] = cost[0]
    floor[count - 1] = cost[count - 1]
    for k in range(1, count - 1):
        before, here, after = cost[k - 1], cost[k], cost[k + 1]
        # Depth of the minimum between pixels, which a shifted edge makes V-shaped.
        depth = np.int32(abs(after - before) >> 1)
        floor[k] = here - (depth if here <= before and here <= after else np.int32(0))
    rival = min(_least(floor, 0, at - SAME_MINIMUM), _least(floor, at + SAME_MINIMUM + 1, count))
    return np.float32(cost[at]) < uniqueness * np.float32(rival)


@njit(nogil=True, inline="always")
def vertex_of_parabola(before: Any, at: Any, after: Any) -> float:
    """Offset of the minimum of a parabola through three equidistant costs, within 0.5."""
    curvature = before - 2.0 * at + after
    if curvature <= 0.0:
        return 0.0
    return min(max(0.5 * (before - after) / curvature, -0.5), 0.5)


@njit(nogil=True)
def _search(
    start: int, stop: int, stride: int, height: int, width: int, step: int, lowest: int, high: int,
    texture: Any, uniqueness: Any, left: Any, right: Any, agreed: Any,
    found: Any, deviation: Any,
) -> None:
    cost = np.empty(high - lowest + 1, np.int32)
    floor = np.empty(high - lowest + 1, np.int32)
    blank = np.full(BYTES, MIDDLE, np.uint8)
    for row in range(start, stop):
        v = row * stride * step + step // 2
        for column in range(found.shape[1]):
            found[row, column] = -1.0
            u = column * step + step // 2
            if not (REACH <= v < height - REACH and REACH <= u < width - REACH):
                continue
            own_texture = absolute_difference(left, (v * width + u) * BYTES, blank, 0)
            if own_texture < texture[row * stride, column]:
                continue
            last = min(high, u - REACH)
            low, top = lowest, high
            if agreed.size > 0 and agreed[row, column] >= 0:
                near = index_of(agreed[row, column], 0, width)
                low = max(low, near - _AROUND)
                top = min(top, near + _AROUND)
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
            count = _scan(right, left, x, v, width, -1, low, min(top, width - REACH - 1 - x), cost)
            if abs(_position(cost, _least(cost, 0, count)) - at) > 1:
                continue
            offset = 0.0
            if 0 < at < last - low:
                offset = vertex_of_parabola(np.float64(before), np.float64(here), np.float64(after))
            found[row, column] = low + at + offset
            deviation[row, column] = _COST_NOISE / np.float32(max(before + after - 2 * here, 1))


# The mesh keeps at least every eighth grid point in each direction, so that planes do not drift.
_LATTICE = 8
# Largest distance of a neighbour on the grid, grid points.
_NEIGHBOUR_STEPS = 2
# Largest difference from its neighbours of a point that the mesh does not need, px.
_FLAT = np.float32(1.0)
# Reach of the smoothing to each side, grid points.
_SMOOTHING_STEPS = 8
# Stride of the smoothing, grid points: 1 is not measurably better.
_SMOOTHING_STRIDE = 2
# Largest difference of disparity of neighbours on the same surface, px.
_SAME_SURFACE = np.float32(3.0)
# Growth of a neighbour's standard deviation per grid point of distance, px.
_ROUGHNESS = 0.2
# Least variance of a match, px^2, and weight of the penalty on a plane's slope (ridge regression).
_LEAST_VARIANCE = 0.01
_SLOPE_RIDGE = 0.5


@njit(nogil=True, error_model="numpy")
def keep_consistent(
    start: int, stop: int, found: Any, cells: int, disparity: Any, count: int, kept: Any
) -> None:
    """Consistency filter: drop points with which too few neighbours agree."""
    rows, columns = found.shape
    agreeing = np.empty(columns, np.int32)
    for row in range(start, stop):
        # A point agrees with itself.
        agreeing[:] = -1
        here = found[row]
        for y in range(max(row - cells, 0), min(row + cells + 1, rows)):
            there = found[y]
            for shift in range(-cells, cells + 1):
                first, last = max(0, -shift), min(columns, columns - shift)
                if first < last:
                    _count_agreeing(first, last, shift, here, there, disparity, agreeing)
        for column in range(columns):
            d = found[row, column]
            kept[row, column] = d if d >= 0 and agreeing[column] >= count else -1.0


@njit(nogil=True, error_model="numpy")
def _count_agreeing(
    first: int, last: int, shift: int, here: Any, there: Any, disparity: Any, agreeing: Any
) -> None:
    """Count one neighbour of each point of a row; in a function of its own, for vector code.

    It takes whole rows, since counting the references of slices takes numba as long as the loop;
    indices are unsigned, since numba checks whether signed ones are negative.
    """
    for x in range(first, last):
        i, j = np.uint64(x), np.uint64(x + shift)
        near = abs(there[j] - here[i]) <= disparity
        agreeing[i] += np.int32(1) if near and there[j] >= 0 else np.int32(0)


@njit(nogil=True, error_model="numpy")
def smooth(start: int, stop: int, kept: Any, deviation: Any, smoothed: Any) -> None:
    """Replace each disparity by that of a plane fitted to the neighbours on its surface.

    Neighbours are weighted by the precision of their match and by distance: precise points hardly
    change, and uncertain ones follow their neighbours.
    """
    rows, columns = kept.shape
    steps = _SMOOTHING_STEPS
    # A row of neighbours, -1 beyond the grid, and their variances.
    there = np.full(columns + 2 * steps, -1.0, np.float32)
    variance = np.ones(there.size, np.float32)
    # Sums over one row of neighbours: weights w, w x, w x x, w d and w d x, with the distance x in
    # the row and the difference d of disparities.
    sums = np.empty((5, columns), np.float32)
    # Sums over all rows; see `_add_row`.
    moments = np.empty((9, columns), np.float32)
    for row in range(start, stop):
        moments[:] = 0
        here = kept[row]
        for y in range(row - steps, row + steps + 1, _SMOOTHING_STRIDE):
            if not 0 <= y < rows:
                continue
            there[steps : steps + columns] = kept[y]
            for x in range(columns):
                variance[steps + x] = deviation[y, x] * deviation[y, x]
            sums[:] = 0
            for shift in range(-steps, steps + 1, _SMOOTHING_STRIDE):
                rough = _LEAST_VARIANCE + _ROUGHNESS**2 * (shift**2 + (y - row) ** 2)
                _add_neighbours(
                    here, there, variance, np.uint64(steps + shift), np.float32(rough),
                    np.float32(shift), sums)
            _add_row(sums, np.float32(y - row), moments)
        for column in range(columns):
            d = kept[row, column]
            smoothed[row, column] = -1.0
            if d >= 0:
                smoothed[row, column] = max(d + _plane_at_origin(moments[:, column]), 0.0)


@njit(nogil=True, error_model="numpy")
def _add_neighbours(
    here: Any, there: Any, variance: Any, first: Any, rough: Any, across: Any, sums: Any
) -> None:
    """Add one neighbour of each point of a row to the sums of `smooth`."""
    for x in range(here.size):
        at = np.uint64(x) + first
        difference = there[at] - here[x]
        same = (abs(difference) <= _SAME_SURFACE) & (there[at] >= 0)
        weight = np.float32(1) / (variance[at] + rough)
        weight = weight if same else np.float32(0)
        product = weight * difference
        sums[0, x] += weight
        sums[1, x] += weight * across
        sums[2, x] += weight * across * across
        sums[3, x] += product
        sums[4, x] += product * across


@njit(nogil=True, error_model="numpy")
def _add_row(sums: Any, down: Any, moments: Any) -> None:
    """Add the sums over one row of neighbours to the moments: 1, x, y, xx, xy, yy, d, dx, dy."""
    for x in range(sums.shape[1]):
        weight, across, difference = sums[0, x], sums[1, x], sums[3, x]
        moments[0, x] += weight
        moments[1, x] += across
        moments[2, x] += weight * down
        moments[3, x] += sums[2, x]
        moments[4, x] += across * down
        moments[5, x] += weight * down * down
        moments[6, x] += difference
        moments[7, x] += sums[4, x]
        moments[8, x] += difference * down


@njit(nogil=True, error_model="numpy", inline="always")
def _plane_at_origin(moments: Any) -> Any:
    """Value at the point itself of the plane fitted to its neighbours, by Cramer's rule."""
    s, sx, sy = np.float64(moments[0]), np.float64(moments[1]), np.float64(moments[2])
    sxx, sxy = moments[3] + _SLOPE_RIDGE * s, np.float64(moments[4])
    syy = moments[5] + _SLOPE_RIDGE * s
    b, bx, by = np.float64(moments[6]), np.float64(moments[7]), np.float64(moments[8])
    minor, minor_x, minor_y = sxx * syy - sxy**2, sx * syy - sxy * sy, sx * sxy - sxx * sy
    determinant = s * minor - sx * minor_x + sy * minor_y
    return (b * minor - sx * (bx * syy - sxy * by) + sy * (bx * sxy - sxx * by)) / determinant


@njit(nogil=True)
def mark_vertices(start: int, stop: int, kept: Any, vertices: Any) -> None:
    """Mark a lattice of points, and those that differ from their neighbours."""
    for row in range(start, stop):
        for column in range(kept.shape[1]):
            if kept[row, column] < 0:
                vertices[row, column] = False
            elif row % _LATTICE == 0 and column % _LATTICE == 0:
                vertices[row, column] = True
            else:
                vertices[row, column] = _stands_out(kept, row, column)


@njit(nogil=True)
def _stands_out(kept: Any, row: int, column: int) -> bool:
    """Whether a neighbour differs, or more than one is missing, as at a region's border."""
    missing = 0
    for down, across in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        difference = _step_to(kept, row, column, down, across)
        if difference > _FLAT:
            return True
        if difference < 0:
            missing += 1
    return missing > 1


@njit(nogil=True)
def _step_to(kept: Any, row: int, column: int, down: int, across: int) -> float:
    """Absolute difference to the nearest point in a direction; -1 if none is near."""
    for steps in range(1, _NEIGHBOUR_STEPS + 1):
        y, x = row + steps * down, column + steps * across
        if 0 <= y < kept.shape[0] and 0 <= x < kept.shape[1] and kept[y, x] >= 0:
            return float(abs(kept[y, x] - kept[row, column]))
    return -1.0
