# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of attenuation and ambient light from pixels and ranges (eq. 4-7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.config.schema import WaterConfig
from uw_visibility.errors import InputError
from uw_visibility.images.view import ColourSamples, View
from uw_visibility.status import Status
from uw_visibility.water.fit import Fit, fit_plain
from uw_visibility.water.lower_envelope import fit_lower_envelope
from uw_visibility.water.observations import Envelopes, observe
from uw_visibility.water.priors import Daylight, fuse
from uw_visibility.water.validation import (
    black_attenuation,
    brightest_patch,
    least_ambient_light,
    refuse_channel,
    refuse_frame,
    validate_fit,
)

# Dark envelope: its quantile, and the pixels below it at least. The paper takes
# 1 % (eq. 4). The darkest 5 pixels are a patch rather than a speck; where ranges
# are interpolated, more of them are wrong.
PLAIN_DARK = (0.01, 0.5)
DARK = (0.0002, 5.0)
COARSE_DARK = (0.002, 20.0)
BRIGHT_QUANTILE = 0.99


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
    daylight : Daylight, optional
        What is known of the colour of the ambient light; nothing by default.
    """

    def __init__(
        self,
        config: WaterConfig,
        clear_water_attenuation: ArrayLike,
        transfer: str = "linear",
        daylight: Daylight | None = None,
    ) -> None:
        self._config = config
        self._clear_water = np.array(clear_water_attenuation, dtype=np.float64)
        self._transfer = transfer
        self._daylight = daylight

    def estimate(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None = None,
        start: WaterEstimate | None = None,
        range_error: float = 0.0,
        coarse: bool = False,
    ) -> WaterEstimate:
        """Estimate attenuation and ambient light from plain arrays.

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
            disparity over focal length times baseline. 0 stands for exact
            ranges, which hold up to the edges of things.
        coarse : bool
            Whether ranges are interpolated between points, as in a mesh.

        Returns
        -------
        WaterEstimate

        Raises
        ------
        InputError
            If shapes or types do not fit.
        """
        view = self._as_view(image, range_map, valid)
        return self.estimate_view(
            view, range_map, start=start, range_error=range_error, coarse=coarse)

    def estimate_view(
        self,
        view: View,
        range_map: NDArray[np.floating],
        *,
        start: WaterEstimate | None = None,
        range_error: float = 0.0,
        coarse: bool = False,
    ) -> WaterEstimate:
        """Estimate attenuation and ambient light from a view, whose noise is known.

        Parameters
        ----------
        view : View
            A grey one has no colour and is not assessable.
        range_map, start, range_error, coarse
            See `estimate`.

        Returns
        -------
        WaterEstimate
        """
        if view.colour is None:
            return WaterEstimate.not_assessable(Status.NO_COLOUR)
        envelope = self._observe(view.colour, range_map, view.valid, range_error, coarse)
        reason = self._refuse_frame(view.colour, envelope)
        if reason is Status.OK and envelope.grey:
            reason = Status.NO_COLOUR
        if reason is not Status.OK:
            return WaterEstimate.not_assessable(reason, envelope)
        status = [refuse_channel(envelope, channel) for channel in range(3)]
        active = np.array([reason is Status.OK for reason in status])
        if not active.any():
            return WaterEstimate.not_assessable(status[0], envelope)
        fit = self._fit(envelope, active, start, range_error, self._clear_water)
        for channel in np.flatnonzero(active):
            status[channel] = validate_fit(fit, envelope, int(channel))
        if self._config.method != "paper" and all(reason is Status.OK for reason in status):
            ambient_min = np.array([least_ambient_light(envelope, c) for c in range(3)])
            fit = fuse(
                fit, self._clear_water, ambient_min, self._daylight,
                self._config.daylight_tolerance)
        return _assemble(fit, envelope, status)

    def estimate_grey(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None = None,
        range_error: float = 0.0,
        coarse: bool = False,
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
        range_error, coarse
            See `estimate`.

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
        view = self._as_view(image, range_map, valid)
        return self.estimate_grey_view(view, range_map, range_error=range_error, coarse=coarse)

    def estimate_grey_view(
        self,
        view: View,
        range_map: NDArray[np.floating],
        *,
        range_error: float = 0.0,
        coarse: bool = False,
    ) -> tuple[float, float] | None:
        """Estimate attenuation and ambient light of a grey view; see `estimate_grey`."""
        samples = ColourSamples(
            np.dstack((view.pixels,) * 3), view.transfer, np.repeat(view.noise, 3))
        envelope = self._observe(samples, range_map, view.valid, range_error, coarse)
        if self._refuse_frame(samples, envelope) is not Status.OK:
            return None
        if refuse_channel(envelope, 0) is not Status.OK:
            return None
        alone = np.array([True, False, False])
        fit = self._fit(envelope, alone, None, range_error, np.full(3, self._clear_water.min()))
        if validate_fit(fit, envelope, 0) is not Status.OK:
            return None
        attenuation, ambient_light = fit.parameters[0]
        return float(attenuation), float(ambient_light)

    def _as_view(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None,
    ) -> View:
        _check(image, range_map, valid)
        image = image[..., 0] if image.shape[2:] == (1,) else image
        codes, transfer = _codes(image, self._transfer)
        return View.of(codes, transfer, valid)

    def _observe(
        self,
        samples: ColourSamples,
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None,
        range_error: float,
        coarse: bool,
    ) -> Envelopes:
        config = self._config
        plain = config.method == "paper"
        dark_quantile, fewest_dark = PLAIN_DARK if plain else COARSE_DARK if coarse else DARK
        ranges, valid = samples.reduce(np.asarray(range_map, dtype=np.float32), valid)
        return observe(
            samples,
            np.ascontiguousarray(ranges),
            None if valid is None else np.ascontiguousarray(valid),
            bins=config.bins,
            min_pixels=int(samples.count(config.min_bin_pixels)),
            edge_tolerance=config.edge_tolerance,
            dark_quantile=dark_quantile,
            fewest_dark=samples.count(fewest_dark),
            bright_quantile=BRIGHT_QUANTILE,
            range_error=range_error,
            plain=plain,
        )

    def _refuse_frame(self, samples: ColourSamples, envelope: Envelopes) -> Status:
        fewest = int(samples.count(self._config.min_bin_pixels))
        return refuse_frame(envelope, samples.pixels, fewest, self._config.min_range_ratio)

    def _fit(
        self,
        envelope: Envelopes,
        active: NDArray[np.bool_],
        start: WaterEstimate | None,
        range_error: float,
        clear_water: NDArray[np.float64],
    ) -> Fit:
        ambient_min = np.array(
            [least_ambient_light(envelope, c) if active[c] else 1.0 for c in range(3)])
        plain = self._config.method == "paper"
        first = np.stack((clear_water, ambient_min), axis=1)
        for c in np.flatnonzero(active):
            if plain:
                first[c, 1] = np.nanmax(envelope.bright[c])
            else:
                # From above: what is brighter than the curve of the water holds it less.
                first[c, 0] = np.median(black_attenuation(envelope, int(c), ambient_min[c]))
        if start is not None:
            known = np.isfinite(start.attenuation)
            first[known, 0] = start.attenuation[known]
            first[known, 1] = start.ambient_light[known]
        if plain:
            return fit_plain(envelope.range, envelope.dark, ambient_min, first, active)
        return fit_lower_envelope(
            envelope.dark_range, envelope.dark, envelope.deviation, ambient_min, first,
            clear_water, active, range_error,
            np.array([brightest_patch(envelope, c) for c in range(3)]),
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
