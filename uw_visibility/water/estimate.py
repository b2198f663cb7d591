# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimate of the water's state, from one image or several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.status import Status
from uw_visibility.water.blocks import Blocks
from uw_visibility.water.lamps.nodes import Nodes
from uw_visibility.water.lamps.tracks import GroundView
from uw_visibility.water.observations import Envelopes

# Quantiles one standard deviation below, and above, the middle of a normal distribution.
ONE_SIGMA = np.array((0.16, 0.5, 0.84))


@dataclass(frozen=True)
class LampLight:
    """Light of lamps and water, with which images under lamps are restored."""

    attenuation: Array  # (3,), β, 1/m
    power: Array  # (3,), irradiance of white at 1 m of a lamp of relative power 1, without water
    scattering: Array  # (3,), irradiance of the light that the water scatters, over the tables'
    daylight: Array  # (3,), irradiance of white by daylight; 0 without
    veil: Array  # (3,), irradiance of the water at infinity by daylight; 0 without
    nodes: Nodes | None = None  # nodes of the frame, for a survey
    ground: GroundView | None = None  # reduced frame, in which a survey tracks points of the ground


@dataclass(frozen=True)
class WaterEstimate:
    """Attenuation and light of the water, estimated from one image or several.

    Attributes
    ----------
    status : Status
        That of all channels together, see `overall_status`: a channel without light counts
        only where no channel has any.
    attenuation : (3,) float64 ndarray
        β for R, G, B, 1/m; NaN where not assessable.
    ambient_light : (3,) float64 ndarray
        I∞ for R, G, B, in units of irradiance; NaN where not assessable. Where veil and
        light are told apart, it is the veil B.
    covariance : (6, 6) float64 ndarray
        Of β_R, I∞_R, β_G, I∞_G, β_B, I∞_B; NaN where not assessable.
    iterations : int
        Iterations of the fit, the largest over the channels.
    bins : int
        Range bins used.
    channel_status : tuple of Status
        For R, G, B.
    envelope : Envelopes or None
        The observations that were fitted.
    light : (3,) float64 ndarray or None
        Light W on the scene; None where it is the veil, as in the paper. See
        `scene_light`.
    light_covariance : (3, 3) float64 ndarray or None
        Covariance of ln W: channels are off alike, so that the light's colour is better known than
        its level. None where `light` is.
    clearest : (3,) float64 ndarray or None
        16, 50 and 84 % of −ln min β over the channels, β in 1/m; None where it is as β and
        its covariance say.
    blocks : Blocks or None
        Some of the blocks of pixels that were used, for a survey.
    lamps : LampLight or None
        Light of the lamps, where they light the scene.
    grey_on_average : bool
        Whether the image's channels have about the same mean, as automatic white balance
        makes them.
    blue_as_green : bool
        Whether green and blue have the same mean, and red a lower one.
    transfer_log_odds : float
        Log odds that the camera's transfer is not the configured one; NaN if unknown.
    lamps_log_odds : float
        Log odds that undeclared lamps light the image instead of daylight; NaN if unknown, or if
        lamps are declared.
    """

    status: Status
    attenuation: Array
    ambient_light: Array
    covariance: Array
    iterations: int
    bins: int
    channel_status: tuple[Status, Status, Status]
    envelope: Envelopes | None = None
    light: Array | None = None
    light_covariance: Array | None = None
    clearest: Array | None = None
    blocks: Blocks | None = None
    lamps: LampLight | None = None
    grey_on_average: bool = False
    blue_as_green: bool = False
    transfer_log_odds: float = math.nan
    lamps_log_odds: float = math.nan

    @property
    def veil(self) -> Array:
        """(3,) float64: veil B, what the water adds at infinity; the same as `ambient_light`."""
        return self.ambient_light

    @property
    def scene_light(self) -> Array:
        """(3,) float64: light W on the scene, the irradiance of white with no water between."""
        return self.ambient_light if self.light is None else self.light

    @property
    def scene_light_stddev(self) -> Array:
        """(3,) float64: standard deviation of the light on the scene."""
        if self.light_covariance is None:
            return self.ambient_light_stddev
        return self.scene_light * np.sqrt(np.diag(self.light_covariance))

    @property
    def attenuation_stddev(self) -> Array:
        """(3,) float64: standard deviation of the attenuation, 1/m."""
        return np.sqrt(np.diag(self.covariance)[0::2])

    @property
    def ambient_light_stddev(self) -> Array:
        """(3,) float64: standard deviation of the ambient light."""
        return np.sqrt(np.diag(self.covariance)[1::2])

    @property
    def refused_in_light(self) -> Mask:
        """(3,) bool: channels not assessable, and not because they are too dark.

        They still show the scene.
        """
        dark = np.array([reason is Status.TOO_DARK for reason in self.channel_status])
        return np.isnan(self.attenuation) & ~dark

    @classmethod
    def not_assessable(cls, reason: Status, envelope: Envelopes | None = None) -> WaterEstimate:
        """Return an estimate without values, with the reason."""
        return cls(
            status=reason, attenuation=np.full(3, np.nan), ambient_light=np.full(3, np.nan),
            covariance=np.full((6, 6), np.nan), iterations=0,
            bins=0 if envelope is None else len(envelope.range),
            channel_status=(reason, reason, reason), envelope=envelope)


def one_sigma(values: Array, weight: Array) -> Array:
    """16, 50 and 84 % of values, (D,), whose weights sum to 1."""
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weight[order]) - 0.5 * weight[order]
    return np.interp(ONE_SIGMA, reached, values[order])


def widened(quantiles: Array, deviation: float) -> Array:
    """Widen quantiles of a logarithm, the median in the middle, by an independent error."""
    away = quantiles - quantiles[len(quantiles) // 2]
    return np.asarray(quantiles - away + np.sign(away) * np.hypot(away, deviation))


def overall_status(channels: Sequence[Status]) -> Status:
    """Status of an estimate from those of its channels.

    Channels without light, such as red below some 10 m, do not count: TOO_DARK where all are, else
    OK where all others are, else the first reason why one of these is not.
    """
    lit = [status for status in channels if status is not Status.TOO_DARK]
    if not lit:
        return Status.TOO_DARK
    return next((status for status in lit if status is not Status.OK), Status.OK)


def of_channels(
    status: Sequence[Status], attenuation: Array, ambient_light: Array, covariance: Array
) -> dict[str, Any]:
    """Fields of an estimate, from its channels and their covariance, (6, 6)."""
    return {
        "status": overall_status(status), "channel_status": tuple(status),
        "attenuation": attenuation, "ambient_light": ambient_light,
        "covariance": covariance}


def passed(status: Sequence[Status]) -> Mask:
    """(3,) bool: channels that are not refused."""
    return np.array([reason is Status.OK for reason in status])


def refuse(status: list[Status], reason: Status) -> list[Status]:
    """Refuse every channel that is not refused yet; none where the reason is OK."""
    return [reason if before is Status.OK else before for before in status]


def blank(covariance: Array, known: Mask) -> Array:
    """Copy of a (6, 6) covariance with NaN for unknown channels, (3,), or parameters, (6,)."""
    both = np.repeat(known, 6 // len(known))
    return np.where(np.outer(both, both), covariance, np.nan)
