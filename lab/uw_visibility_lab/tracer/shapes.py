# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Mesh of a simulated reef, with a reflectance at each vertex, as fine as one camera sees it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Map
from uw_visibility_lab.simulation.raycast import FLOOR, look_at, on_floor
from uw_visibility_lab.simulation.scene import Scene
from uw_visibility_lab.simulation.shapes import CAPSULE

SECTOR = np.pi / 4.0
"""Half of the directions that are seen, rad."""

RINGS, SPOKES = 400, 560
"""Of the floor's mesh."""

FINENESS = (2, 60)
"""Subdivisions of a thing's mesh along a side of a cube, at least and at most."""

CLEARANCE = 0.6
"""What comes nearer to the camera is left out, m."""


@dataclass(frozen=True)
class Mesh:
    """Triangle mesh."""

    vertices: Array  # (N, 3) float64; x ahead of the camera, y to its left, z up, m
    faces: Array  # (M, 3) uint32
    reflectance: Map  # (N, 3); RGB, 0 .. 1


def mesh_of(scene: Scene, eye: Array) -> Mesh:
    """Return floor and things, as a camera above x = y = 0 looks at them ahead.

    A capsule is an ellipsoid as long.

    eye: the camera's place, (3,), m.
    """
    points, spacing = polar_grid(0.2, 60.0, RINGS, SPOKES)
    parts, faces, met = [points], [grid_faces(RINGS, SPOKES)], [np.full(len(points), FLOOR)]
    steps, count = [spacing], len(points)
    for index, row in enumerate(scene.shapes):
        centre, axes, half, bound = row[1:4], row[4:13].reshape(3, 3), row[13:16], row[16]
        away = float(np.linalg.norm(centre - eye))
        if away - bound < CLEARANCE:
            continue
        if row[0] == CAPSULE:
            half = half + np.array([0.0, 0.0, half[0]])
        subdivisions = int(np.clip(bound / away * 250.0, *FINENESS))
        unit, corners = sphere(subdivisions)
        parts.append(centre + (unit * half) @ axes)
        faces.append(corners + count)
        met.append(np.full(len(unit), index))
        steps.append(np.full(len(unit), 1.6 * bound / subdivisions))
        count += len(unit)
    vertices = np.concatenate(parts)
    reflectance = np.zeros((count, 3), np.float32)
    _paint(scene, eye, np.concatenate(met), np.concatenate(steps), vertices, reflectance)
    return Mesh(vertices, np.concatenate(faces).astype(np.uint32), reflectance)


@njit(nogil=True, error_model="numpy")
def _paint(
    scene: Scene, eye: Any, met: Any, spacing: Any, vertices: Any, reflectance: Any
) -> None:
    """Lift the floor's vertices to its height, and give all of them their reflectance."""
    seen = np.zeros(9)
    for k in range(len(vertices)):
        x, y = vertices[k, 0], vertices[k, 1]
        if met[k] == FLOOR:
            vertices[k, 2] = on_floor(scene, scene.heights, x, y)
        ray = vertices[k] - eye
        ray /= np.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
        look_at(
            scene, met[k], x, y, vertices[k, 2], spacing[k], (ray[0], ray[1], ray[2]), seen)
        for channel in range(3):
            reflectance[k, channel] = seen[3 + channel]


def grid_faces(rows: int, columns: int) -> Array:
    """Return the triangles of a grid of vertices in row-major order, (M, 3)."""
    corner = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, :-1].ravel()
    return np.concatenate([
        np.stack([corner, corner + columns, corner + 1], -1),
        np.stack([corner + 1, corner + columns, corner + columns + 1], -1),
    ])


def polar_grid(
    nearest: float, farthest: float, rings: int, rays: int,
) -> tuple[Array, Array]:
    """Points of the plane at steps that grow with their distance, as pixels see them.

    nearest, farthest: radii, m.
    rings, rays: how many; an eighth of the rays is outside of `SECTOR`.
    Returns `points`, (rings × rays, 3) float64, z = 0, m; `spacing`, (rings × rays,) float64,
    distance of neighbours, m.
    """
    radius = np.geomspace(nearest, farthest, rings)
    seen = rays - rays // 8
    angle = np.concatenate([
        np.linspace(-SECTOR, SECTOR, seen),
        np.linspace(SECTOR, 2.0 * np.pi - SECTOR, rays - seen + 1)[1:]])
    r, a = np.meshgrid(radius, angle, indexing="ij")
    points = np.stack([r * np.cos(a), r * np.sin(a), np.zeros_like(r)], -1).reshape(-1, 3)
    wide = np.gradient(angle)[None, :]
    step = np.maximum(np.log(farthest / nearest) / rings, wide)
    return points, (r * step).ravel()


@lru_cache(maxsize=FINENESS[1])
def sphere(subdivisions: int) -> tuple[Array, Array]:
    """Unit sphere of a subdivided cube: vertices (N, 3), faces (M, 3)."""
    side = np.tan(np.linspace(-np.pi / 4.0, np.pi / 4.0, subdivisions + 1))
    u, v = (a.ravel() for a in np.meshgrid(side, side, indexing="ij"))
    one = np.ones_like(u)
    vertices, faces = [], []
    one_side = grid_faces(subdivisions + 1, subdivisions + 1)
    for k, axes in enumerate(((one, u, v), (-one, v, u), (v, one, u), (u, -one, v), (u, v, one),
                              (v, u, -one))):
        corners = np.stack(axes, -1)
        vertices.append(corners / np.linalg.norm(corners, axis=1, keepdims=True))
        faces.append(one_side + k * len(u))
    return np.concatenate(vertices), np.concatenate(faces)
