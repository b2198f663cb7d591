# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Visual ranges in oceanography: black disc and Secchi disk, from attenuation coefficients."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

BLACK_DISC = 4.8
"""Attenuation lengths over which a black target is seen horizontally.

Davies-Colley 1988, doi 10.4319/lo.1988.33.4.0616; Zaneveld and Pegau 2003,
doi 10.1364/OE.11.002997.
"""
BLACK_DISC_DEVIATION = 0.1
"""Its relative standard deviation over waters and viewing conditions (the same source)."""

BEAM_OVER_SEEN = 2.0
"""Beam attenuation over the attenuation that a camera sees, c / β.

Light scattered by small angles is not lost to a camera. In path-traced scenes β / c is 0.49 (0.39
to 0.62; 12 scenes, Henyey and Greenstein's phase functions), 0.56 (0.40 to 0.72; 13 others) and
0.36 (0.32 to 0.60; 4 with Fournier and Forand's): see lab/studies/beam_attenuation.md.
"""
BEAM_OVER_SEEN_DEVIATION = 0.3
"""Standard deviation of its logarithm over these scenes."""

SECCHI_DISK_REFLECTANCE = 0.14
"""Remote-sensing reflectance of a Secchi disk at the water's surface, 1/sr (Lee et al. 2015)."""
SECCHI_CONTRAST = 0.013
"""Least difference of reflectance that an eye sees at the disk, 1/sr."""
SECCHI_DEVIATION = 0.18 * math.sqrt(math.pi / 2)
"""Relative standard deviation of `secchi_depth`: that of a normal distribution whose mean absolute
difference is 18 %, as from 338 measurements (same)."""


def black_disc_visibility(beam_attenuation: ArrayLike) -> Array:
    """Horizontal visibility of a black target, y = 4.8 / c, m.

    c is the beam attenuation, 1/m, photopic; that near 532 nm stands in for it. J. R. V. Zaneveld
    and W. S. Pegau, Robust underwater visibility parameter, Optics Express 11(23), 2003, doi
    10.1364/OE.11.002997.
    """
    return np.asarray(BLACK_DISC / np.asarray(beam_attenuation, np.float64))


def secchi_depth(diffuse_attenuation: ArrayLike, remote_sensing_reflectance: ArrayLike) -> Array:
    """Secchi disk depth, Z = ln(|0.14 − Rrs| / 0.013) / (2.5 min Kd), m.

    Takes Kd, 1/m, and Rrs, 1/sr, at the wavelength within 443 to 665 nm where Kd is least. Z. Lee
    et al., Secchi disk depth: A new theory and mechanistic model for underwater visibility, Remote
    Sensing of Environment 169, 2015, doi 10.1016/j.rse.2015.08.002.
    """
    contrast = np.abs(SECCHI_DISK_REFLECTANCE - np.asarray(remote_sensing_reflectance))
    lengths = np.log(contrast / SECCHI_CONTRAST)
    return np.asarray(lengths / (2.5 * np.asarray(diffuse_attenuation, np.float64)))


def remote_sensing_reflectance(absorption: ArrayLike, backscattering: ArrayLike) -> Array:
    """Remote-sensing reflectance Rrs of deep water, 1/sr, by a and b_b, 1/m.

    Z. Lee, K. L. Carder and R. A. Arnone, Deriving inherent optical properties from water color,
    Applied Optics 41(27), 2002, doi 10.1364/AO.41.005755: eq. 2, 3.
    """
    scattered = np.asarray(backscattering, np.float64)
    u = scattered / (np.asarray(absorption, np.float64) + scattered)
    below = (0.0895 + 0.1247 * u) * u
    return np.asarray(0.52 * below / (1.0 - 1.7 * below))
