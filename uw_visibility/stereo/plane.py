# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dominant plane of a scene in disparity space (RANSAC, doi 10.1145/358669.358692)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

HYPOTHESES = 256
# Points that hypotheses are counted on; more make it slower, not surer.
MOST_POINTS = 1000
REFITS = 3


@dataclass(frozen=True)
class DisparityPlane:
    """Plane in space, as disparity that is linear in the pixel.

    Attributes
    ----------
    slope_x, slope_y, offset : float
        disparity = slope_x x + slope_y y + offset, px.
    inliers : int
        Points that lie on it.
    share : float
        Their share of all points.
    """

    slope_x: float
    slope_y: float
    offset: float
    inliers: int
    share: float

    def disparity(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """(H, W) float32: the plane's disparity at every pixel, also where it is negative."""
        x = np.float32(self.slope_x) * np.arange(shape[1], dtype=np.float32)
        y = np.float32(self.slope_y) * np.arange(shape[0], dtype=np.float32)
        return x + (y + np.float32(self.offset))[:, np.newaxis]


def dominant_plane(
    points: NDArray[np.floating], tolerance: float = 1.0, seed: int = 0
) -> DisparityPlane | None:
    """RANSAC fit of the plane that most points lie on.

    Parameters
    ----------
    points : (N, 3) ndarray
        x, y and disparity, px.
    tolerance : float
        How far (px of disparity) a point on the plane may lie off it.
    seed : int
        Seeds the draw: the same points give the same plane.

    Returns
    -------
    DisparityPlane or None
        None if fewer than three points, or all on one line.
    """
    finite = np.asarray(points, dtype=np.float64)
    finite = finite[np.isfinite(finite).all(axis=1)]
    if len(finite) < 3:
        return None
    random = np.random.default_rng(seed)
    planes = _hypotheses(finite[random.integers(0, len(finite), (HYPOTHESES, 3))])
    if not len(planes):
        return None
    some = finite
    if len(finite) > MOST_POINTS:
        some = finite[random.permutation(len(finite))[:MOST_POINTS]]
    single = some.astype(np.float32)
    coordinates = np.column_stack([single[:, :2], np.ones(len(single), np.float32)])
    distance = np.abs(planes.astype(np.float32) @ coordinates.T - single[:, 2])
    best = planes[np.argmax((distance <= tolerance).sum(axis=1))]
    return _refit(finite, best, tolerance)


def fill_plane(
    disparity: NDArray[np.float32],
    points: NDArray[np.floating],
    max_coverage: float = 0.5,
    tolerance: float = 1.0,
    seed: int = 0,
) -> tuple[NDArray[np.float32], DisparityPlane | None]:
    """Dominant plane in place of what a thin mesh leaves open (section II-E).

    Parameters
    ----------
    disparity : (H, W) float32 ndarray
        The mesh's disparity, px; NaN = not covered.
    points : (N, 3) ndarray
        The support points: x, y, disparity.
    max_coverage : float
        Where the mesh covers more of the image than this, it is left as it is.
    tolerance, seed : float, int
        See `dominant_plane`.

    Returns
    -------
    filled : (H, W) float32 ndarray
        A new map. Covered pixels keep their disparity; NaN stays where the plane's
        is not positive (above the horizon), and everywhere without a plane.
    plane : DisparityPlane or None
        The plane used; None where none was needed or found.
    """
    filled = disparity.copy()
    open_pixels = np.isnan(disparity)
    if 1.0 - open_pixels.mean() > max_coverage:
        return filled, None
    plane = dominant_plane(points, tolerance, seed)
    if plane is None:
        return filled, None
    values = plane.disparity((disparity.shape[0], disparity.shape[1]))
    np.copyto(filled, values, where=open_pixels & (values > 0))
    return filled, plane


def _hypotheses(triples: NDArray[np.float64]) -> NDArray[np.float64]:
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


def _refit(
    points: NDArray[np.float64], start: NDArray[np.float64], tolerance: float
) -> DisparityPlane:
    """Fit the plane to its inliers, a few times, as long as that does not lose any."""
    coordinates = np.column_stack([points[:, :2], np.ones(len(points))])
    plane = start
    inliers = np.abs(coordinates @ plane - points[:, 2]) <= tolerance
    for _ in range(REFITS):
        fitted = np.linalg.lstsq(coordinates[inliers], points[inliers, 2], rcond=None)[0]
        again = np.abs(coordinates @ fitted - points[:, 2]) <= tolerance
        if again.sum() < inliers.sum():
            break
        plane, inliers = fitted, again
    count = int(inliers.sum())
    slope_x, slope_y, offset = (float(value) for value in plane)
    return DisparityPlane(slope_x, slope_y, offset, count, count / len(points))
