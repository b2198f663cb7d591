# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Disparity interpolation: gaps (Hirschmüller 2008), large areas by inpainting or a plane.

The plane is the dominant one of the scene in disparity space (RANSAC, doi
10.1145/358669.358692), for a thin mesh (section II-E).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, DisparityMap
from uw_visibility.images.cells import fold, spread

# Directions that one sweep over the rows looks in; along a row there are two more.
DIRECTIONS = 3
# How far (px) a disparity of the right map may miss a pixel of the left one and
# still count as lying on it.
TOLERANCE = 1
# Pairs that Batcher's network (doi 10.1145/1468075.1468121) compares: it sorts without branches.
_NETWORK = (
    (0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (1, 2), (5, 6),
    (0, 4), (1, 5), (2, 6), (3, 7), (2, 4), (3, 5), (1, 2), (3, 4), (5, 6))


def fill_gaps(
    left: DisparityMap, right: DisparityMap, max_gap: int, workers: Workers
) -> NDArray[np.float32]:
    """Discontinuity-preserving gap filling (Hirschmüller 2008, section 2.6.3).

    From the eight directions around each pixel, doi 10.1109/TPAMI.2007.1166. An occluded pixel
    takes the second lowest of what it sees, so it belongs to the background; a mismatched one
    takes their median, so a hole in the foreground stays foreground.

    left: (H, W) float32, left disparity map, px; NaN = a gap.
    right: (H, W) float32, right disparity map **before** the left/right check, positive px, NaN
        = unknown. Where none of its disparities points at a pixel, that pixel is occluded.
    max_gap: how far a pixel looks for disparities, px.
    Returns (H, W) float32, a new map; NaN stays where fewer than three directions meet a
    disparity within `max_gap`.
    """
    if left.shape != right.shape:
        raise InputError(f"disparity maps are of the shapes {left.shape} and {right.shape}")
    seen = np.empty((2, DIRECTIONS, *left.shape), np.float32)
    workers.rows(_sweep, 2, left, max_gap, seen)
    filled = np.empty_like(left)
    workers.rows(_choose, left.shape[0], left, right, max_gap, seen, filled)
    return filled


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
def _point_at(right: Any, hit: Any) -> None:
    """Mark the pixels of a row that a disparity of the right row points at, within `TOLERANCE`.

    ``hit`` reaches twice as many columns beyond the row on either side.
    """
    width = right.size
    hit[:] = False
    for q in range(width):
        d = right[q]
        # Comparisons with NaN are false.
        if d >= 0 and d <= width:
            x = q + index_of(d + np.float32(0.5), 0, width)
            if x < width + TOLERANCE:
                for near in range(x + TOLERANCE, x + 3 * TOLERANCE + 1):
                    hit[near] = True


@njit(nogil=True, error_model="numpy")
def _choose_of_eight(around: Any, hit: bool) -> Any:
    """Choose from the (8,) disparities around a gap, which are sorted; inf = none."""
    for i, j in _NETWORK:
        low, high = min(around[i], around[j]), max(around[i], around[j])
        around[i], around[j] = low, high
    count = 0
    while count < around.size and around[count] < np.inf:
        count += 1
    if count < 3:
        return np.float32(np.nan)
    # The lower one of two in the middle: always a value that was seen.
    return around[(count - 1) // 2] if hit else around[1]


@njit(nogil=True, error_model="numpy")
def _choose(
    start: int, stop: int, left: Any, right: Any, max_gap: int, seen: Any, filled: Any
) -> None:
    """Fill each gap from the up to eight disparities around it."""
    width = left.shape[1]
    nothing = np.float32(np.inf)
    hit = np.zeros(width + 4 * TOLERANCE, np.bool_)
    after = np.empty(width, np.float32)
    around = np.empty(2 * DIRECTIONS + 2, np.float32)
    for y in range(start, stop):
        here = left[y]
        _point_at(right[y], hit)
        value, age = nothing, 0
        for x in range(width - 1, -1, -1):
            age += 1
            if here[x] == here[x]:
                value, age = here[x], 0
            after[x] = value if age <= max_gap else nothing
        value, age = nothing, 0
        for x in range(width):
            age += 1
            filled[y, x] = here[x]
            if here[x] == here[x]:
                value, age = here[x], 0
                continue
            for k in range(DIRECTIONS):
                around[k] = seen[0, k, y, x]
                around[DIRECTIONS + k] = seen[1, k, y, x]
            around[2 * DIRECTIONS] = value if age <= max_gap else nothing
            around[2 * DIRECTIONS + 1] = after[x]
            filled[y, x] = _choose_of_eight(around, hit[x + 2 * TOLERANCE])


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
