# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Seeded value noise in three dimensions, summed over octaves.

A texture is a function of the point on the surface, not of the pixel: both
cameras see the same value at the same point.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit

LATTICE_SIZE = 64
"""Period of the noise in cells; a power of two."""

LACUNARITY = 0.47
"""Ratio of an octave's cell size to that of the one before; the cells do not line up."""


def noise_lattice(seed: int) -> NDArray[np.float32]:
    """Return random values at the lattice's points, uniform in -1 .. 1."""
    random = np.random.default_rng(seed)
    shape = (LATTICE_SIZE, LATTICE_SIZE, LATTICE_SIZE)
    return random.uniform(-1.0, 1.0, shape).astype(np.float32)


@njit(nogil=True, error_model="numpy")
def smoothstep(low: float, high: float, x: float) -> float:
    """Rise smoothly from 0 at ``low`` to 1 at ``high``."""
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@njit(nogil=True, error_model="numpy")
def value_noise(lattice: Any, x: float, y: float, z: float) -> float:
    """Interpolate the lattice smoothly at a point given in cells; within -1 .. 1."""
    mask = LATTICE_SIZE - 1
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    i0, j0, k0 = int(fx) & mask, int(fy) & mask, int(fz) & mask
    i1, j1, k1 = (i0 + 1) & mask, (j0 + 1) & mask, (k0 + 1) & mask
    u, v, w = x - fx, y - fy, z - fz
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    a = lattice[i0, j0, k0] + w * (lattice[i0, j0, k1] - lattice[i0, j0, k0])
    b = lattice[i0, j1, k0] + w * (lattice[i0, j1, k1] - lattice[i0, j1, k0])
    c = lattice[i1, j0, k0] + w * (lattice[i1, j0, k1] - lattice[i1, j0, k0])
    d = lattice[i1, j1, k0] + w * (lattice[i1, j1, k1] - lattice[i1, j1, k0])
    near = a + v * (b - a)
    return near + u * (c + v * (d - c) - near)


@njit(nogil=True, error_model="numpy")
def fractal_noise(
    lattice: Any, x: float, y: float, z: float, cell: float, octaves: int, persistence: float,
    footprint: float,
) -> float:
    """Fractal noise: octaves of value noise, without those that a pixel cannot resolve.

    An octave fades as its cell size approaches the pixel's footprint, so that far
    surfaces are smooth instead of aliased, and look alike in both views.

    x, y, z, cell, footprint: point, cell size of the first octave, width of a pixel there, m.
    persistence: weight of an octave relative to the one before.
    Returns zero on average, with a standard deviation near 0.4 for a persistence of 0.6.
    """
    total = 0.0
    weight = 1.0
    power = 0.0
    for octave in range(octaves):
        power += weight * weight
        fade = smoothstep(0.5, 1.5, cell / footprint)
        if fade > 0.0:
            scale = 1.0 / cell
            # Each octave is rotated relative to the one before, which hides the lattice's axes,
            # and shifted, so that the octaves' origins do not coincide.
            x, y, z = 0.8 * x - 0.6 * y, 0.48 * x + 0.64 * y - 0.6 * z, (
                0.36 * x + 0.48 * y + 0.8 * z
            )
            shift = 7.3 * octave
            total += weight * fade * value_noise(
                lattice, x * scale + shift, y * scale - shift, z * scale + 2.0 * shift
            )
        weight *= persistence
        cell *= LACUNARITY
    return total / math.sqrt(power)
