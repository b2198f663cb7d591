# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Check of the camera's transfer function by the shape of the dark envelope.

Water makes the dark envelope 1 − e^(−βd), with attenuations that differ between the channels as in
clear water, and the difference of bright and dark envelope e^(−βd). A wrong transfer bends the
first, so that no attenuations fit, or others than those of the second. An uncertain check adds to
the error of the estimate (Bayesian model averaging).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.transfer import linear_table
from uw_visibility.water.daylight.lower_envelope import DARK_BINS_ALIKE
from uw_visibility.water.daylight.veil_components import TEMPERATURE
from uw_visibility.water.observations import Envelopes

# How much likelier, as a logarithm, the envelopes are with the other transfer before that
# is told. Shade bends the envelope of real scenes too.
CERTAIN = 3.4
# Cameras whose transfer is not the one that was told, beforehand.
MISTOLD = 0.05
# Below this probability the other transfer leaves an estimate as it is; its logarithm of odds.
LEAST_PROBABILITY = 0.03
LEAST_ODDS = math.log(LEAST_PROBABILITY / (1.0 - LEAST_PROBABILITY) * (1.0 - MISTOLD) / MISTOLD)
# Largest ratio of attenuations by the two transfers.
LARGEST_CHANGE = 1.9
# Frames of a recording show one scene, so that they are no more than so many independent ones;
# what they say on average, the latest count, of at least so many, for the transfer to be told.
INDEPENDENT = 4
LATEST = 20
CERTAIN_TOGETHER = 1.7


@dataclass(frozen=True)
class OtherTransfer:
    """Fit of the envelopes with the other transfer, and its log odds.

    `parameters` and `as_told` are attenuation, 1/m, and veil, (3, 2), by the other and by the
    declared transfer; NaN in inactive channels.
    """

    log_odds: float
    parameters: Array
    as_told: Array

    @property
    def certain(self) -> bool:
        """Whether the transfer is certainly the other one."""
        return self.log_odds > CERTAIN

    def averaged(self, parameters: Array, covariance: Array) -> tuple[Array, Array]:
        """Mean and covariance of an estimate (3, 2), (6, 6) over both transfers.

        The brightness of the veil is a matter of exposure; only its colour changes.
        """
        share = _probability(self.log_odds)
        change = self.parameters / self.as_told
        change[:, 0] = np.clip(change[:, 0], 1.0 / LARGEST_CHANGE, LARGEST_CHANGE)
        change[:, 1] /= math.exp(float(np.nanmean(np.log(change[:, 1]))))
        error = (np.nan_to_num(change - 1.0) * parameters).ravel()
        return (
            parameters + share * error.reshape(3, 2),
            covariance + share * (1.0 - share) * np.outer(error, error))


class TransferVote:
    """Vote of a recording's frames on the camera's transfer, which all of them share."""

    def __init__(self) -> None:
        self._mean = 0.0
        self._frames = 0

    def add(self, log_odds: float) -> None:
        """Take in a frame's log odds of the other transfer, NaN if none; limited to `CERTAIN`."""
        if math.isnan(log_odds):
            return
        self._frames = min(self._frames + 1, LATEST)
        self._mean += (min(max(log_odds, -CERTAIN), CERTAIN) - self._mean) / self._frames

    @property
    def certain(self) -> bool:
        """Whether the transfer is certainly the other one."""
        return self._frames >= INDEPENDENT and self._mean > CERTAIN_TOGETHER


def negligible(log_odds: float) -> bool:
    """Whether log odds are so low that the other transfer changes no estimate."""
    return log_odds < LEAST_ODDS


def _probability(log_odds: float) -> float:
    odds = MISTOLD / (1.0 - MISTOLD) * math.exp(min(log_odds, CERTAIN))
    return odds / (1.0 + odds)


def other_transfer(envelope: Envelopes, transfer: str, active: Mask) -> tuple[Envelopes, float]:
    """Envelopes as they are if the camera has the other transfer.

    Also returns what the change of variables adds to their log likelihood in the active channels.
    """
    before, after, rise = _curve(transfer)
    slope = _interpolated(envelope.dark, before, rise)
    changed = replace(
        envelope, dark=_interpolated(envelope.dark, before, after),
        bright=_interpolated(envelope.bright, before, after), deviation=envelope.deviation * slope,
        step=envelope.step * slope)
    logarithm = np.log(np.maximum(slope, 1e-9))
    return changed, float(np.nansum(logarithm[active])) / (TEMPERATURE * DARK_BINS_ALIKE)


def other_veil(veil: Array, stddev: Array, transfer: str) -> tuple[Array, Array]:
    """Veil of open water and its standard deviation if the camera has the other transfer."""
    before, after, rise = _curve(transfer)
    return _interpolated(veil, before, after), stddev * _interpolated(veil, before, rise)


@lru_cache(maxsize=2)
def _curve(transfer: str) -> tuple[Array, Array, Array]:
    """Irradiance by the transfer, by the other one, and the slope of that over this."""
    table = linear_table("srgb", np.dtype(np.uint16)).astype(np.float64)
    codes = np.linspace(0.0, 1.0, len(table))
    before, after = (codes, table) if transfer == "linear" else (table, codes)
    return before, after, np.gradient(after, before)


def _interpolated(values: Array, before: Array, after: Array) -> Array:
    """Values of a function given at points; NaN stays NaN."""
    return np.asarray(np.interp(values, before, after))
