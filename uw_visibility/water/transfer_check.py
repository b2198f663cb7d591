# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Transfer of the camera, told by the course of the dark envelope.

Water makes the dark envelope 1 − e^(−βd), with attenuations that differ between the
channels as those of clear water do. Code values that are taken for linear and are not,
or the reverse, bend it so that no attenuations fit.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uw_visibility.optics.transfer import linear_table
from uw_visibility.water.lower_envelope import NEIGHBOURING_BINS
from uw_visibility.water.observations import Envelopes
from uw_visibility.water.veil import TEMPERATURE

# How much likelier, as a logarithm, the envelope is with the other transfer before that
# is told. Shade bends the envelope of real scenes too.
CERTAIN = 2.8


def other_transfer(envelope: Envelopes, transfer: str) -> tuple[Envelopes, float]:
    """Return the envelopes as they are if the camera's transfer is the other one.

    Parameters
    ----------
    envelope : Envelopes
        As the transfer gives them.
    transfer : str
        ``"linear"`` or ``"srgb"``.

    Returns
    -------
    envelope : Envelopes
        With ``"srgb"`` or ``"linear"``.
    change : float
        What the change of variables adds to the logarithm of their likelihood.
    """
    before, after, rise = _curve(transfer)
    slope = _interpolated(envelope.dark, before, rise)
    changed = replace(
        envelope,
        dark=_interpolated(envelope.dark, before, after),
        bright=_interpolated(envelope.bright, before, after),
        deviation=envelope.deviation * slope,
        step=envelope.step * slope,
    )
    logarithm = np.log(np.maximum(slope, 1e-9))
    return changed, float(np.nansum(logarithm)) / (TEMPERATURE * NEIGHBOURING_BINS)


@lru_cache(maxsize=2)
def _curve(
    transfer: str,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Irradiance by the transfer, that by the other one, and the slope of that over this."""
    table = linear_table("srgb", np.dtype(np.uint16)).astype(np.float64)
    codes = np.linspace(0.0, 1.0, len(table))
    before, after = (codes, table) if transfer == "linear" else (table, codes)
    return before, after, np.gradient(after, before)


def _interpolated(
    values: NDArray[np.float64], before: NDArray[np.float64], after: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Values of a function given at points; NaN stays NaN."""
    return np.asarray(np.interp(values, before, after))
