# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Transfer of the camera, told by the course of the dark envelope.

Water makes the dark envelope 1 − e^(−βd), with attenuations that differ between the
channels as those of clear water do, and the difference of bright and dark envelope
e^(−βd). Code values that are taken for linear and are not, or the reverse, bend the first
so that no attenuations fit, or others than those of the second. What is not certain is an
error of the estimate (Bayesian model averaging).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uw_visibility.optics.transfer import linear_table
from uw_visibility.water.lower_envelope import NEIGHBOURING_BINS
from uw_visibility.water.observations import Envelopes
from uw_visibility.water.veil_components import TEMPERATURE

# How much likelier, as a logarithm, the envelopes are with the other transfer before that
# is told. Shade bends the envelope of real scenes too.
CERTAIN = 3.4
# Cameras whose transfer is not the one that was told, beforehand.
MISTOLD = 0.05
# Below this probability the other transfer leaves an estimate as it is; its logarithm of odds.
NEGLIGIBLE = 0.03
NEGLIGIBLE_ODDS = math.log(NEGLIGIBLE / (1.0 - NEGLIGIBLE) * (1.0 - MISTOLD) / MISTOLD)
# Largest ratio of attenuations by the two transfers.
LARGEST_CHANGE = 1.9
# Frames of a recording show one scene, so that they are no more than so many independent ones;
# what they say on average, the latest count, of at least so many, for the transfer to be told.
INDEPENDENT = 4
LATEST = 20
CERTAIN_TOGETHER = 1.7


@dataclass(frozen=True)
class OtherTransfer:
    """What the envelopes say if the camera's transfer is the other one.

    Attributes
    ----------
    log_odds : float
        How much likelier the envelopes are so, as a logarithm.
    parameters, as_told : (3, 2) float64 ndarray
        Attenuation, 1/m, and veil with the other transfer and with that which was told;
        NaN in channels that do not count.
    """

    log_odds: float
    parameters: NDArray[np.float64]
    as_told: NDArray[np.float64]

    @property
    def certain(self) -> bool:
        """Whether the transfer is certainly the other one."""
        return self.log_odds > CERTAIN

    def averaged(
        self, parameters: NDArray[np.float64], covariance: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and covariance of an estimate over both transfers.

        Parameters
        ----------
        parameters : (3, 2) float64 ndarray
            Attenuation, 1/m, and veil, estimated with the transfer that was told.
        covariance : (6, 6) float64 ndarray
            Of them.

        Returns
        -------
        parameters, covariance
            How bright the veil is, is a matter of exposure; its colour changes.
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
    """What the frames of a recording say of the camera's transfer, which all of them have."""

    def __init__(self) -> None:
        self._mean = 0.0
        self._frames = 0

    def add(self, log_odds: float) -> None:
        """Take in how much likelier a frame is with the other transfer; NaN where it says nothing.

        Parameters
        ----------
        log_odds : float
            As a logarithm; beyond what makes a single frame certain, it counts no more.
        """
        if math.isnan(log_odds):
            return
        self._frames = min(self._frames + 1, LATEST)
        self._mean += (min(max(log_odds, -CERTAIN), CERTAIN) - self._mean) / self._frames

    @property
    def certain(self) -> bool:
        """Whether the transfer is certainly the other one."""
        return self._frames >= INDEPENDENT and self._mean > CERTAIN_TOGETHER


def negligible(log_odds: float) -> bool:
    """Whether a transfer so much likelier than that which was told leaves estimates as they are."""
    return log_odds < NEGLIGIBLE_ODDS


def _probability(log_odds: float) -> float:
    odds = MISTOLD / (1.0 - MISTOLD) * math.exp(min(log_odds, CERTAIN))
    return odds / (1.0 + odds)


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


def other_veil(
    veil: NDArray[np.float64], stddev: NDArray[np.float64], transfer: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return open water's veil and its standard deviation if the transfer is the other one."""
    before, after, rise = _curve(transfer)
    return _interpolated(veil, before, after), stddev * _interpolated(veil, before, rise)


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
