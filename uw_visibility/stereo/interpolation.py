# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Disparity interpolation: gaps from the background, large areas by inpainting or a plane.

The plane is the dominant one of the scene in disparity space (RANSAC, doi
10.1145/358669.358692), for a thin mesh (section II-E).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array, DisparityMap
from uw_visibility.images.cells import fold, spread


def fill_gaps(
    disparity: DisparityMap, max_gap: int, workers: Workers
) -> NDArray[np.float32]:
    """Fill gaps within rows from the background, which is what most of them hide.

    Each takes the farther of its two sides in the row (Hirschmüller 2008, section 2.6.3, fills
    occlusions from there, too), if no pixel of it is more than `max_gap` px from either.

    disparity: (H, W) float32, px; NaN = a gap.
    Returns (H, W) float32, a new map; NaN stays in wider gaps.
    """
    filled = np.empty_like(disparity)
    workers.rows(_fill_rows, disparity.shape[0], disparity, 2 * max_gap, filled)
    return filled


@njit(nogil=True, error_model="numpy")
def _fill_rows(start: int, stop: int, disparity: Any, widest: int, filled: Any) -> None:
    for y in range(start, stop):
        fill_from_farther(disparity[y], widest, filled[y])


@njit(nogil=True, error_model="numpy")
def fill_from_farther(row: Any, widest: int, filled: Any) -> None:
    """Copy a row, and give gaps in it, NaN or -inf, the farther of their two sides.

    At the border there is one side only. Gaps of more than `widest` px become NaN.
    """
    width = row.size
    nothing = np.float32(-np.inf)
    last = nothing
    x = 0
    while x < width:
        if row[x] > nothing:
            last = row[x]
            filled[x] = last
            x += 1
            continue
        end = x
        while end < width and not row[end] > nothing:
            end += 1
        after = row[end] if end < width else nothing
        value = min(last, after)
        if value == nothing:
            value = max(last, after)
        filled[x:end] = value if value != nothing and end - x <= widest else np.float32(np.nan)
        x = end


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


# Planes that are tried.
_HYPOTHESES = 256
# Points that hypotheses are counted on; more make it slower, not surer.
_MOST_POINTS = 1000
_REFITS = 3
# How far (px of disparity) a point on the plane may lie off it.
_OFF_PLANE = 1.0
# Where the mesh covers more of the image than this, no plane is needed.
_MOST_COVERAGE = 0.5


def dominant_plane(points: NDArray[np.floating]) -> Array | None:
    """RANSAC fit of the plane that most points lie on; the same points give the same plane.

    Returns slopes along x and y and offset: disparity = a x + b y + c, px, for points (N, 3) of
    x, y and disparity; None for fewer than three points, or all on one line.
    """
    finite = np.asarray(points, dtype=np.float64)
    finite = finite[np.isfinite(finite).all(axis=1)]
    if len(finite) < 3:
        return None
    random = np.random.default_rng(0)
    planes = _hypotheses(finite[random.integers(0, len(finite), (_HYPOTHESES, 3))])
    if not len(planes):
        return None
    some = finite
    if len(finite) > _MOST_POINTS:
        some = finite[random.permutation(len(finite))[:_MOST_POINTS]]
    single = some.astype(np.float32)
    coordinates = np.column_stack([single[:, :2], np.ones(len(single), np.float32)])
    distance = np.abs(planes.astype(np.float32) @ coordinates.T - single[:, 2])
    best = planes[np.argmax((distance <= _OFF_PLANE).sum(axis=1))]
    return _refit(finite, best)


def fill_plane(disparity: DisparityMap, points: NDArray[np.floating]) -> NDArray[np.float32]:
    """Dominant plane of the support points in place of what a thin mesh leaves open (section II-E).

    Returns a new map. Covered pixels keep their disparity; NaN stays where the plane's
    is not positive (above the horizon), and everywhere without a plane.
    """
    filled = disparity.copy()
    open_pixels = np.isnan(disparity)
    if 1.0 - open_pixels.mean() > _MOST_COVERAGE:
        return filled
    plane = dominant_plane(points)
    if plane is None:
        return filled
    slope_x, slope_y, offset = plane.astype(np.float32)
    rows, columns = (np.arange(size, dtype=np.float32) for size in disparity.shape)
    values = slope_x * columns + (slope_y * rows + offset)[:, np.newaxis]
    np.copyto(filled, values, where=open_pixels & (values > 0))
    return filled


def _hypotheses(triples: Array) -> Array:
    """(K, 3): slopes and offset through each triple of points that spans a plane."""
    first = triples[:, 1] - triples[:, 0]
    second = triples[:, 2] - triples[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    spans = np.abs(area) > 1e-9
    origin, first, second, area = triples[spans, 0], first[spans], second[spans], area[spans]
    slope_x = (first[:, 2] * second[:, 1] - second[:, 2] * first[:, 1]) / area
    slope_y = (second[:, 2] * first[:, 0] - first[:, 2] * second[:, 0]) / area
    offset = origin[:, 2] - slope_x * origin[:, 0] - slope_y * origin[:, 1]
    return np.column_stack([slope_x, slope_y, offset])


def _refit(points: Array, start: Array) -> Array:
    """Fit the plane to its inliers, a few times, as long as that does not lose any."""
    coordinates = np.column_stack([points[:, :2], np.ones(len(points))])
    plane = start
    inliers = np.abs(coordinates @ plane - points[:, 2]) <= _OFF_PLANE
    for _ in range(_REFITS):
        fitted = np.linalg.lstsq(coordinates[inliers], points[inliers, 2], rcond=None)[0]
        again = np.abs(coordinates @ fitted - points[:, 2]) <= _OFF_PLANE
        if again.sum() < inliers.sum():
            break
        plane, inliers = fitted, again
    return plane
