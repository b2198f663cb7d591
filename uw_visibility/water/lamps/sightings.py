# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Light of ground points that are tracked over frames."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Mask

# Half the width of the ground about a point whose light is taken, m: a tracker prefers spots
# that differ from what is about them, and loses some of that on its way, so that light of
# narrow patches drifts with range. As a part of the image's height at most, and px at least.
PATCH, WIDEST, NARROWEST = 0.16, 1 / 6, 2.0
# Ranges read along a patch's side; the part of them that has to be known, and to lie within
# so much of a plane.
ACROSS, KNOWN_PART, OFF_PLANE = 9, 0.5, 0.1
# Part of a patch that may be saturated; least mean irradiance.
SATURATED_PART, DARKEST = 0.01, 3.0 / 255
# Parts of the image, along and across.
TILES = 4


@dataclass(frozen=True)
class Sightings:
    """Points of the ground as frames saw them.

    Attributes
    ----------
    light : (N, 3) float64 ndarray
        Mean linear irradiance around the point, RGB.
    direction, normal : (N, 3) float64 ndarray
        Unit vectors: line of sight, and the ground's normal, towards the camera.
    range : (N,) float64 ndarray
        m.
    spread : (N,) float64 ndarray
        Half the width of the patch that the light is the mean of, over the range.
    track, tile : (N,) int64 ndarray
        Number of the point, and its part of the image.
    """

    light: Array
    direction: Array
    normal: Array
    range: Array
    spread: Array
    track: NDArray[np.int64]
    tile: NDArray[np.int64]


def observe_points(
    irradiance: NDArray[np.float32], saturated: Mask,
    range_map: NDArray[np.float32], rays: Array, points: Array, tracks: NDArray[np.int64],
) -> Sightings:
    """Light and place of points (N, 2: column and row, px) in one image; bad ones are left out.

    Takes linear irradiance (H, W, 3), pixels with a saturated channel, range, m, NaN where unknown,
    unit directions (H, W, 3), and the numbers of the points, (N,).
    """
    height, width = range_map.shape
    size = np.array([width, height])
    # Focal length, px, from the rays.
    scale = 1.0 / float(np.linalg.norm(rays[height // 2, width // 2 + 1]
                                       - rays[height // 2, width // 2]))
    inside = ((points >= 0) & (points <= size - 1)).all(axis=1)
    points, tracks = points[inside], tracks[inside]
    column, row = np.rint(points.T).astype(int)
    distance = range_map[row, column].astype(np.float64)
    # The same ground in all frames.
    half = np.clip(
        PATCH * scale / np.where(distance > 0, distance, np.inf), NARROWEST, WIDEST * height)
    # The sum over a patch needs a pixel's edge beyond it.
    kept = (distance > 0) & (points >= half[:, None]).all(axis=1) & (
        points <= size - 1 - half[:, None]).all(axis=1)
    points, tracks, half, column, row = (each[kept] for each in (points, tracks, half, column, row))
    normal, distance, plane = _planes(range_map, rays, points, half)
    area = 4.0 * half**2
    light = _box_sums(irradiance, points, half) / area[:, None]
    clipped = _box_sums(saturated.astype(np.float32)[..., None], points, half)[:, 0] / area
    good = plane & (clipped <= SATURATED_PART) & (light.min(axis=1, initial=1.0) >= DARKEST)
    tile = row * TILES // height * TILES + column * TILES // width
    return Sightings(
        light[good], rays[row, column][good], normal[good], distance[good],
        half[good] / scale, tracks[good], tile[good].astype(np.int64))


def _planes(
    ranges: NDArray[np.float32], rays: Array, points: Array, half: Array
) -> tuple[Array, Array, Mask]:
    """Unit normals towards the camera, ranges and validity of planes fitted around points.

    On a plane n·u = 1/d.
    """
    steps = np.linspace(-1.0, 1.0, ACROSS)
    columns = np.rint(points[:, :1] + half[:, None] * np.tile(steps, ACROSS)).astype(int)
    rows = np.rint(points[:, 1:] + half[:, None] * np.repeat(steps, ACROSS)).astype(int)
    away = rays[rows, columns]
    inverse = 1.0 / ranges[rows, columns].astype(np.float64)
    weight = np.isfinite(inverse).astype(np.float64)
    inverse = np.where(weight > 0, inverse, 0.0)
    enough = weight.mean(axis=1) >= KNOWN_PART
    plane = np.zeros((len(points), 3))
    for _ in range(2):
        weighted = away * weight[..., None]
        square = np.einsum("nki,nkj->nij", weighted, away) + 1e-9 * np.eye(3)
        plane = np.linalg.solve(square, np.einsum("nki,nk->ni", weighted, inverse)[..., None])[
            ..., 0]
        close = np.abs(np.einsum("nki,ni->nk", away, plane) - inverse) < OFF_PLANE * inverse
        weight = weight * close
    enough &= weight.mean(axis=1) >= KNOWN_PART
    middle = np.einsum("ni,ni->n", away[:, ACROSS**2 // 2], plane)
    enough &= middle > 0
    length = np.maximum(np.linalg.norm(plane, axis=1), 1e-12)
    return -plane / length[:, None], 1.0 / np.where(enough, middle, 1.0), enough


def _box_sums(image: NDArray[np.float32], points: Array, half: Array) -> Array:
    """Sum of (H, W, C) over squares around points, with parts of pixels, (N, C)."""
    summed = cv2.integral(image, sdepth=cv2.CV_64F).reshape(
        image.shape[0] + 1, image.shape[1] + 1, -1)
    # A pixel's middle is half a pixel from its edge.
    low, high = points + 0.5 - half[:, None], points + 0.5 + half[:, None]

    def at(x: Array, y: Array) -> Array:
        i = np.clip(x.astype(int), 0, image.shape[1] - 1)
        j = np.clip(y.astype(int), 0, image.shape[0] - 1)
        fx, fy = (x - i)[:, None], (y - j)[:, None]
        return np.asarray(
            (1 - fy) * ((1 - fx) * summed[j, i] + fx * summed[j, i + 1])
            + fy * ((1 - fx) * summed[j + 1, i] + fx * summed[j + 1, i + 1]))

    return (at(high[:, 0], high[:, 1]) - at(low[:, 0], high[:, 1])
            - at(high[:, 0], low[:, 1]) + at(low[:, 0], low[:, 1]))
