# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Surface reflectance with contrast at all scales, and mild shading."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.simulation.noise import fractal_noise, smoothstep, value_noise

Lattice = NDArray[np.float32]
Colour = tuple[float, float, float]


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
