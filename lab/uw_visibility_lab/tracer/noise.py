# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Solid value noise: relief and textures that are the same for the same seed."""

from __future__ import annotations

import numpy as np

from uw_visibility.images.arrays import Array

_PERIOD = 2048
"""Cells after which noise repeats: 30 m for grain of 3 cm."""


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
