# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Phase functions as tables that the tracer takes: over the cosine, at equal steps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility_lab.simulation.phase_functions import (
    FOURNIER_FORAND,
    HENYEY_GREENSTEIN,
    fournier_forand,
)

PETZOLD = "petzold"

ENTRIES = 1 << 18
"""Of a table. What is scattered by less than its last step, 0.22°, is spread over that."""

PETZOLD_AVERAGE = (
    (0.100, 1.76661e3), (0.126, 1.29564e3), (0.158, 9.50172e2), (0.200, 6.99092e2),
    (0.251, 5.13687e2), (0.316, 3.76373e2), (0.398, 2.76318e2), (0.501, 2.18839e2),
    (0.631, 1.44369e2), (0.794, 1.02241e2), (1.000, 7.16082e1), (1.259, 4.95803e1),
    (1.585, 3.39511e1), (1.995, 2.28129e1), (2.512, 1.51622e1), (3.162, 1.00154e1),
    (3.981, 6.57957), (5.012, 4.29530), (6.310, 2.80690), (7.943, 1.81927), (10.0, 1.15257),
    (15.0, 4.89344e-1), (20.0, 2.44424e-1), (25.0, 1.47151e-1), (30.0, 8.60848e-2),
    (35.0, 5.93075e-2), (40.0, 4.20985e-2), (45.0, 3.06722e-2), (50.0, 2.27533e-2),
    (55.0, 1.69904e-2), (60.0, 1.31254e-2), (65.0, 1.04625e-2), (70.0, 8.48826e-3),
    (75.0, 6.97601e-3), (80.0, 5.84232e-3), (85.0, 4.95306e-3), (90.0, 4.29232e-3),
    (95.0, 3.78161e-3), (100.0, 3.40405e-3), (105.0, 3.11591e-3), (110.0, 2.91222e-3),
    (115.0, 2.79696e-3), (120.0, 2.68568e-3), (125.0, 2.57142e-3), (130.0, 2.47603e-3),
    (135.0, 2.37667e-3), (140.0, 2.32898e-3), (145.0, 2.31308e-3), (150.0, 2.36475e-3),
    (155.0, 2.50584e-3), (160.0, 2.66183e-3), (165.0, 2.83472e-3), (170.0, 3.03046e-3),
    (175.0, 3.09206e-3), (180.0, 3.15366e-3))
"""Degrees and 1/sr: average of three of T. J. Petzold's waters (Volume Scattering Functions for
Selected Ocean Waters, SIO Ref. 72-78, 1972). C. D. Mobley, Light and Water (1994), table 3.10,
which gives its mean cosine as 0.924 and its share backwards as 0.0183: so they are here. The values
were not compared with the book one by one."""


def petzold(angle: ArrayLike) -> Array:
    """Petzold's average phase function in 1/sr over the scattering angle in rad, above 0.

    Its logarithm is linear in that of the angle between the values, and goes on so below 0.1°.
    """
    known = np.array(PETZOLD_AVERAGE)
    place, level = np.log(np.radians(known[:, 0])), np.log(known[:, 1])
    slope = np.polyfit(place[:5], level[:5], 1)[0]
    asked = np.log(angle)
    below = level[0] + slope * (asked - place[0])
    return np.asarray(np.exp(np.where(
        asked < place[0], below, np.interp(asked, place, level))))


def cosine_table(phase: str, entries: int = ENTRIES) -> Array:
    """Phase function over the cosine of the scattering angle, -1 .. 1 at equal steps.

    The table keeps what is scattered into each step, though the function has a pole at 0.

    phase: `FOURNIER_FORAND` or `PETZOLD`.
    Returns (entries,) float64, 1/sr; its integral over the sphere, linear between entries, is 1.
    Raises `InputError` for a phase function that has no table.
    """
    measured = {FOURNIER_FORAND: fournier_forand, PETZOLD: petzold}
    if phase not in measured:
        raise InputError(
            f"no table of phase function {phase!r}: give one of {', '.join(measured)}")
    step = 2.0 / (entries - 1)
    cosine = np.linspace(-1.0, 1.0, entries)
    table = measured[phase](np.arccos(cosine[:-1]))
    within = 2.0 * math.pi * step * (table.sum() - 0.5 * (table[0] + table[-1]))
    # The rest of 1 is in the last step, a trapezium.
    last = 2.0 * (1.0 - within) / (2.0 * math.pi * step) - table[-1]
    return np.asarray(np.append(table, max(last, table[-1])))


def phase_of(phase: str, asymmetry: float) -> dict[str, Any]:
    """Return a phase function as Mitsuba takes it; `asymmetry` is Henyey-Greenstein's."""
    if phase == HENYEY_GREENSTEIN:
        return {"type": "hg", "g": asymmetry}
    return {"type": "tabphase", "values": ",".join(f"{v:.6g}" for v in cosine_table(phase))}
