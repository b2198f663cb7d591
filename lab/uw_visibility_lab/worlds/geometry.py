# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels of procedural scenes: ray casting of a relief and simple shapes, and their colours.

World axes: x right, y ahead, z up. The unit of length is the height of the camera above the
ground; the camera is at (0, 0, 1).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility_lab.simulation.noise import fractal_noise
from uw_visibility_lab.simulation.raycast import meet_ground, nearest_shape, relief_height
from uw_visibility_lab.simulation.shapes import shape_normal

# Columns of a material's row: pattern, two colours (3 each), cell and sharpness of the pattern,
# coarse and fine variation of brightness, persistence, picture (-1 for none) and its width.
MIXED, CHECKED, STRIPED = 0, 1, 2
"""Patterns: two colours by fractal noise, by a checkerboard, by stripes."""

TEXTURE = 256
"""Side of a picture's finest level, px; each further level has half of it."""
LEVELS = 6

FINE_CELL = 0.02
"""Cell of the fine variation of brightness, in heights of the camera: gravel, polyps."""


@njit(nogil=True, error_model="numpy")
def sample_picture(pictures: Any, index: int, u: float, v: float, pixel: float, out: Any) -> None:
    """Interpolate a picture of period 1 at (u, v), at the level for a pixel's width there."""
    size = TEXTURE
    offset = 0
    level = 0
    while level < LEVELS - 1 and pixel * size > 1.5:
        offset += size * size
        size //= 2
        level += 1
    x, y = u * size - 0.5, v * size - 0.5
    i, j = math.floor(x), math.floor(y)
    fx, fy = x - i, y - j
    i0, j0 = int(i) % size, int(j) % size
    i1, j1 = (i0 + 1) % size, (j0 + 1) % size
    for c in range(3):
        near = (1.0 - fx) * pictures[index, offset + j0 * size + i0, c] + fx * pictures[
            index, offset + j0 * size + i1, c]
        far = (1.0 - fx) * pictures[index, offset + j1 * size + i0, c] + fx * pictures[
            index, offset + j1 * size + i1, c]
        out[c] = near + fy * (far - near)


@njit(nogil=True, error_model="numpy")
def paint(
    material: Any, lattice: Any, pictures: Any, x: float, y: float, z: float, nx: float, ny: float,
    nz: float, pixel: float, out: Any,
) -> None:
    """Write a material's albedo, RGB, to `out`, by point, normal and width of a pixel there."""
    cell = material[7]
    persistence = material[11]
    if material[12] >= 0.0:
        cover = material[13]
        # The picture is projected along the axis that is closest to the normal.
        ax, ay, az = abs(nx), abs(ny), abs(nz)
        if az >= ax and az >= ay:
            u, v = x, y
        elif ax >= ay:
            u, v = y, -z
        else:
            u, v = x, -z
        sample_picture(pictures, int(material[12]), u / cover, v / cover, pixel / cover, out)
    else:
        pattern = int(material[0])
        if pattern == 1:
            share = float(
                (math.floor(x / cell) + math.floor(y / cell) + math.floor(z / cell)) % 2)
        else:
            if pattern == 2:
                value = math.sin(6.2831853 * (z + 0.4 * y) / cell) + 0.3 * fractal_noise(
                    lattice, x + 3.0, y, z, cell, 3, persistence, pixel)
            else:
                value = fractal_noise(lattice, x + 3.0, y, z, cell, 5, persistence, pixel)
            share = min(max(0.5 + material[8] * value, 0.0), 1.0)
        for c in range(3):
            out[c] = material[1 + c] + share * (material[4 + c] - material[1 + c])
    # Fractal noise has a standard deviation near 0.4.
    brightness = 2.5 * material[9] * fractal_noise(
        lattice, x, y + 5.0, z, 2.0 * cell, 7, persistence, pixel)
    brightness += 2.5 * material[10] * fractal_noise(
        lattice, x, y, z + 9.0, FINE_CELL, 4, 0.8, pixel)
    gain = math.exp(brightness)
    for c in range(3):
        out[c] = min(out[c] * gain, 1.0)


@njit(nogil=True, error_model="numpy")
def cast(
    directions: Any, shapes: Any, relief: Any, hollow: Any, size: float, slope: float,
    steep: float, most: float, materials: Any, ground: Any, ground_cell: float, lattice: Any,
    pictures: Any, sun: Any, ambient: float, shadows: bool, pixel_angle: float, reflectance: Any,
    ranges: Any,
) -> None:
    """Render a procedural scene.

    directions: (H, W, 3) unit vectors. shapes: (n, SHAPE_COLUMNS). relief, hollow: (m, m) heights
    and brightness of the ground, over `size`. most: largest range. materials: (k, 14). ground:
    indices of its two materials, which alternate by noise of `ground_cell`. pictures:
    (p, pixels of all levels, 3). sun: (3,), unit vector towards it. ambient: share of even light.
    reflectance (H, W, 3), ranges (H, W): output; 0 and inf in open water.
    """
    height, width = directions.shape[:2]
    colour, normal = np.zeros(3), np.zeros(3)
    cell = size / relief.shape[0]
    everything = np.arange(len(shapes))
    for row in range(height):
        for column in range(width):
            dx, dy, dz = (
                directions[row, column, 0], directions[row, column, 1], directions[row, column, 2])
            t, index = nearest_shape(shapes, everything, 0.0, 0.0, 1.0, dx, dy, dz)
            g = meet_ground(
                relief, size, slope, steep, 0.0, 0.0, 1.0, dx, dy, dz, 0.02, min(t, most))
            if g < t:
                t, index = g, -1
            if t >= most:
                ranges[row, column] = np.inf
                for c in range(3):
                    reflectance[row, column, c] = 0.0
                continue
            x, y, z = t * dx, t * dy, 1.0 + t * dz
            if index < 0:
                h = max(cell, 0.5 * t * pixel_angle)
                normal[0] = (relief_height(relief, size, slope, x - h, y)
                             - relief_height(relief, size, slope, x + h, y)) / (2.0 * h)
                normal[1] = (relief_height(relief, size, slope, x, y - h)
                             - relief_height(relief, size, slope, x, y + h)) / (2.0 * h)
                normal[2] = 1.0
                length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + 1.0)
                for c in range(3):
                    normal[c] /= length
                shade = relief_height(hollow, size, 0.0, x, y)
                chosen = fractal_noise(
                    lattice, x + 20.0, y, 0.3 * z, ground_cell, 4, 0.5, t * pixel_angle)
                material = ground[0] if chosen > 0.0 else ground[1]
            else:
                shape = shapes[index]
                normal[0], normal[1], normal[2] = shape_normal(shape, x, y, z)
                # Darker near the ground, which hides half of the light.
                above = z - relief_height(relief, size, slope, x, y)
                shade = 0.5 + 0.5 * min(max(above / max(shape[16], 1e-6), 0.0), 1.0)
                material = int(shape[17])
                bump = shape[18]
                if bump > 0.0:
                    # Lumps move the surface along the line of sight and tilt its normal.
                    lump = 0.35 * shape[16]
                    n0 = fractal_noise(lattice, x, y, z, lump, 4, 0.5, t * pixel_angle)
                    e = 0.1 * lump
                    n1 = fractal_noise(lattice, x + e, y, z, lump, 4, 0.5, t * pixel_angle)
                    n2 = fractal_noise(lattice, x, y + e, z, lump, 4, 0.5, t * pixel_angle)
                    n3 = fractal_noise(lattice, x, y, z + e, lump, 4, 0.5, t * pixel_angle)
                    tall = bump * shape[16]
                    normal[0] -= tall * (n1 - n0) / e
                    normal[1] -= tall * (n2 - n0) / e
                    normal[2] -= tall * (n3 - n0) / e
                    length = max(math.sqrt(
                        normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2), 1e-9)
                    for c in range(3):
                        normal[c] /= length
                    t = max(t - tall * n0, 0.3 * t)
                    shade *= min(max(0.8 + 0.7 * n0, 0.2), 1.0)
            paint(
                materials[material], lattice, pictures, x, y, z, normal[0], normal[1], normal[2],
                t * pixel_angle, colour)
            facing = max(normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2], 0.0)
            if shadows and facing > 0.0:
                ox, oy, oz = (
                    x + 0.01 * normal[0], y + 0.01 * normal[1], z + 0.01 * normal[2])
                if nearest_shape(
                    shapes, everything, ox, oy, oz, sun[0], sun[1], sun[2]
                )[1] >= 0:
                    facing = 0.0
            # Even light comes more from above than from below.
            even = 0.6 + 0.4 * normal[2]
            light = shade * (ambient * even + (1.0 - ambient) * facing)
            ranges[row, column] = t
            for c in range(3):
                reflectance[row, column, c] = colour[c] * light


def picture_levels(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Stack a picture's levels, each of half the side, for `sample_picture`.

    picture: (TEXTURE, TEXTURE, 3), linear. Returns (pixels of all levels, 3).
    """
    parts = []
    for _ in range(LEVELS):
        parts.append(picture.reshape(-1, 3))
        side = picture.shape[0] // 2
        picture = picture.reshape(side, 2, side, 2, 3).mean(axis=(1, 3))
    return np.concatenate(parts)
