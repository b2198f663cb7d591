# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rendered view of one camera without water: range and radiance for every ray.

Each square tile of the image has a list of the shapes that its rays may hit, which saves time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array, Map, Mask
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.raycast import (
    FLOOR,
    NOTHING,
    floor_distance,
    look_at,
    nearest_shape,
)
from uw_visibility_lab.simulation.scene import Scene

MAX_RANGE = 40.0
"""Range in m beyond which there is only water."""

EDGE = 0.02
"""Relative second difference of the inverse range between pixels that marks an edge."""

TILE = 16
"""Width of a tile in px."""


@dataclass(frozen=True)
class View:
    """One camera's view of a scene, in air: a sample for each pixel, and four more at edges.

    Those of the pixels come first, row by row, each through its pixel's middle; then those of the
    quarters of each edge pixel.
    """

    shape: tuple[int, int]  # rows and columns of the image
    pixel: NDArray[np.int64]  # (n,); index of each sample's pixel, row by row
    rays: Array  # (n, 3); unit directions of the pixels in the camera's optical frame
    ranges: Map  # (n,); distance along the ray in m; inf = open water
    radiance: Map  # (n, 3); normalised radiance in daylight at the ray's end; 0 for open water
    reflectance: Map  # (n, 3); reflectance there
    normals: Map  # (n, 3); outward unit normals there, in the world's axes
    eye: Array  # (3,); the camera's position in the world, m
    rotation: Array  # (3, 3); axes of its optical frame in the world, as columns

    @property
    def range(self) -> Map:
        """Distance along the ray through each pixel's middle in m, (H, W)."""
        return self.middles(self.ranges)

    def middles(self, values: Map) -> Map:
        """Return values of samples at the pixels' middles, (H, W, ...)."""
        return values[:math.prod(self.shape)].reshape(*self.shape, *values.shape[1:])

    def image(self, values: Map) -> Map:
        """Return values of samples (n, 3) as an image; edge pixels are means of their quarters."""
        pixels = math.prod(self.shape)
        image = values[:pixels].copy()
        image[self.pixel[pixels::4]] = values[pixels:].reshape(-1, 4, 3).mean(axis=1)
        return image.reshape(*self.shape, 3)


def look(
    scene: Scene, camera: StereoCamera, pose: Pose, workers: Workers, *, right: bool = False
) -> View:
    """Cast the rays of one camera: one per pixel, and four more where surfaces meet.

    Elsewhere one ray suffices, since textures are smoothed to the pixel's footprint.
    pose: of the left camera.
    """
    size, rotation = (camera.height, camera.width), pose.rotation()
    eye = np.array(pose.position) + right * camera.baseline * rotation[:, 0]
    bounds = scene.shapes[:, [1, 2, 3, 16]]
    tiles = assign_to_tiles(bounds, camera, eye, rotation)
    optics = np.array([camera.focal_length, *camera.principal_point])

    def cast(rows: Array, columns: Array) -> tuple[Map, NDArray[np.int32], Map]:
        """Range, surface, and values of `look_at` for rays through points of the image."""
        ranges, hits = np.empty(rows.size, np.float32), np.empty(rows.size, np.int32)
        seen = np.zeros((rows.size, 9), np.float32)
        if rows.size > 0:
            workers.rows(
                _cast, rows.size, scene, tiles, eye, rotation, optics, columns, rows, ranges, hits,
                seen)
        return ranges, hits, seen

    v, u = (part.ravel() for part in np.indices(size, np.float64))
    ranges, hits, seen = cast(v, u)
    edges = np.flatnonzero(_edges(ranges.reshape(size), hits.reshape(size)))
    pixel = np.concatenate([np.arange(ranges.size), np.repeat(edges, 4)])
    quarters = pixel[ranges.size:]
    part_ranges, _, part_seen = cast(
        v[quarters] + np.tile([-0.25, -0.25, 0.25, 0.25], edges.size),
        u[quarters] + np.tile([-0.25, 0.25, -0.25, 0.25], edges.size))
    radiance, reflectance, normals = map(
        np.ascontiguousarray, np.split(np.concatenate([seen, part_seen]), 3, axis=1))
    return View(
        size, pixel, camera.rig.ray_directions(size).reshape(-1, 3)[pixel],
        np.concatenate([ranges, part_ranges]), radiance, reflectance, normals, eye, rotation)


def _edges(ranges: Map, hits: NDArray[np.int32]) -> Mask:
    """Mark pixels whose neighbours' rays hit another surface, or where the surface folds."""
    edges = np.zeros(hits.shape, np.bool_)
    inverse = 1.0 / ranges
    for hit, near, edge in ((hits, inverse, edges), (hits.T, inverse.T, edges.T)):
        other = hit[1:] != hit[:-1]
        edge[1:] |= other
        edge[:-1] |= other
        bend = np.abs(near[2:] + near[:-2] - 2.0 * near[1:-1])
        edge[1:-1] |= bend > EDGE * near[1:-1]
    return edges


@njit(nogil=True, error_model="numpy")
def _cast(
    start: int, stop: int, scene: Scene, tiles: Tiles, eye: Any, rotation: Any, optics: Any,
    columns: Any, rows: Any, ranges: Any, hits: Any, seen: Any,
) -> None:
    """Cast the rays through points of the image."""
    for k in range(start, stop):
        u, v = columns[k], rows[k]
        x, y = (u - optics[1]) / optics[0], (v - optics[2]) / optics[0]
        length = 1.0 / math.sqrt(x * x + y * y + 1.0)
        dx = (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]) * length
        dy = (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]) * length
        dz = (rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]) * length
        tile = (int(v + 0.5) // TILE) * tiles.columns + int(u + 0.5) // TILE
        candidates = tiles.shapes[tiles.offsets[tile]:tiles.offsets[tile + 1]]
        t, hit = nearest_shape(scene.shapes, candidates, eye[0], eye[1], eye[2], dx, dy, dz)
        floor = floor_distance(scene, eye, dx, dy, dz, min(t, MAX_RANGE))
        if floor < min(t, MAX_RANGE):
            t, hit = floor, FLOOR
        elif t > MAX_RANGE:
            t, hit = math.inf, NOTHING
        if hit != NOTHING:
            look_at(
                scene, hit, eye[0] + t * dx, eye[1] + t * dy, eye[2] + t * dz,
                t / optics[0], (dx, dy, dz), seen[k],
            )
        ranges[k], hits[k] = t, hit


class Tiles(NamedTuple):
    """Concatenated lists of the shapes of each tile."""

    columns: int  # tiles in a row of tiles
    offsets: NDArray[np.int64]  # (tiles + 1,); where a tile's list starts in `shapes`
    shapes: NDArray[np.int32]  # (n,); indices of shapes


def assign_to_tiles(bounds: Array, camera: StereoCamera, eye: Array, rotation: Array) -> Tiles:
    """List the shapes of each tile: those whose bounding sphere (n, 4) may be visible in it."""
    offset = bounds[:, :3] - eye
    radius = bounds[:, 3]
    x, y, z = (offset @ rotation).T
    seen = (z > -radius) & (np.linalg.norm(offset, axis=1) - radius < MAX_RANGE)
    index = np.flatnonzero(seen)
    x, y, z, radius = x[index], y[index], z[index], radius[index]
    near, far = np.maximum(z - radius, 1e-3), z + radius

    def span(middle: Array, centre: float, tiles: int) -> NDArray[np.int64]:
        """First and last tile of each sphere's projection; first is last + 1 if there is none."""
        low, high = middle - radius, middle + radius
        first = low / np.where(low < 0.0, near, far)
        last = high / np.where(high > 0.0, near, far)
        edges = np.stack([first, last]) * camera.focal_length + centre
        edges += np.array([[-1.0], [1.0]])
        edges = np.clip(np.floor(edges / TILE), [[0], [-1]], [[tiles], [tiles - 1]])
        return edges.astype(np.int64)

    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    left, right = span(x, camera.principal_point[0], columns)
    top, below = span(y, camera.principal_point[1], rows)
    width = right - left + 1
    count = width * (below - top + 1)
    # Repeat each shape for its tiles, which are numbered row by row.
    shape = np.repeat(np.arange(len(index)), count)
    number = np.arange(len(shape)) - np.repeat(np.cumsum(count) - count, count)
    tile = (top[shape] + number // width[shape]) * columns + left[shape] + number % width[shape]
    offsets = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=columns * rows))])
    return Tiles(columns, offsets, index[shape[np.argsort(tile, kind="stable")]].astype(np.int32))
