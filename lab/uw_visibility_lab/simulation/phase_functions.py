# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Phase functions: angular distribution of the light that water and particles scatter."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array

HENYEY_GREENSTEIN, FOURNIER_FORAND = "henyey-greenstein", "fournier-forand"
PHASE_FUNCTIONS = (HENYEY_GREENSTEIN, FOURNIER_FORAND)

ASYMMETRY = 0.9
"""Mean cosine of the scattering angle in the sea: from 0.85 to 0.95."""

REFRACTIVE_INDEX, SLOPE = 1.10, 3.5835
"""Refractive index relative to water, and slope of the hyperbolic size distribution, of particles
whose Fournier-Forand function is closest to Petzold's average; their backscattering ratio is
0.0183. Mobley, Sundman and Boss, Applied Optics 41 (2002), doi 10.1364/AO.41.001035."""

ENTRIES = 16385
"""Entries of a table over 0 .. π."""

_SMALLEST = 1e-3
"""Angle in rad below which the Fournier-Forand function is taken as constant: it has a pole."""


def henyey_greenstein(angle: ArrayLike, asymmetry: float = ASYMMETRY) -> Array:
    """Henyey-Greenstein phase function in 1/sr over the scattering angle in rad.

    L. G. Henyey and J. L. Greenstein, Diffuse radiation in the galaxy, Astrophysical
    Journal 93 (1941), doi 10.1086/144246. Its integral over the sphere is 1.
    """
    spread = 1.0 + asymmetry**2 - 2.0 * asymmetry * np.cos(angle)
    return np.asarray((1.0 - asymmetry**2) / (4.0 * math.pi * spread**1.5))


def fournier_forand(angle: ArrayLike) -> Array:
    """Fournier-Forand phase function in 1/sr over the scattering angle in rad, above 0.

    G. R. Fournier and M. Jonasz, Computer-based underwater imaging analysis, SPIE 3761
    (1999), doi 10.1117/12.366488, eq. 3. Its integral over the sphere is 1.
    """
    nu = (3.0 - SLOPE) / 2.0
    scale = 4.0 / (3.0 * (REFRACTIVE_INDEX - 1.0) ** 2)
    half = np.square(np.sin(np.asarray(angle) / 2.0))
    delta = scale * half
    # Where δ = 1 both numerator and denominator vanish.
    delta = np.where(np.abs(delta - 1.0) < 1e-6, 1.0 + 1e-6, delta)
    power = delta**nu
    forward = nu * (1.0 - delta) - (1.0 - power)
    forward += (delta * (1.0 - power) - nu * (1.0 - delta)) / half
    forward /= 4.0 * math.pi * np.square(1.0 - delta) * power
    backward = (1.0 - scale**nu) / (16.0 * math.pi * (scale - 1.0) * scale**nu)
    return np.asarray(forward + backward * (3.0 * np.square(np.cos(angle)) - 1.0))


@lru_cache(maxsize=4)
def phase_table(name: str) -> Array:
    """Return a phase function over 0 .. π rad, at equal steps, shape (`ENTRIES`,)."""
    if name not in PHASE_FUNCTIONS:
        raise InputError(f"no phase function {name!r}: give one of {', '.join(PHASE_FUNCTIONS)}")
    angles = np.linspace(0.0, math.pi, ENTRIES)
    table = henyey_greenstein(angles) if name == HENYEY_GREENSTEIN else (
        fournier_forand(np.maximum(angles, _SMALLEST)))
    table.flags.writeable = False
    return table
