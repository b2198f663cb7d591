# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dominant plane of a scene in disparity space (RANSAC, doi 10.1145/358669.358692)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, DisparityMap

HYPOTHESES = 256
# Points that hypotheses are counted on; more make it slower, not surer.
MOST_POINTS = 1000
REFITS = 3
# How far (px of disparity) a point on the plane may lie off it.
TOLERANCE = 1.0
# Where the mesh covers more of the image than this, no plane is needed.
MOST_COVERAGE = 0.5


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
    planes = _hypotheses(finite[random.integers(0, len(finite), (HYPOTHESES, 3))])
    if not len(planes):
        return None
    some = finite
    if len(finite) > MOST_POINTS:
        some = finite[random.permutation(len(finite))[:MOST_POINTS]]
    single = some.astype(np.float32)
    coordinates = np.column_stack([single[:, :2], np.ones(len(single), np.float32)])
    distance = np.abs(planes.astype(np.float32) @ coordinates.T - single[:, 2])
    best = planes[np.argmax((distance <= TOLERANCE).sum(axis=1))]
    return _refit(finite, best)


def fill_plane(disparity: DisparityMap, points: NDArray[np.floating]) -> NDArray[np.float32]:
    """Dominant plane of the support points in place of what a thin mesh leaves open (section II-E).

    Returns a new map. Covered pixels keep their disparity; NaN stays where the plane's
    is not positive (above the horizon), and everywhere without a plane.
    """
    filled = disparity.copy()
    open_pixels = np.isnan(disparity)
    if 1.0 - open_pixels.mean() > MOST_COVERAGE:
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
    inliers = np.abs(coordinates @ plane - points[:, 2]) <= TOLERANCE
    for _ in range(REFITS):
        fitted = np.linalg.lstsq(coordinates[inliers], points[inliers, 2], rcond=None)[0]
        again = np.abs(coordinates @ fitted - points[:, 2]) <= TOLERANCE
        if again.sum() < inliers.sum():
            break
        plane, inliers = fitted, again
    return plane
