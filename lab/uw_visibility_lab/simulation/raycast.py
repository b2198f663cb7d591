# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Ray casting: intersections of rays with the scene, and radiance there.

Surfaces have contrast at all scales, and mild shading.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility_lab.simulation.noise import fractal_noise, smoothstep, value_noise
from uw_visibility_lab.simulation.scene import BLOCK, SPACING, Scene
from uw_visibility_lab.simulation.shapes import meet_shape, shape_normal

NOTHING = -2
FLOOR = -1

Lattice = NDArray[np.float32]
Colour = tuple[float, float, float]


@njit(nogil=True, error_model="numpy")
def bilinear(grid: Any, column: float, row: float) -> float:
    """Interpolate a grid; beyond its edge the edge goes on."""
    column = min(max(column, 0.0), grid.shape[1] - 1.001)
    row = min(max(row, 0.0), grid.shape[0] - 1.001)
    i = index_of(column, 0, grid.shape[1] - 2)
    j = index_of(row, 0, grid.shape[0] - 2)
    u, v = column - i, row - j
    top = grid[j, i] + u * (grid[j, i + 1] - grid[j, i])
    bottom = grid[j + 1, i] + u * (grid[j + 1, i + 1] - grid[j + 1, i])
    return top + v * (bottom - top)


@njit(nogil=True, error_model="numpy")
def floor_distance(scene: Scene, eye: Any, dx: float, dy: float, dz: float, limit: float) -> float:
    """March along a ray to the sea floor; inf where it is not met within ``limit``."""
    heights = scene.heights
    x0, y0 = (eye[0] - scene.origin[0]) / SPACING, (eye[1] - scene.origin[1]) / SPACING
    ux, uy = dx / SPACING, dy / SPACING
    across = math.hypot(dx, dy)
    t = before = 0.0
    if eye[2] > scene.highest:
        if dz >= 0.0:
            return math.inf
        t = before = (scene.highest - eye[2]) / dz
    gap = gap_before = 1.0
    while t < limit:
        column, row, z = x0 + t * ux, y0 + t * uy, eye[2] + t * dz
        block, leave = _block(heights, column, row, ux, uy)
        if z + min(leave * dz, 0.0) > scene.block_highest[block]:
            before, gap_before = t, z - scene.block_highest[block]
            t += leave + 1e-6
            continue
        gap = z - bilinear(heights, column, row)
        if gap < 0.0:
            break
        before, gap_before = t, gap
        # Within the block the gap closes no faster than this.
        closing = max(scene.block_steepest[block] * across - dz, 1e-3)
        t += min(max(gap / closing, 5e-4 * t + 1e-4), leave + 1e-6)
    if t >= limit:
        return math.inf
    gap_after = gap
    for _ in range(30):
        # False position, kept from creeping along one end.
        share = min(max(gap_before / (gap_before - gap_after), 0.05), 0.95)
        middle = before + share * (t - before)
        gap = eye[2] + middle * dz - bilinear(heights, x0 + middle * ux, y0 + middle * uy)
        if gap < 0.0:
            t, gap_after = middle, gap
        else:
            before, gap_before = middle, gap
        if t - before < 1e-7 or abs(gap) < 1e-8:
            return middle
    return 0.5 * (before + t)


@njit(nogil=True, error_model="numpy")
def _block(
    heights: Any, column: float, row: float, ux: float, uy: float
) -> tuple[tuple[int, int], float]:
    """Return the block of the floor below a point, and how far the ray stays above it."""
    i = index_of(column, 0, heights.shape[1] - 2) // BLOCK
    j = index_of(row, 0, heights.shape[0] - 2) // BLOCK
    leave = math.inf
    # Beyond the floor's edge the outermost block goes on.
    if ux > 0.0 and i < (heights.shape[1] - 2) // BLOCK:
        leave = min(leave, ((i + 1) * BLOCK - column) / ux)
    elif ux < 0.0 and i > 0:
        leave = min(leave, (i * BLOCK - column) / ux)
    if uy > 0.0 and j < (heights.shape[0] - 2) // BLOCK:
        leave = min(leave, ((j + 1) * BLOCK - row) / uy)
    elif uy < 0.0 and j > 0:
        leave = min(leave, (j * BLOCK - row) / uy)
    return (j, i), max(leave, 0.0)


@njit(nogil=True, error_model="numpy")
def nearest(
    scene: Scene, candidates: Any, eye: Any, dx: float, dy: float, dz: float, limit: float
) -> tuple[float, int]:
    """Nearest intersection of a ray: its distance, and the shape."""
    best = floor_distance(scene, eye, dx, dy, dz, limit)
    hit = FLOOR if best < math.inf else NOTHING
    for index in candidates:
        t = meet_shape(scene.shapes[index], eye[0], eye[1], eye[2], dx, dy, dz)
        if t < best and t < limit:
            best = t
            hit = index
    return best, hit


@njit(nogil=True, error_model="numpy")
def look_at(
    scene: Scene, hit: int, px: float, py: float, pz: float, footprint: float,
    view: tuple[float, float, float], seen: Any,
) -> None:
    """Write the normalised radiance in daylight of a point on the floor or on a shape.

    footprint: width of a pixel there in m.
    seen: takes the radiance and, where there is room, reflectance and unit normal.
    """
    column, row = (px - scene.origin[0]) / SPACING, (py - scene.origin[1]) / SPACING
    above = pz - bilinear(scene.heights, column, row)
    nx, ny, nz = surface_normal(scene, hit, px, py, pz)
    # A slanted surface widens the footprint; half of that is left to supersampling.
    slant = max(abs(nx * view[0] + ny * view[1] + nz * view[2]), 0.05)
    footprint /= math.sqrt(slant)
    light = shading(nx, ny, nz)
    if hit == FLOOR:
        light *= bilinear(scene.openness, column, row)
    else:
        light *= 0.22 + 0.78 * smoothstep(-0.03, 0.22, above)
    if scene.texture == 0.0:
        light = 1.0
        r = g = b = 0.5
    elif hit == FLOOR:
        r, g, b = floor_radiance(scene.lattice, px, py, pz, footprint)
    else:
        r, g, b = shape_radiance(scene.lattice, scene.appearance[hit], px, py, pz, footprint)
    seen[0], seen[1], seen[2] = light * r, light * g, light * b
    if len(seen) > 3:
        seen[3], seen[4], seen[5] = r, g, b
        seen[6], seen[7], seen[8] = nx, ny, nz


@njit(nogil=True, error_model="numpy")
def surface_normal(
    scene: Scene, hit: int, px: float, py: float, pz: float
) -> tuple[float, float, float]:
    """Return the outward unit normal at a point of the floor or of a shape."""
    if hit != FLOOR:
        return shape_normal(scene.shapes[hit], px, py, pz)
    heights = scene.heights
    column, row = (px - scene.origin[0]) / SPACING, (py - scene.origin[1]) / SPACING
    nx = bilinear(heights, column - 0.7, row) - bilinear(heights, column + 0.7, row)
    ny = bilinear(heights, column, row - 0.7) - bilinear(heights, column, row + 0.7)
    nz = 1.4 * SPACING
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length


@njit(nogil=True, error_model="numpy")
def floor_radiance(
    lattice: Lattice, x: float, y: float, z: float, footprint: float
) -> Colour:
    """Return the floor's reflectance: bright sand, rock with dark growth, pebbles."""
    patch = fractal_noise(lattice, x + 31.0, y, z, 1.7, 4, 0.55, footprint)
    detail = fractal_noise(lattice, x, y, z, 0.33, 7, 0.82, footprint)
    hue = fractal_noise(lattice, x, y + 17.0, z, 0.55, 2, 0.6, footprint)
    rock = smoothstep(-0.02, 0.16, patch + 0.25 * detail)
    sand_light = min(max(0.62 + 0.55 * detail, 0.0), 1.0)
    rock_light = smoothstep(-0.35, 0.75, detail)
    green = smoothstep(0.0, 0.5, hue)
    red = 0.02 + 0.98 * sand_light + rock * (0.012 + (0.66 - 0.28 * green) * rock_light
                                           - 0.02 - 0.98 * sand_light)
    grn = 0.02 + 0.91 * sand_light + rock * (0.014 + (0.52 + 0.02 * green) * rock_light
                                           - 0.02 - 0.91 * sand_light)
    blu = 0.02 + 0.76 * sand_light + rock * (0.010 + (0.42 - 0.22 * green) * rock_light
                                           - 0.02 - 0.76 * sand_light)
    # Pebbles and shells at one end of the detail, holes at the other.
    hole = 1.0 - 0.96 * smoothstep(0.30, 0.62, -detail + 0.5 * patch)
    shell = 0.85 * smoothstep(0.50, 0.72, detail - 0.6 * patch)
    return (
        hole * red + shell * (0.97 - red),
        hole * grn + shell * (0.96 - grn),
        hole * blu + shell * (0.93 - blu),
    )


@njit(nogil=True, error_model="numpy")
def shape_radiance(
    lattice: Lattice, look: Any, x: float, y: float, z: float, footprint: float
) -> Colour:
    """Return a shape's reflectance: mottled between two colours, with dark grooves."""
    cell, width = look[6], look[7]
    detail = fractal_noise(lattice, x, y, z, cell, 6, 0.72, footprint)
    light = smoothstep(-0.55, 0.65, detail)
    resolved = smoothstep(0.7, 2.0, 0.6 * cell / footprint)
    groove = 0.15
    if resolved > 0.0:
        scale = 1.0 / (0.6 * cell)
        ridge = abs(value_noise(lattice, x * scale + 5.0, y * scale, z * scale)) + 0.12 * detail
        groove += resolved * (1.0 - smoothstep(0.0, 1.6 * width, ridge) - groove)
    dim = 1.0 - 0.92 * groove
    return (
        dim * (look[3] + light * (look[0] - look[3])),
        dim * (look[4] + light * (look[1] - look[4])),
        dim * (look[5] + light * (look[2] - look[5])),
    )


@njit(nogil=True, error_model="numpy")
def shading(nx: float, ny: float, nz: float) -> float:
    """Return the share of light that falls on a surface, from above and all around."""
    slanted = 0.30 * nx + 0.22 * ny + 0.93 * nz
    return 0.30 + 0.36 * (0.5 + 0.5 * nz) + 0.34 * max(slanted, 0.0)
