# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Phase functions as tables that the tracer takes: over the cosine, at equal steps."""

from __future__ import annotations

import math

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility_lab.simulation.phase_functions import fournier_forand

HENYEY_GREENSTEIN, FOURNIER_FORAND = "henyey-greenstein", "fournier-forand"
PHASE_FUNCTIONS = (HENYEY_GREENSTEIN, FOURNIER_FORAND)

ENTRIES = 1 << 18
"""Of a table. What is scattered by less than its last step, 0.22°, is spread over that."""


def cosine_table(phase: str, entries: int = ENTRIES) -> Array:
    """Phase function over the cosine of the scattering angle, -1 .. 1 at equal steps.

    The table keeps what is scattered into each step, though the function has a pole at 0.

    Parameters
    ----------
    phase : str
        `FOURNIER_FORAND`.
    entries : int
        Length of the table.

    Returns
    -------
    ndarray
        (entries,) float64, 1/sr; its integral over the sphere, linear between entries, is 1.

    Raises
    ------
    InputError
        For a phase function that has no table.
    """
    if phase != FOURNIER_FORAND:
        raise InputError(f"no table of phase function {phase!r}: give {FOURNIER_FORAND}")
    step = 2.0 / (entries - 1)
    cosine = np.linspace(-1.0, 1.0, entries)
    table = fournier_forand(np.arccos(cosine[:-1]))
    within = 2.0 * math.pi * step * (table.sum() - 0.5 * (table[0] + table[-1]))
    # The rest of 1 is in the last step, a trapezium.
    last = 2.0 * (1.0 - within) / (2.0 * math.pi * step) - table[-1]
    return np.asarray(np.append(table, max(last, table[-1])))


def mean_cosine(table: Array) -> float:
    """Return the mean cosine of the scattering angle of a table, trapezium rule."""
    cosine = np.linspace(-1.0, 1.0, len(table))
    return float(np.trapezoid(table * cosine, cosine) / np.trapezoid(table, cosine))
