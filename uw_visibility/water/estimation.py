# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of attenuation and ambient light from pixels and ranges (eq. 4-7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.config import WaterConfig
from uw_visibility.errors import InputError
from uw_visibility.status import Status
from uw_visibility.water.fit import ATTENUATION_BOUNDS, Fit, fit_plain
from uw_visibility.water.lower_envelope import fit_lower_envelope
from uw_visibility.water.observations import Envelopes, observe

# Quantile of the dark envelope by method; the paper's is 1 % (eq. 4).
DARK_QUANTILE = {"paper": 0.01, "lower_envelope": 0.002}
BRIGHT_QUANTILE = 0.99
# The bright envelope is that of the third brightest bin: one or two bins may
# hold an animal's reflection or wrong ranges.
BRIGHT_BINS = 3
MIN_BINS = 6
# A channel is saturated, or dark, when more of its pixels than this are.
MAX_CLIPPED_FRACTION = 0.5
# A channel whose bright patches span fewer code values shows no course over range.
MIN_CODES = 4.0
# Attenuation is not assessable when its standard deviation is beyond both.
MAX_STDDEV = 0.1
MAX_RELATIVE_STDDEV = 0.5
# Ambient light is known from bright patches, which show as radiance beyond that
# of the dark ones at near range, or from water that is optically thick.
MIN_NEAR_RADIANCE = 0.25
MIN_OPTICAL_THICKNESS = 4.0


@dataclass(frozen=True)
class WaterEstimate:
    """What the water does to light, as one image shows it.

    Attributes
    ----------
    status : Status
        OK when all three channels are assessable, else the first reason why not.
    attenuation : (3,) float64 ndarray
        β for R, G, B, 1/m; NaN where not assessable.
    ambient_light : (3,) float64 ndarray
        I∞ for R, G, B, in units of irradiance; NaN where not assessable.
    covariance : (3, 2, 2) float64 ndarray
        Of (attenuation, ambient light), per channel; NaN where not assessable.
    iterations : int
        Iterations of the fit, the largest over the channels.
    bins : int
        Range bins used.
    channel_status : tuple of Status
        For R, G, B.
    envelope : Envelopes or None
        The observations that were fitted.
    joint_covariance : (6, 6) float64 ndarray or None
        Of β_R, I∞_R, β_G, I∞_G, β_B, I∞_B; None where the channels are taken
        as independent.
    """

    status: Status
    attenuation: NDArray[np.float64]
    ambient_light: NDArray[np.float64]
    covariance: NDArray[np.float64]
    iterations: int
    bins: int
    channel_status: tuple[Status, Status, Status]
    envelope: Envelopes | None = None
    joint_covariance: NDArray[np.float64] | None = None

    @property
    def attenuation_stddev(self) -> NDArray[np.float64]:
        """(3,) float64: standard deviation of the attenuation, 1/m."""
        return np.sqrt(self.covariance[:, 0, 0])

    @property
    def ambient_light_stddev(self) -> NDArray[np.float64]:
        """(3,) float64: standard deviation of the ambient light."""
        return np.sqrt(self.covariance[:, 1, 1])

    @classmethod
    def not_assessable(cls, reason: Status, envelope: Envelopes | None = None) -> WaterEstimate:
        """Return an estimate that says only why there is none."""
        return cls(
            status=reason,
            attenuation=np.full(3, np.nan),
            ambient_light=np.full(3, np.nan),
            covariance=np.full((3, 2, 2), np.nan),
            iterations=0,
            bins=0 if envelope is None else len(envelope.range),
            channel_status=(reason, reason, reason),
            envelope=envelope,
        )


class WaterEstimator:
    """Estimates the water's state; one instance may serve several threads.

    Parameters
    ----------
    config : WaterConfig
    clear_water_attenuation : (3,) array_like
        κ of the camera, 1/m.
    transfer : str
        How code values follow light: ``"linear"`` or ``"srgb"``.
    """

    def __init__(
        self, config: WaterConfig, clear_water_attenuation: ArrayLike, transfer: str = "linear"
    ) -> None:
        self._config = config
        self._clear_water = np.array(clear_water_attenuation, dtype=np.float64)
        self._transfer = transfer

    def estimate(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None = None,
        start: WaterEstimate | None = None,
        range_error: float = 0.0,
    ) -> WaterEstimate:
        """Estimate attenuation and ambient light.

        Parameters
        ----------
        image : (H, W, 3) ndarray of uint8, uint16 or float32
            RGB code values; float32 is linear irradiance 0..1. A (H, W) image
            has no colour and is not assessable.
        range_map : (H, W) ndarray of float
            Range along the line of sight, m; NaN where unknown.
        valid : (H, W) bool ndarray, optional
            Pixels that may count.
        start : WaterEstimate, optional
            An earlier estimate to start from.
        range_error : float
            Standard deviation of range over its square, 1/m: that of the
            disparity over focal length times baseline.

        Returns
        -------
        WaterEstimate

        Raises
        ------
        InputError
            If shapes or types do not fit.
        """
        _check(image, range_map, valid)
        if image.ndim == 2 or image.shape[2] == 1:
            return WaterEstimate.not_assessable(Status.NO_COLOUR)
        codes, envelope = self._observe(image, range_map, valid)
        reason = self._refuse_frame(codes, envelope)
        if reason is Status.OK and envelope.grey:
            reason = Status.NO_COLOUR
        if reason is not Status.OK:
            return WaterEstimate.not_assessable(reason, envelope)
        status = [_refuse_channel(envelope, channel) for channel in range(3)]
        active = np.array([reason is Status.OK for reason in status])
        if not active.any():
            return WaterEstimate.not_assessable(status[0], envelope)
        fit = self._fit(envelope, active, start, range_error, self._clear_water)
        for channel in np.flatnonzero(active):
            status[channel] = _judge(fit, envelope, int(channel))
        return _assemble(fit, envelope, status)

    def estimate_grey(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None = None,
    ) -> tuple[float, float] | None:
        """Estimate attenuation and ambient light of a single channel, to restore its contrast.

        Parameters
        ----------
        image : (H, W) ndarray of uint8, uint16 or float32
            Code values; float32 is linear irradiance 0..1.
        range_map : (H, W) ndarray of float
            Range along the line of sight, m; NaN where unknown.
        valid : (H, W) bool ndarray, optional
            Pixels that may count.

        Returns
        -------
        tuple of float, or None
            Attenuation, 1/m, and ambient light in units of irradiance; None
            where they are not assessable. A grey camera's response is taken
            to reach the least attenuated channel.

        Raises
        ------
        InputError
            If shapes or types do not fit.
        """
        _check(image, range_map, valid)
        codes, envelope = self._observe(np.dstack((image,) * 3), range_map, valid)
        if self._refuse_frame(codes, envelope) is not Status.OK:
            return None
        if _refuse_channel(envelope, 0) is not Status.OK:
            return None
        alone = np.array([True, False, False])
        fit = self._fit(envelope, alone, None, 0.0, np.full(3, self._clear_water.min()))
        if _judge(fit, envelope, 0) is not Status.OK:
            return None
        attenuation, ambient_light = fit.parameters[0]
        return float(attenuation), float(ambient_light)

    def _observe(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None,
    ) -> tuple[NDArray[Any], Envelopes]:
        config = self._config
        codes, transfer = _codes(image, self._transfer)
        envelope = observe(
            codes,
            np.ascontiguousarray(range_map, dtype=np.float32),
            None if valid is None else np.ascontiguousarray(valid),
            transfer=transfer,
            bins=config.bins,
            min_pixels=config.min_bin_pixels,
            edge_tolerance=config.edge_tolerance,
            dark_quantile=DARK_QUANTILE[config.method],
            bright_quantile=BRIGHT_QUANTILE,
            denoise=config.method != "paper",
        )
        return codes, envelope

    def _refuse_frame(self, codes: NDArray[Any], envelope: Envelopes) -> Status:
        """Say why no channel is assessable, if so."""
        needed = self._config.min_bin_pixels * MIN_BINS
        if envelope.pixels < needed:
            # Nothing counted: are there no ranges, or is there no light?
            return Status.TOO_DARK if not codes.any() else Status.TOO_FEW_OBSERVATIONS
        if (envelope.saturated > MAX_CLIPPED_FRACTION).all():
            return Status.SATURATED
        if len(envelope.range) == 0:
            return Status.TOO_FEW_OBSERVATIONS
        if envelope.range[-1] < self._config.min_range_ratio * envelope.range[0]:
            return Status.RANGE_SPREAD_TOO_SMALL
        if len(envelope.range) < MIN_BINS:
            return Status.TOO_FEW_OBSERVATIONS
        return Status.OK

    def _fit(
        self,
        envelope: Envelopes,
        active: NDArray[np.bool_],
        start: WaterEstimate | None,
        range_error: float,
        clear_water: NDArray[np.float64],
    ) -> Fit:
        ambient_min = np.array([_bright(envelope, c) if active[c] else 1.0 for c in range(3)])
        brightest = [np.nanmax(envelope.bright[c]) if active[c] else 1.0 for c in range(3)]
        first = np.stack((clear_water, brightest), axis=1)
        if start is not None:
            known = np.isfinite(start.attenuation)
            first[known, 0] = start.attenuation[known]
            first[known, 1] = start.ambient_light[known]
        if self._config.method == "paper":
            return fit_plain(envelope.range, envelope.dark, ambient_min, first, active)
        return fit_lower_envelope(
            envelope.range, envelope.dark, envelope.deviation, ambient_min, first,
            clear_water, active, range_error,
        )


def _check(
    image: NDArray[Any], range_map: NDArray[np.floating], valid: NDArray[np.bool_] | None
) -> None:
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        raise InputError(f"the image is of type {image.dtype}: give uint8, uint16 or float32")
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3)):
        raise InputError(f"the image has the shape {image.shape}: give (H, W, 3) or (H, W)")
    if range_map.shape != image.shape[:2]:
        raise InputError(
            f"the range map has the shape {range_map.shape}, the image {image.shape[:2]}: "
            "give one range per pixel"
        )
    if valid is not None and (valid.shape != range_map.shape or valid.dtype != np.bool_):
        raise InputError("the mask of valid pixels must be boolean, of the image's size")


def _codes(image: NDArray[Any], transfer: str) -> tuple[NDArray[Any], str]:
    """Return contiguous code values and their transfer; irradiance becomes 16-bit codes."""
    if image.dtype != np.float32:
        return np.ascontiguousarray(image), transfer
    light = np.nan_to_num(np.clip(image, 0.0, 1.0), nan=0.0)
    return (light * 65535 + 0.5).astype(np.uint16), "linear"


def _refuse_channel(envelope: Envelopes, channel: int) -> Status:
    """Say why a channel cannot be fitted, if so."""
    if envelope.saturated[channel] > MAX_CLIPPED_FRACTION:
        return Status.SATURATED
    known = np.isfinite(envelope.dark[channel])
    if known.sum() < MIN_BINS:
        return Status.SATURATED if not known.all() else Status.TOO_FEW_OBSERVATIONS
    too_dark = _bright(envelope, channel) < MIN_CODES * np.nanmin(envelope.step[channel])
    if too_dark or envelope.zero[channel] > MAX_CLIPPED_FRACTION:
        return Status.TOO_DARK
    return Status.OK


def _judge(fit: Fit, envelope: Envelopes, channel: int) -> Status:
    """Say whether the fit of a channel holds."""
    attenuation, ambient = fit.parameters[channel]
    variance = np.diag(fit.covariance)[2 * channel:2 * channel + 2]
    if not fit.converged or not np.isfinite(variance).all() or (variance < 0).any():
        return Status.FIT_FAILED
    if attenuation >= ATTENUATION_BOUNDS[1]:
        return Status.FIT_FAILED
    stddev = np.sqrt(variance[0])
    near = slice(0, -(-len(envelope.range) // 4))
    direct = ambient * np.exp(-attenuation * envelope.range[near])
    bright, dark = envelope.bright[channel, near], envelope.dark[channel, near]
    radiance = np.max(np.nan_to_num((bright - dark) / direct))
    thickness = attenuation * envelope.range[-1]
    if radiance < MIN_NEAR_RADIANCE and thickness < MIN_OPTICAL_THICKNESS:
        return Status.AMBIENT_LIGHT_UNBOUNDED
    if stddev > max(MAX_STDDEV, MAX_RELATIVE_STDDEV * attenuation):
        return Status.RANGE_SPREAD_TOO_SMALL
    return Status.OK


def _assemble(fit: Fit, envelope: Envelopes, status: list[Status]) -> WaterEstimate:
    refused = np.array([reason is not Status.OK for reason in status])
    parameters = np.where(refused[:, np.newaxis], np.nan, fit.parameters)
    joint = fit.covariance.copy()
    joint[np.repeat(refused, 2), :] = np.nan
    joint[:, np.repeat(refused, 2)] = np.nan
    return WaterEstimate(
        status=next((reason for reason in status if reason is not Status.OK), Status.OK),
        attenuation=parameters[:, 0],
        ambient_light=parameters[:, 1],
        covariance=np.stack([joint[2 * c:2 * c + 2, 2 * c:2 * c + 2] for c in range(3)]),
        iterations=fit.iterations,
        bins=len(envelope.range),
        channel_status=(status[0], status[1], status[2]),
        envelope=envelope,
        joint_covariance=joint,
    )


def _bright(envelope: Envelopes, channel: int) -> float:
    """Irradiance that ambient light has at least: the bright envelope (eq. 7)."""
    bright = envelope.bright[channel]
    ordered = np.sort(bright[np.isfinite(bright)])
    return float(ordered[-min(BRIGHT_BINS, len(ordered))])
