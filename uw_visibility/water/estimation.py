# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of attenuation and ambient light from pixels and ranges (eq. 4-7)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.config.schema import WaterConfig
from uw_visibility.errors import InputError
from uw_visibility.images.pair import check_valid
from uw_visibility.images.view import ColourSamples, View
from uw_visibility.status import Status
from uw_visibility.water.contrast import Decay
from uw_visibility.water.cues import Cues, Observations, coarse_cues, gather_cues
from uw_visibility.water.dark_fit import brightest, fit_one_light, fit_other_transfer
from uw_visibility.water.estimate import WaterEstimate, assemble, refuse
from uw_visibility.water.fit import blank
from uw_visibility.water.grey_average import colour_balance
from uw_visibility.water.observations import Envelopes, observe
from uw_visibility.water.position import compare_halves
from uw_visibility.water.priors import Daylight, fuse
from uw_visibility.water.transfer_check import NEGLIGIBLE_ODDS
from uw_visibility.water.validation import (
    least_ambient_light,
    lit_by_lamps,
    refuse_channel,
    refuse_frame,
    refute_clearness,
    validate_fit,
)
from uw_visibility.water.veil import CONTRADICTION
from uw_visibility.water.veil_fitter import VeilFitter

# Dark envelope: its quantile, and the pixels below it at least. The paper takes
# 1 % (eq. 4). The darkest 5 pixels are a patch rather than a speck; where ranges are
# interpolated or measured, some are wrong: a dark near thing that is taken for a far one is
# darker than all that is there. With one light, bins below the envelope count less instead.
PLAIN_DARK = (0.01, 0.5)
DARK = (0.0002, 5.0)
MEASURED_DARK = (0.002, 20.0)
# Pixels of an image from which on they are so many; where ranges are measured in smaller ones
# they are fewer, since 20 are many of a bin there.
MEASURED_PIXELS = 320 * 240
BRIGHT_QUANTILE = 0.99
# What attenuation and ambient light are off by where the paper's model holds, as a part of
# them: where water is thick, the fit knows of noise alone.
ATTENUATION_ERROR = 0.02
AMBIENT_ERROR = 0.01
# What a JPEG that nobody told of leaves attenuation off by, as a part of it, in a channel
# without light: it rounds colour, and so the dim channels, to the light of the bright one.
COMPRESSION_ERROR = 0.45


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
        self._fitter = VeilFitter(self._clear_water, daylight, config.daylight_tolerance)

    def estimate(
        self,
        image: NDArray[Any],
        range_map: NDArray[np.floating],
        valid: NDArray[np.bool_] | None = None,
        start: WaterEstimate | None = None,
        *,
        range_error: float,
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
            disparity over focal length times baseline, which
            `StereoRig.range_error` gives. Whoever made the ranges knows it, so it
            has no default: 0 stands for exact ranges, which hold up to the edges
            of things, and measured ones that pass for exact bias the attenuation.
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
        check_arrays(image, range_map, valid)
        image = image[..., 0] if image.shape[2:] == (1,) else image
        view = View.of(*_codes(image, self._transfer), valid)
        return self.estimate_view(
            view, range_map, start=start, range_error=range_error, coarse=coarse)

    def estimate_view(
        self,
        view: View,
        range_map: NDArray[np.floating],
        *,
        range_error: float,
        start: WaterEstimate | None = None,
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
        colour = view.colour
        if colour is None:
            return WaterEstimate.not_assessable(Status.NO_COLOUR)
        envelope = self._observe(colour, range_map, view.valid, range_error, coarse)
        if envelope.pixels == 0 and not colour.pixels.any():
            return WaterEstimate.not_assessable(Status.TOO_DARK, envelope)
        estimate = self._estimate(
            envelope, self._fewest_pixels(colour), start,
            lambda active: coarse_cues(envelope, active) if coarse else gather_cues(
                colour, np.asarray(range_map, np.float32), view.valid, envelope, active,
                lambda pixels: self._observe(
                    pixels, range_map, view.valid, range_error, coarse)))
        balance = colour_balance(view.pixels)
        return replace(
            estimate, grey_on_average=balance.grey, blue_as_green=balance.blue_as_green)

    def estimate_envelope(
        self,
        envelope: Envelopes,
        contrast: Decay | None = None,
    ) -> WaterEstimate:
        """Estimate attenuation and ambient light from envelopes alone, as those of many frames.

        Parameters
        ----------
        envelope : Envelopes
        contrast : Decay, optional
            Decay of contrast with range, where veil and light are told apart.

        Returns
        -------
        WaterEstimate
        """
        return self._estimate(
            envelope, self._config.min_bin_pixels, None, lambda active: Cues(contrast))

    def _estimate(
        self,
        envelope: Envelopes,
        fewest_pixels: int,
        start: WaterEstimate | None,
        cues: Callable[[NDArray[np.bool_]], Cues],
    ) -> WaterEstimate:
        """Validate, fit, validate the fit; `cues` gives those beside the envelopes."""
        reason = refuse_frame(envelope, fewest_pixels, self._config.min_range_ratio)
        if reason is not Status.OK:
            return WaterEstimate.not_assessable(reason, envelope)
        if lit_by_lamps(envelope):
            return WaterEstimate.not_assessable(Status.LIT_BY_LAMPS, envelope)
        if envelope.grey:
            return WaterEstimate.not_assessable(Status.NO_COLOUR, envelope)
        status = [refuse_channel(envelope, channel) for channel in range(3)]
        active = np.array([reason is Status.OK for reason in status])
        if not active.any():
            return WaterEstimate.not_assessable(status[0], envelope)
        if self._config.method != "paper" and self._config.veil == "free":
            return self._estimate_free_veil(
                envelope, status, active, cues(active))
        fit = fit_one_light(
            envelope, active, start, envelope.range_error, self._clear_water,
            self._config.method == "paper")
        for channel in np.flatnonzero(active):
            status[channel] = validate_fit(fit, envelope, int(channel))
        if self._config.method != "paper" and all(reason is Status.OK for reason in status):
            ambient_min = np.array([least_ambient_light(envelope, c) for c in range(3)])
            fit = fuse(
                fit, self._clear_water, ambient_min, self._daylight,
                self._config.daylight_tolerance)
            covariance = fit.covariance.copy()
            error = np.array((ATTENUATION_ERROR, AMBIENT_ERROR)) * fit.parameters
            covariance += np.diag(error.ravel() ** 2)
            fit = replace(fit, covariance=covariance)
        # Of few channels, those that were refused do not count.
        attenuation = np.where(
            [reason is Status.OK for reason in status], fit.parameters[:, 0], np.nan)
        clearer = refute_clearness(
            attenuation, np.nan_to_num(fit.covariance[0::2, 0::2]), self._clear_water)
        return assemble(fit, envelope, refuse(status, clearer))

    def _estimate_free_veil(
        self,
        envelope: Envelopes,
        status: list[Status],
        active: NDArray[np.bool_],
        cues: Cues,
    ) -> WaterEstimate:
        """Estimate with the veil apart from the light."""
        fitted = self._fitter.fit(
            Observations(envelope, cues.contrast, cues.halves), active, cues)
        if fitted is None:
            return WaterEstimate.not_assessable(Status.FIT_FAILED, envelope)
        found, (envelope, _, halves) = fitted
        covariance = found.fit.covariance.copy()
        for channel in np.flatnonzero(active):
            status[channel] = validate_fit(found.fit, envelope, int(channel))
        if found.disagreement > CONTRADICTION:
            status = refuse(status, Status.CUES_DISAGREE)
        if halves is not None:
            attenuation, veil = found.fit.parameters.T
            uneven = compare_halves(halves, attenuation, veil, found.scene_light)
            refuted = uneven.refutes(attenuation)
            status = refuse(status, refuted)
            between, stddev = uneven.averaged(attenuation)
            covariance[0::2, 0::2] += np.outer(stddev, stddev)
            found = replace(found, fit=replace(found.fit, parameters=np.stack(
                (between, veil), axis=1)))
        if cues.compressed:
            light = brightest(envelope, active)
            error = COMPRESSION_ERROR * (1.0 - light / light.max()) * found.fit.parameters[:, 0]
            covariance[0::2, 0::2] += np.diag(error**2)
        other = None if cues.coarse else fit_other_transfer(
            envelope, active, self._clear_water, self._transfer, found,
            cues.certain_water)
        if other is not None and other.certain:
            status = refuse(status, Status.OTHER_TRANSFER)
        elif other is not None and not cues.compressed:
            # A JPEG bends the envelopes of dim channels too, and its error is in already.
            parameters, covariance = other.averaged(found.fit.parameters, covariance)
            found = replace(found, fit=replace(found.fit, parameters=parameters))
        log_odds = math.nan
        if not cues.coarse and not cues.compressed:
            log_odds = NEGLIGIBLE_ODDS if other is None else other.log_odds
        if found.refuted and not cues.coarse:
            status = refuse(status, Status.NOT_ONE_WATER)
        shown = np.where(active, found.fit.parameters[:, 0], np.nan)
        status = refuse(
            status, refute_clearness(shown, covariance[0::2, 0::2], self._clear_water))
        blanked = replace(found.fit, covariance=blank(covariance, active))
        estimate = assemble(blanked, envelope, status)
        known = np.isfinite(estimate.attenuation)
        return replace(
            estimate,
            light=np.where(known, found.scene_light, np.nan),
            light_stddev=np.where(known, found.scene_light_stddev, np.nan),
            cues=found.cues,
            open_water=0.0 if cues.certain_water is None else cues.certain_water.fraction,
            transfer_log_odds=log_odds,
        )

    def estimate_grey_view(
        self,
        view: View,
        range_map: NDArray[np.floating],
        *,
        range_error: float,
    ) -> tuple[float, float] | None:
        """Estimate attenuation and ambient light of a grey view, to restore its contrast.

        Parameters
        ----------
        view : View
        range_map, range_error
            See `estimate`.

        Returns
        -------
        tuple of float, or None
            Attenuation, 1/m, and ambient light in units of irradiance; None
            where they are not assessable. A grey camera's response is taken
            to reach the least attenuated channel.
        """
        samples = ColourSamples(
            np.dstack((view.pixels,) * 3), view.transfer, np.repeat(view.noise, 3))
        envelope = self._observe(samples, range_map, view.valid, range_error, coarse=False)
        reason = refuse_frame(
            envelope, self._fewest_pixels(samples), self._config.min_range_ratio)
        if reason is not Status.OK:
            return None
        if refuse_channel(envelope, 0) is not Status.OK:
            return None
        alone = np.array([True, False, False])
        fit = fit_one_light(
            envelope, alone, None, range_error, np.full(3, self._clear_water.min()),
            self._config.method == "paper")
        if validate_fit(fit, envelope, 0) is not Status.OK:
            return None
        attenuation, ambient_light = fit.parameters[0]
        return float(attenuation), float(ambient_light)

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
        dark_quantile, fewest_dark = self._darkest(range_map.size, range_error, coarse)
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

    def _darkest(self, pixels: int, range_error: float, coarse: bool) -> tuple[float, float]:
        """Return the quantile of the dark envelope, and how many pixels are below it at least."""
        if self._config.method == "paper":
            return PLAIN_DARK
        if coarse:
            return MEASURED_DARK
        if range_error == 0.0 or self._config.veil != "free":
            return DARK
        quantile, fewest = MEASURED_DARK
        return quantile, max(fewest * min(pixels / MEASURED_PIXELS, 1.0), DARK[1])

    def _fewest_pixels(self, samples: ColourSamples) -> int:
        return int(samples.count(self._config.min_bin_pixels))


def check_arrays(
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
    check_valid(valid, image.shape)


def _codes(image: NDArray[Any], transfer: str) -> tuple[NDArray[Any], str]:
    """Return contiguous code values and their transfer; irradiance becomes 16-bit codes."""
    if image.dtype != np.float32:
        return np.ascontiguousarray(image), transfer
    light = np.nan_to_num(np.clip(image, 0.0, 1.0), nan=0.0)
    return (light * 65535 + 0.5).astype(np.uint16), "linear"


