# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filters on the grid of support points: implausible ones, noise, and flat regions.

Grids are ``(rows, columns)`` float32 disparities, px, negative where no point is.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.kernel_cache import njit

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


@njit(nogil=True)
def keep_consistent(
    start: int, stop: int, found: Any, cells: int, disparity: Any, count: int, kept: Any
) -> None:
    """Drop points that too few neighbours agree with (implausible matches)."""
    rows, columns = found.shape
    for row in range(start, stop):
        for column in range(columns):
            d = found[row, column]
            kept[row, column] = -1.0
            if d < 0:
                continue
            agreeing = -1
            for y in range(max(row - cells, 0), min(row + cells + 1, rows)):
                for x in range(max(column - cells, 0), min(column + cells + 1, columns)):
                    other = found[y, x]
                    if other >= 0 and abs(other - d) <= disparity:
                        agreeing += 1
            if agreeing >= count:
                kept[row, column] = d


@njit(nogil=True)
def smooth(start: int, stop: int, kept: Any, deviation: Any, smoothed: Any) -> None:
    """Replace each disparity by that of a plane through the neighbours on its surface.

    Neighbours count by how well their own match fixed them and by distance, so
    that a well textured point stays and a vague one follows its neighbours.
    """
    rows, columns = kept.shape
    steps = _SMOOTHING_STEPS
    for row in range(start, stop):
        for column in range(columns):
            d = kept[row, column]
            smoothed[row, column] = -1.0
            if d < 0:
                continue
            s, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            b, bx, by = 0.0, 0.0, 0.0
            for y in range(row - steps, row + steps + 1, _SMOOTHING_STRIDE):
                for x in range(column - steps, column + steps + 1, _SMOOTHING_STRIDE):
                    if not (0 <= y < rows and 0 <= x < columns):
                        continue
                    difference = kept[y, x] - d
                    if kept[y, x] < 0 or abs(difference) > _SAME_SURFACE:
                        continue
                    i, j = x - column, y - row
                    weight = 1.0 / (
                        deviation[y, x] ** 2 + _LEAST_VARIANCE
                        + _ROUGHNESS**2 * (i * i + j * j)
                    )
                    s += weight
                    sx += weight * i
                    sy += weight * j
                    sxx += weight * i * i
                    sxy += weight * i * j
                    syy += weight * j * j
                    b += weight * difference
                    bx += weight * difference * i
                    by += weight * difference * j
            sxx += _SLOPE_RIDGE * s
            syy += _SLOPE_RIDGE * s
            # Cramer's rule for the plane's value at the point itself.
            minor, minor_x, minor_y = sxx * syy - sxy**2, sx * syy - sxy * sy, sx * sxy - sxx * sy
            determinant = s * minor - sx * minor_x + sy * minor_y
            change = (
                b * minor - sx * (bx * syy - sxy * by) + sy * (bx * sxy - sxx * by)
            ) / determinant
            smoothed[row, column] = max(d + change, 0.0)


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
    """Whether a neighbour differs, or more than one is missing as at a region's border."""
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
