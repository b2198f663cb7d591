# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Delaunay mesh of the support points, and its disparity at every pixel."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap, Points

# Margin around the image in which the mesh is built, image widths and heights.
_FRAME = 20
# Slopes of disparity, along rows and along columns, above which a triangle spans a depth step
# rather than a surface. The disparity gradient limit of a surface that both views see is 1
# (Pollard, Mayhew and Frisby 1985, doi:10.1068/p140449); most triangles steeper than a fifth of it
# along a row bridge a step whose two sides are a few support points apart.
_STEEP_ROW, _STEEP_COLUMN = np.float32(0.2), np.float32(0.5)
# Rounds of insertion, and the side of the cells of the space-filling curve, px.
_ROUNDS = 8
_NEAR = 4


def with_corners(points: Points, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Add the image's four corners, each with the disparity of the nearest of the points (N, 3)."""
    height, width = shape
    corners = np.array(
        [[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float32
    )
    distance = np.sum((corners[:, None] - points[None, :, :2]) ** 2, axis=2)
    nearest = points[np.argmin(distance, axis=1), 2:]
    return np.vstack([points, np.hstack([corners, nearest])])


def triangulate(points: Points, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Delaunay triangulation of distinct points (N, 3) at whole pixels: u, v, disparity.

    Returns the triangles' corners, ``(M, 3, 3)`` float32; none for fewer than three points.
    """
    height, width = shape
    if len(points) < 3:
        return np.empty((0, 3, 3), np.float32)
    # The subdivision starts from one large triangle around this frame. The larger it is, the fewer
    # triangles at the points' convex hull are lost.
    subdivision = cv2.Subdiv2D((-_FRAME * width, -_FRAME * height,
                                (2 * _FRAME + 1) * width, (2 * _FRAME + 1) * height))
    subdivision.insert(points[_insertion_order(points), :2])
    corners = np.asarray(subdivision.getTriangleList(), np.float32).reshape(-1, 3, 2)
    inside = np.all(
        (corners >= 0) & (corners <= np.array([width - 1, height - 1], np.float32)), axis=(1, 2)
    )
    corners = corners[inside]
    # The subdivision returns positions of corners: their points are looked up by pixel.
    index = np.full((height, width), -1, np.int32)
    whole = points[:, :2].astype(np.int32)
    index[whole[:, 1], whole[:, 0]] = np.arange(len(points), dtype=np.int32)
    at = corners.astype(np.int32)
    return points[index[at[..., 1], at[..., 0]]]


def _insertion_order(points: Points) -> NDArray[np.intp]:
    """Insertion order in which the subdivision takes few steps.

    A biased randomised insertion order (Amenta, Choi and Rote, SoCG 2003,
    doi:10.1145/777792.777824): each round has about twice as many points as the one before, in the
    order of a space-filling curve. The round of a point is drawn by a hash of its position.
    """
    u, v = points[:, 0].astype(np.uint32), points[:, 1].astype(np.uint32)
    draw = (u * np.uint32(0x9E3779B1) ^ v * np.uint32(0x85EBCA77)) * np.uint32(0xC2B2AE3D)
    draw >>= np.uint32(32 - _ROUNDS)
    # The highest bit that is set: each round has half as many as the one after it.
    last_round = np.frexp(draw.astype(np.float64))[1]
    curve = _every_second_bit(u // _NEAR) | _every_second_bit(v // _NEAR) << np.uint32(1)
    return np.lexsort((curve, last_round))


def _every_second_bit(value: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Spread 16 bits over the even ones of 32, for a Z-order curve."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        value = (value | value << np.uint32(shift)) & np.uint32(mask)
    return value


def rasterize(
    triangles: NDArray[np.float32],
    disparity: DisparityMap,
    workers: Workers,
    steep: NDArray[np.bool_] | None = None,
) -> None:
    """Write the disparity of the mesh at every pixel that it covers, and NaN elsewhere.

    `steep` (H, W) is set where the mesh bridges a depth step.
    """
    marks = np.empty((0, 0), np.bool_) if steep is None else steep
    workers.rows(_rasterize, disparity.shape[0], triangles, disparity, marks)


@njit(nogil=True)
def _rasterize(start: int, stop: int, triangles: Any, disparity: Any, steep: Any) -> None:
    width = disparity.shape[1]
    marked = steep.size > 0
    for y in range(start, stop):
        for x in range(width):
            disparity[y, x] = np.nan
        if marked:
            steep[y] = False
    for t in range(triangles.shape[0]):
        x0, y0, d0 = triangles[t, 0]
        x1, y1, d1 = triangles[t, 1]
        x2, y2, d2 = triangles[t, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0.0:
            continue
        slope_x = ((d1 - d0) * (y2 - y0) - (d2 - d0) * (y1 - y0)) / area
        slope_y = ((d2 - d0) * (x1 - x0) - (d1 - d0) * (x2 - x0)) / area
        step = marked and (abs(slope_x) > _STEEP_ROW or abs(slope_y) > _STEEP_COLUMN)
        first = index_of(min(y0, y1, y2), start, stop)
        last = index_of(max(y0, y1, y2), start - 1, stop - 1)
        for y in range(first, last + 1):
            low = np.float32(width)
            high = np.float32(-1.0)
            for edge in range(3):
                ax, ay, _ = triangles[t, edge]
                bx, by, _ = triangles[t, (edge + 1) % 3]
                if y < min(ay, by) or y > max(ay, by):
                    continue
                if ay == by:
                    low = min(low, ax, bx)
                    high = max(high, ax, bx)
                else:
                    x_edge = ax + (y - ay) * (bx - ax) / (by - ay)
                    low = min(low, x_edge)
                    high = max(high, x_edge)
            for x in range(index_of(np.ceil(low), 0, width), index_of(high, -1, width - 1) + 1):
                disparity[y, x] = d0 + slope_x * (x - x0) + slope_y * (y - y0)
                if step:
                    steep[y, x] = True
