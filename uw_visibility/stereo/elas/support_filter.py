# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filters on the grid of support points: implausible ones, noise, and flat regions.

Grids are ``(rows, columns)`` float32 disparities, px, negative where no point is.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit

# The mesh keeps every eighth grid point at least, so that planes drift nowhere.
_LATTICE = 8
# A neighbour on the grid is looked for this many steps away.
_NEIGHBOUR_STEPS = 2
# Points that differ less than this from their neighbours add nothing to the mesh, px.
_FLAT = np.float32(1.0)
# Smoothing takes neighbours this many grid points away,
_SMOOTHING_STEPS = 8
# every second of them, which loses nothing that is measurable,
_SMOOTHING_STRIDE = 2
# whose disparity differs by at most this, px,
_SAME_SURFACE = np.float32(3.0)
# and trusts them less by this much for each grid point of distance, px.
_ROUGHNESS = 0.2
# Squared deviation of the best of matches, px^2, and weight against steep planes.
_LEAST_VARIANCE = 0.01
_SLOPE_RIDGE = 0.5


@njit(nogil=True, error_model="numpy")
def keep_consistent(
    start: int, stop: int, found: Any, cells: int, disparity: Any, count: int, kept: Any
) -> None:
    """Consistency filter: drop points that too few neighbours agree with."""
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
    """Count one neighbour of each point of a row; all at once, since that makes vector code.

    Rows come whole, and places as unsigned numbers: for slices numba counts references, which
    takes as long as the count, and places below zero would be looked at.
    """
    for x in range(first, last):
        i, j = np.uint64(x), np.uint64(x + shift)
        near = abs(there[j] - here[i]) <= disparity
        agreeing[i] += np.int32(1) if near and there[j] >= 0 else np.int32(0)


@njit(nogil=True, error_model="numpy")
def smooth(start: int, stop: int, kept: Any, deviation: Any, smoothed: Any) -> None:
    """Replace each disparity by that of a plane through the neighbours on its surface.

    Neighbours count by how well their own match fixed them and by distance, so
    that a well textured point stays and a vague one follows its neighbours.
    """
    rows, columns = kept.shape
    steps = _SMOOTHING_STEPS
    # A row of neighbours and their variances; beyond the grid there is none.
    there = np.full(columns + 2 * steps, -1.0, np.float32)
    variance = np.ones(there.size, np.float32)
    # Sums over the neighbours of one row: of weights, of weights times the step across
    # and its square, of weighted differences, and of those times the step across.
    sums = np.empty((5, columns), np.float32)
    # The same over all rows, with the step down besides.
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


@njit(nogil=True, error_model="numpy")
def _plane_at_origin(moments: Any) -> Any:
    """Value at the point itself of the plane through its neighbours, by Cramer's rule."""
    s, sx, sy = np.float64(moments[0]), np.float64(moments[1]), np.float64(moments[2])
    sxx, sxy = moments[3] + _SLOPE_RIDGE * s, np.float64(moments[4])
    syy = moments[5] + _SLOPE_RIDGE * s
    b, bx, by = np.float64(moments[6]), np.float64(moments[7]), np.float64(moments[8])
    minor, minor_x, minor_y = sxx * syy - sxy**2, sx * syy - sxy * sy, sx * sxy - sxx * sy
    determinant = s * minor - sx * minor_x + sy * minor_y
    return (b * minor - sx * (bx * syy - sxy * by) + sy * (bx * sxy - sxx * by)) / determinant


@njit(nogil=True)
def mark_vertices(start: int, stop: int, kept: Any, vertices: Any) -> None:
    """Mark a lattice of points, and those that are not flat between their neighbours."""
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
    """Tell whether a neighbour differs, or more than one is missing as at a region's border."""
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
    """Difference to the nearest point in a direction; -1 where none is near."""
    for steps in range(1, _NEIGHBOUR_STEPS + 1):
        y, x = row + steps * down, column + steps * across
        if 0 <= y < kept.shape[0] and 0 <= x < kept.shape[1] and kept[y, x] >= 0:
            return float(abs(kept[y, x] - kept[row, column]))
    return -1.0
