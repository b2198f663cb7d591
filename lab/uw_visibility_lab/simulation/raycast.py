# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Ray casting: intersections of rays with a ground or a scene, and radiance at them.

Surfaces have contrast at all scales, and mild shading.
"""

from __future__ import annotations

import math
from typing import Any

from uw_visibility.compute.jit import njit
from uw_visibility_lab.simulation.noise import fractal_noise, smoothstep, value_noise
from uw_visibility_lab.simulation.scene import SPACING, Scene
from uw_visibility_lab.simulation.shapes import NOWHERE, meet_shape, shape_normal

_REFINE = 8

NOTHING = -2
FLOOR = -1

Colour = tuple[float, float, float]


@njit(nogil=True, error_model="numpy")
def relief_height(relief: Any, size: float, slope: float, x: float, y: float) -> float:
    """Height of the ground: a periodic grid of square cells, on a plane that rises with y.

    size: extent of the grid's rows in y, in the unit of x and y.
    """
    rows, columns = relief.shape
    u, v = x / size * rows, y / size * rows
    i, j = math.floor(u), math.floor(v)
    fu, fv = u - i, v - j
    # Faster than the integer remainder.
    i0, j0 = int(i - columns * math.floor(i / columns)), int(j - rows * math.floor(j / rows))
    i1, j1 = i0 + 1 if i0 + 1 < columns else 0, j0 + 1 if j0 + 1 < rows else 0
    near = relief[j0, i0] + fu * (relief[j0, i1] - relief[j0, i0])
    far = relief[j1, i0] + fu * (relief[j1, i1] - relief[j1, i0])
    return near + fv * (far - near) + slope * y


@njit(nogil=True, error_model="numpy")
def meet_ground(
    relief: Any, size: float, slope: float, steep: float, ox: float, oy: float, oz: float,
    dx: float, dy: float, dz: float, start: float, most: float,
) -> float:
    """Range at which a ray meets the ground, or `NOWHERE`; steps are `steep` × height above it.

    The range is too long by at most 1/256 of the last step: of 0.6 cells or 0.4 % of the range.
    """
    t = start
    before = t
    above = oz + t * dz - relief_height(relief, size, slope, ox + t * dx, oy + t * dy)
    if above < 0.0:
        return t
    cell = size / relief.shape[0]
    while t < most:
        before = t
        t += max(above * steep, 0.6 * cell, 0.004 * t)
        above = oz + t * dz - relief_height(relief, size, slope, ox + t * dx, oy + t * dy)
        if above < 0.0:
            for _ in range(_REFINE):
                middle = 0.5 * (before + t)
                if oz + middle * dz < relief_height(
                    relief, size, slope, ox + middle * dx, oy + middle * dy
                ):
                    t = middle
                else:
                    before = middle
            return t
    return NOWHERE


@njit(nogil=True, error_model="numpy")
def on_floor(scene: Scene, grid: Any, x: float, y: float) -> float:
    """Value of one of the sea floor's grids at a point."""
    size = len(grid) * SPACING
    return relief_height(grid, size, 0.0, x - scene.origin[0], y - scene.origin[1])


@njit(nogil=True, error_model="numpy")
def floor_distance(scene: Scene, eye: Any, dx: float, dy: float, dz: float, limit: float) -> float:
    """Distance along a ray to the sea floor; `NOWHERE` where it is not met within ``limit``."""
    start = 0.0
    if eye[2] > scene.highest:
        if dz >= 0.0:
            return NOWHERE
        start = (scene.highest - eye[2]) / dz
    # A ray approaches the floor faster than this at few places only.
    closing = max(scene.steep * math.hypot(dx, dy) - dz, 1e-3)
    return meet_ground(
        scene.heights, len(scene.heights) * SPACING, 0.0, 1.0 / closing,
        eye[0] - scene.origin[0], eye[1] - scene.origin[1], eye[2], dx, dy, dz, start, limit)


@njit(nogil=True, error_model="numpy")
def nearest_shape(
    shapes: Any, candidates: Any, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[float, int]:
    """Range and index of the candidate that a ray meets first; `NOWHERE` and -1 for none."""
    best, index = NOWHERE, -1
    for k in candidates:
        t = meet_shape(shapes[k], ox, oy, oz, dx, dy, dz)
        if t < best:
            best, index = t, k
    return best, index


@njit(nogil=True, error_model="numpy")
def look_at(
    scene: Scene, hit: int, px: float, py: float, pz: float, footprint: float,
    view: tuple[float, float, float], seen: Any,
) -> None:
    """Write the normalised radiance in daylight of a point on the floor or on a shape.

    footprint: width of a pixel there in m.
    seen: (9,), output: radiance, reflectance and unit normal.
    """
    if hit == FLOOR:
        grid, step = scene.heights, 0.7 * SPACING
        nx = on_floor(scene, grid, px - step, py) - on_floor(scene, grid, px + step, py)
        ny = on_floor(scene, grid, px, py - step) - on_floor(scene, grid, px, py + step)
        nz = 2.0 * step
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / length, ny / length, nz / length
    else:
        nx, ny, nz = shape_normal(scene.shapes[hit], px, py, pz)
    # A slanted surface widens the footprint; half of that is left to supersampling.
    slant = max(abs(nx * view[0] + ny * view[1] + nz * view[2]), 0.05)
    footprint /= math.sqrt(slant)
    light = shading(nx, ny, nz)
    if hit == FLOOR:
        light *= on_floor(scene, scene.openness, px, py)
        r, g, b = floor_radiance(scene.lattice, px, py, pz, footprint)
    else:
        above = pz - on_floor(scene, scene.heights, px, py)
        light *= 0.22 + 0.78 * smoothstep(-0.03, 0.22, above)
        r, g, b = shape_radiance(scene.lattice, scene.appearance[hit], px, py, pz, footprint)
    seen[0], seen[1], seen[2] = light * r, light * g, light * b
    seen[3], seen[4], seen[5] = r, g, b
    seen[6], seen[7], seen[8] = nx, ny, nz


@njit(nogil=True, error_model="numpy")
def floor_radiance(lattice: Any, x: float, y: float, z: float, footprint: float) -> Colour:
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
    lattice: Any, look: Any, x: float, y: float, z: float, footprint: float
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
