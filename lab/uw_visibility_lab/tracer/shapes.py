# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Meshes of a sea floor and of what stands on it, with a reflectance at each vertex.

Relief and textures are of solid value noise, the same for the same seed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uw_visibility.images.arrays import Array

SECTOR = np.pi / 4.0
"""Half of the directions that are seen, rad."""

_PERIOD = 2048
"""Cells after which noise repeats: 30 m for grain of 3 cm."""


@dataclass(frozen=True)
class Shape:
    """Triangle mesh."""

    vertices: Array  # (N, 3) float64; x ahead of the camera, y to its left, z up, m
    faces: Array  # (M, 3) uint32
    reflectance: Array  # (N, 3) float32; RGB, 0 .. 1


def grid_faces(rows: int, columns: int) -> Array:
    """Return the triangles of a grid of vertices in row-major order, (M, 3) uint32."""
    corner = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, :-1].ravel()
    return np.concatenate([
        np.stack([corner, corner + columns, corner + 1], -1),
        np.stack([corner + 1, corner + columns, corner + columns + 1], -1),
    ]).astype(np.uint32)


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
    return np.concatenate(vertices), np.concatenate(faces).astype(np.uint32)


def rotation(axis: Array, angle: float) -> Array:
    """Return the matrix (3, 3) that turns by an angle in rad about an axis (3,)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def value_noise(points: Array, seed: int) -> Array:
    """Value noise with a wavelength of about two units.

    points: (N, 3) float.
    seed: of the lattice.
    Returns (N,) float64, within -1 .. 1 and about 0.

    References
    ----------
    D. S. Ebert et al., Texturing and Modeling, 3rd ed. (2003), ch. 2.
    """
    random = np.random.default_rng(seed)
    order = random.permutation(_PERIOD)
    heights = random.uniform(-1.0, 1.0, _PERIOD)
    low = np.floor(points)
    part = points - low
    weight = part * part * (3.0 - 2.0 * part)
    cell = low.astype(np.int64) % _PERIOD
    along = [[(cell[:, axis] + step) % _PERIOD for step in (0, 1)] for axis in range(3)]
    total = np.zeros(len(points))
    for i in (0, 1):
        first = order[along[0][i]]
        share_x = weight[:, 0] if i else 1.0 - weight[:, 0]
        for j in (0, 1):
            second = order[(first + along[1][j]) % _PERIOD]
            share_y = share_x * (weight[:, 1] if j else 1.0 - weight[:, 1])
            near = heights[(second + order[along[2][0]]) % _PERIOD]
            far = heights[(second + order[along[2][1]]) % _PERIOD]
            total += share_y * (near + weight[:, 2] * (far - near))
    return total


def fractal(
    points: Array, seed: int, wavelength: float, octaves: int, gain: float = 0.5,
    spacing: Array | float = 0.0,
) -> Array:
    """Sum of octaves of value noise, each half as long and `gain` times as high.

    points: (N, 3), m.
    wavelength: of the first octave, m.
    gain: height of an octave over that of the one before.
    spacing: or float, (N,), distance of samples, m: octaves that these cannot carry fade out.
    Returns (N,) float64, about 0, the first octave within -1 .. 1.
    """
    total = np.zeros(len(points))
    length, height = wavelength, 1.0
    for octave in range(octaves):
        # Nyquist: two samples a wavelength; faded in over another factor of 2.
        carried = np.clip(length / np.maximum(2.0 * np.asarray(spacing), 1e-9) - 1.0, 0.0, 1.0)
        carried = np.broadcast_to(carried, len(points))
        used = carried > 0.0
        total[used] += height * carried[used] * value_noise(
            points[used] * (2.0 / length), seed * 64 + octave)
        length /= 2.0
        height *= gain
    return total


def painted(
    points: Array, palette: Array, seed: int, patch: float, grain: float, roughness: float,
    spacing: Array | float,
) -> Array:
    """Reflectance of natural surfaces: patches of a palette, with grain on them.

    points: (N, 3), m.
    palette: (K, 3), reflectances.
    patch, grain: wavelengths of patches and grain, m.
    roughness: relative height of the grain.
    spacing: or float, distance of vertices, m.
    Returns (N, 3) float32, 0.01 .. 0.95.
    """
    mixed = np.zeros((len(points), 3))
    total = np.zeros((len(points), 1))
    for k, colour in enumerate(palette):
        # Softmax of noises: one colour dominates a patch, borders are a few cm wide.
        level = fractal(points, seed * 16 + k, patch, 4, 0.6, spacing)
        weight = np.exp(8.0 * level)[:, None]
        mixed += weight * colour
        total += weight
    shade = 1.0 + roughness * fractal(points, seed * 16 + 15, grain, 3, 0.8, spacing)
    return np.asarray(np.clip(mixed / total * shade[:, None], 0.01, 0.95), np.float32)
