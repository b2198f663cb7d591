# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of attenuation, veil and light from pixels and ranges (eq. 4-7)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logit

from uw_visibility.config.schema import WaterConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.images.pair import check_valid
from uw_visibility.images.view import ColourSamples, View
from uw_visibility.status import Status
from uw_visibility.water.daylight.contrast import Decay
from uw_visibility.water.daylight.cues import Cues, Observations, coarse_cues, gather_cues
from uw_visibility.water.daylight.dark_fit import (
    brightest,
    fit_of_veil,
    fit_one_light,
    fit_other_transfer,
)
from uw_visibility.water.daylight.dark_gradient import LEAST_SHARE, bend_of, find_gradients, unbent
from uw_visibility.water.daylight.fit import Fit, blank
from uw_visibility.water.daylight.grey_average import colour_balance
from uw_visibility.water.daylight.inference import infer
from uw_visibility.water.daylight.network import Network, trained
from uw_visibility.water.daylight.open_water import OpenWater
from uw_visibility.water.daylight.position import compare_halves
from uw_visibility.water.daylight.priors import Daylight, fuse
from uw_visibility.water.daylight.statistics import (
    OPEN_WATER,
    Blocks,
    reduce_to_blocks,
    summarise,
)
from uw_visibility.water.daylight.transfer_check import LEAST_ODDS
from uw_visibility.water.daylight.validation import (
    least_ambient_light,
    lit_by_lamps,
    refuse_channel,
    refuse_frame,
    refuse_spread,
    refute_clearness,
    validate_fit,
)
from uw_visibility.water.daylight.veil import (
    CONTRADICTION,
    MISTAKEN_AREA,
    VeilFit,
    average,
    fit_free_veil,
)
from uw_visibility.water.daylight.veil_components import RatioFits
from uw_visibility.water.daylight.veil_gradient import UNCERTAIN, VeilGradient
from uw_visibility.water.estimate import (
    ONE_SIGMA,
    WaterEstimate,
    assemble,
    overall_status,
    refuse,
)
from uw_visibility.water.observations import Envelopes, observe

# Place of the veil in an image without open water.
MIDDLE = np.array((0.5, 0.5))
# Quantile of the dark envelope, and the fewest pixels below it. The paper takes 1 % (eq. 4). The
# darkest 5 pixels are a patch rather than a speck. Interpolated or measured ranges are partly
# wrong, and a dark near thing taken for a far one is darker than all there. With one light, bins
# below the envelope count less instead.
PLAIN_DARK = (0.01, 0.5)
DARK = (0.0002, 5.0)
MEASURED_DARK = (0.002, 20.0)
# Pixels of an image for the latter number; smaller images have fewer.
MEASURED_PIXELS = 320 * 240
BRIGHT_QUANTILE = 0.99
# Relative model errors of attenuation and ambient light with the paper's model: in thick water the
# fit knows of noise alone.
ATTENUATION_ERROR = 0.02
AMBIENT_ERROR = 0.01
# Relative error of attenuation by an undeclared JPEG in a channel without light: it rounds colour,
# and so the dim channels, to the light of the bright one.
COMPRESSION_ERROR = 0.45


class WaterEstimator:
    """Estimator of the water's state by daylight; one instance may serve several threads.

    Parameters
    ----------
    config : WaterConfig
    clear_water_attenuation : (3,) array_like
        κ of the camera, 1/m.
    transfer : str
        Camera transfer function, ``"linear"`` or ``"srgb"``.
    daylight : Daylight, optional
        Prior of the colour of the ambient light.
    network : Network, optional
        What infers the posterior; that of the package where absent.
    """

    def __init__(
        self, config: WaterConfig, clear_water_attenuation: ArrayLike, transfer: str = "linear",
        daylight: Daylight | None = None, network: Network | None = None,
    ) -> None:
        self._config = config
        self._clear_water = np.array(clear_water_attenuation, dtype=np.float64)
        self._transfer = transfer
        self._daylight = daylight
        self._network = network

    def estimate(
        self, image: NDArray[Any], range_map: NDArray[np.floating], valid: Mask | None = None,
        start: WaterEstimate | None = None, *, range_error: float, coarse: bool = False,
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
            Standard deviation of range over its square, 1/m, see `StereoRig.range_error`; 0 for
            exact ranges. Measured ranges that are passed as exact bias the attenuation.
        coarse : bool
            Whether ranges are interpolated between points, as in a mesh.

        Raises
        ------
        InputError
            If shapes or types do not fit.
        """
        valid = check_arrays(image, range_map, valid)
        image = image[..., 0] if image.shape[2:] == (1,) else image
        view = View.of(*_codes(image, self._transfer), valid)
        return self.estimate_view(
            view, range_map, start=start, range_error=range_error, coarse=coarse)

    def estimate_view(
        self, view: View, range_map: NDArray[np.floating], *, range_error: float,
        start: WaterEstimate | None = None, coarse: bool = False,
    ) -> WaterEstimate:
        """Estimate from a view, whose noise is known; see `estimate`."""
        colour = view.colour
        if colour is None:
            return WaterEstimate.not_assessable(Status.NO_COLOUR)
        envelope = self._observe(colour, range_map, view.valid, range_error, coarse)
        if envelope.pixels == 0 and not colour.pixels.any():
            return WaterEstimate.not_assessable(Status.TOO_DARK, envelope)
        if self._config.method == "posterior" and self._config.veil == "free":
            ranges, valid = colour.reduce(np.asarray(range_map, np.float32), view.valid)
            estimate = self._infer(
                reduce_to_blocks(colour, ranges, valid), envelope, self._fewest_pixels(colour),
                range_error)
        else:
            estimate = self._fit(
                colour, range_map, view.valid, envelope, start, range_error, coarse)
        balance = colour_balance(view.pixels)
        return replace(estimate, grey_on_average=balance.grey, blue_as_green=balance.blue_as_green)

    def _fit(
        self, colour: ColourSamples, range_map: NDArray[np.floating], valid: Mask | None,
        envelope: Envelopes, start: WaterEstimate | None, range_error: float, coarse: bool,
    ) -> WaterEstimate:
        """Estimate by fits of the envelopes."""
        return self._estimate(
            envelope, self._fewest_pixels(colour), start,
            lambda active: coarse_cues(envelope, active) if coarse else gather_cues(
                colour, np.asarray(range_map, np.float32), valid, envelope, active,
                lambda pixels: self._observe(pixels, range_map, valid, range_error, coarse)))

    def estimate_envelope(
        self, envelope: Envelopes, contrast: Decay | None = None
    ) -> WaterEstimate:
        """Estimate from envelopes and the decay of contrast alone, as those of many frames."""
        return self._estimate(
            envelope, self._config.min_bin_pixels, None, lambda active: Cues(contrast))

    def _estimate(
        self, envelope: Envelopes, fewest_pixels: int, start: WaterEstimate | None,
        cues: Callable[[Mask], Cues],
    ) -> WaterEstimate:
        """Validate, fit, validate the fit; `cues` returns the cues beside the envelopes."""
        status = self._validate(envelope, fewest_pixels)
        if isinstance(status, Status):
            return WaterEstimate.not_assessable(status, envelope)
        active = np.array([reason is Status.OK for reason in status])
        if self._config.method != "paper" and self._config.veil == "free":
            return self._estimate_free_veil(envelope, status, active, cues(active))
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

    def _infer(
        self, blocks: Blocks, envelope: Envelopes, fewest_pixels: int, range_error: float
    ) -> WaterEstimate:
        """Estimate by the trained posterior.

        `envelope` is that of the same pixels, for refusals; `range_error` in 1/m.
        """
        status = self._validate(envelope, fewest_pixels)
        if isinstance(status, Status):
            return WaterEstimate.not_assessable(status, envelope)
        statistics = summarise(blocks, range_error, self._clear_water)
        if statistics is None:
            return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS, envelope)
        network = self._network or trained()
        posterior = infer(network, statistics)
        if posterior.unlike > network.most_unlike:
            status = refuse(status, Status.UNLIKE_TRAINING)
        if posterior.misfit > network.most_misfit:
            status = refuse(status, Status.NOT_ONE_WATER)
        attenuation, veil, light = np.exp(posterior.mean).T
        scale = np.stack((attenuation, veil), axis=1).ravel()
        of_both = np.array([0, 1, 3, 4, 6, 7])
        log_covariance = posterior.covariance[np.ix_(of_both, of_both)]
        covariance = log_covariance * np.outer(scale, scale)
        stddev = np.sqrt(np.diag(log_covariance)[0::2])
        status = [
            refuse_spread(float(value), float(value * spread))
            if reason is Status.OK else reason
            for reason, value, spread in zip(status, attenuation, stddev, strict=True)]
        shown = np.where([reason is Status.OK for reason in status], attenuation, np.nan)
        status = refuse(status, refute_clearness(shown, covariance[0::2, 0::2], self._clear_water))
        fit = Fit(np.stack((attenuation, veil), axis=1), covariance, 1, True)
        estimate = assemble(fit, envelope, status)
        known = np.isfinite(estimate.attenuation)
        light_stddev = light * np.sqrt(np.diag(posterior.covariance)[2::3])
        return replace(
            estimate, light=np.where(known, light, np.nan),
            light_stddev=np.where(known, light_stddev, np.nan),
            clearest=posterior.clearest(known, ONE_SIGMA) if known.any() else None,
            open_water=float(statistics.of_image[OPEN_WATER]),
            transfer_log_odds=float(logit(posterior.other_curve)))

    def _validate(
        self, envelope: Envelopes, fewest_pixels: int
    ) -> Status | list[Status]:
        """Validate the observations: why the frame is refused, or the status of each channel."""
        reason = refuse_frame(envelope, fewest_pixels, self._config.min_range_ratio)
        if reason is not Status.OK:
            return reason
        status = [refuse_channel(envelope, channel) for channel in range(3)]
        if lit_by_lamps(envelope, np.array([s is not Status.TOO_DARK for s in status])):
            return Status.LIT_BY_LAMPS
        if envelope.grey:
            return Status.NO_COLOUR
        if all(reason is not Status.OK for reason in status):
            return overall_status(status)
        return status

    def _estimate_free_veil(
        self, envelope: Envelopes, status: list[Status], active: Mask, cues: Cues
    ) -> WaterEstimate:
        """Estimate with the veil apart from the light."""
        fitted = self._fit_veil(Observations(envelope, cues.contrast, cues.halves), active, cues)
        if fitted is None:
            return WaterEstimate.not_assessable(Status.FIT_FAILED, envelope)
        found, (envelope, _, halves) = self._level_rows(*fitted, active, cues)
        covariance = found.fit.covariance.copy()
        for channel in np.flatnonzero(active):
            status[channel] = validate_fit(found.fit, envelope, int(channel))
        if found.disagreement > CONTRADICTION:
            status = refuse(status, Status.CUES_DISAGREE)
        if halves is not None:
            parameters = found.fit.parameters.copy()
            uneven = compare_halves(
                halves.of_channels(active), parameters[active, 0], parameters[active, 1],
                found.scene_light[active])
            status = refuse(status, uneven.refutes(parameters[active, 0]))
            stddev = np.zeros(3)
            parameters[active, 0], stddev[active] = uneven.averaged(parameters[active, 0])
            covariance[0::2, 0::2] += np.outer(stddev, stddev)
            found = replace(found, fit=replace(found.fit, parameters=parameters))
        if cues.compressed:
            light = np.where(active, brightest(envelope, active), 0.0)
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
            log_odds = LEAST_ODDS if other is None else other.log_odds
        if found.refuted and not cues.coarse:
            status = refuse(status, Status.NOT_ONE_WATER)
        shown = np.where(active, found.fit.parameters[:, 0], np.nan)
        status = refuse(status, refute_clearness(shown, covariance[0::2, 0::2], self._clear_water))
        blanked = replace(found.fit, covariance=blank(covariance, active))
        estimate = assemble(blanked, envelope, status)
        known = np.isfinite(estimate.attenuation)
        return replace(
            estimate, light=np.where(known, found.scene_light, np.nan),
            light_stddev=np.where(known, found.scene_light_stddev, np.nan), cues=found.cues,
            open_water=0.0 if cues.certain_water is None else cues.certain_water.fraction,
            transfer_log_odds=log_odds)

    def _fit_veil(
        self, seen: Observations, active: Mask, cues: Cues
    ) -> tuple[VeilFit, Observations] | None:
        """Fit with the gradient of open water levelled; also return the observations of the fit."""
        certain = cues.certain_water
        found = self._fit_observations(seen, active, certain, cues.coarse)
        if found is None or cues.open_water is None or (certain and cues.level is None):
            return None if found is None else (found, seen)
        level = cues.level or seen
        in_water = self._fit_observations(
            level, active, cues.open_water, cues.coarse, found.ratios if level is seen else None)
        if in_water is None:
            return None if certain else (found, seen)
        if cues.level is not None:
            change = UNCERTAIN * (in_water.fit.parameters - found.fit.parameters).ravel()
            in_water = replace(in_water, fit=replace(
                in_water.fit, covariance=in_water.fit.covariance + np.outer(change, change)))
        log_odds = in_water.likelihood - found.likelihood
        if certain:
            # Of a small area, what differs in it need not be the veil's gradient.
            log_odds += math.log(certain.fraction / MISTAKEN_AREA)
        averaged = average(found, in_water, log_odds)
        if not certain:
            # What refutes an estimate without open water is not made good by what may be a wall.
            averaged = replace(
                averaged, misfit=found.misfit, durbin_watson=found.durbin_watson,
                disagreement=max(found.disagreement, in_water.disagreement))
        return averaged, level if log_odds > 0 else seen

    def _level_rows(
        self, found: VeilFit, seen: Observations, active: Mask, cues: Cues
    ) -> tuple[VeilFit, Observations]:
        """Average with fits that level a vertical gradient of veil or attenuation."""
        if seen.halves is None or cues.places is None or cues.level_by is None:
            return found, seen
        attenuation, veil = found.fit.parameters.T
        gradients = find_gradients(seen.halves, active, attenuation, veil, found.scene_light)
        if gradients is None:
            return found, seen
        of_veil, of_attenuation = gradients
        shares = np.array((of_veil.odds, of_attenuation.odds))
        shares /= 1.0 + shares.sum()
        if shares[1] > LEAST_SHARE:
            bend = bend_of(of_attenuation, cues.places, seen.envelope)
            found = replace(found, fit=unbent(found.fit, bend, shares[1], self._clear_water))
        # What open water shows of the veil is not asked of dark patches again.
        if shares[0] < LEAST_SHARE or seen is cues.level:
            return found, seen
        water = cues.certain_water
        level = cues.level_by(VeilGradient(
            np.tile((of_veil.slope, 0.0), (3, 1)),
            MIDDLE if water is None else water.gradient.place))
        levelled = self._fit_observations(level, active, water, cues.coarse)
        if levelled is None:
            return found, seen
        change = (levelled.fit.parameters - found.fit.parameters).ravel()
        change *= of_veil.stddev / of_veil.slope
        levelled = replace(levelled, fit=replace(
            levelled.fit, covariance=levelled.fit.covariance + np.outer(change, change)))
        log_odds = math.log(shares[0] / max(1.0 - shares[0], 1e-9))
        return average(found, levelled, log_odds), level if log_odds > 0 else seen

    def _fit_observations(
        self, seen: Observations, active: Mask, water: OpenWater | None,
        coarse: bool, ratios: RatioFits | None = None,
    ) -> VeilFit | None:
        """Fit with the veil apart from the light; None where there is no fit."""
        # Levelled pixels may be saturated, or too few.
        if any(refuse_channel(seen.envelope, int(c)) is not Status.OK
               for c in np.flatnonzero(active)):
            return None

        def fuse_priors(found: Fit, light: Array, veil: Array, tolerance: Array) -> Fit:
            return fuse(
                found, self._clear_water, np.full(3, 1e-6), self._daylight,
                self._config.daylight_tolerance, light, veil, tolerance)

        return fit_free_veil(
            fit_of_veil(seen.envelope, active, self._clear_water), fuse_priors, seen.envelope,
            active, brightest(seen.envelope, active), self._clear_water, seen.contrast, water,
            coarse, ratios)

    def estimate_grey_view(
        self, view: View, range_map: NDArray[np.floating], *, range_error: float
    ) -> tuple[float, float] | None:
        """Attenuation, 1/m, and ambient light of a grey view, to restore its contrast.

        None where not assessable. A grey camera's response is assumed to reach the least attenuated
        channel.
        """
        samples = ColourSamples(
            np.dstack((view.pixels,) * 3), view.transfer, np.repeat(view.noise, 3))
        envelope = self._observe(samples, range_map, view.valid, range_error, coarse=False)
        reason = refuse_frame(envelope, self._fewest_pixels(samples), self._config.min_range_ratio)
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
        self, samples: ColourSamples, range_map: NDArray[np.floating], valid: Mask | None,
        range_error: float, coarse: bool,
    ) -> Envelopes:
        config = self._config
        plain = config.method == "paper"
        dark_quantile, fewest_dark = self._darkest(range_map.size, range_error, coarse)
        ranges, valid = samples.reduce(np.asarray(range_map, dtype=np.float32), valid)
        return observe(
            samples, np.ascontiguousarray(ranges),
            None if valid is None else np.ascontiguousarray(valid), bins=config.bins,
            min_pixels=self._fewest_pixels(samples), edge_tolerance=config.edge_tolerance,
            dark_quantile=dark_quantile, fewest_dark=samples.count(fewest_dark),
            bright_quantile=BRIGHT_QUANTILE, range_error=range_error, plain=plain)

    def _darkest(self, pixels: int, range_error: float, coarse: bool) -> tuple[float, float]:
        """Quantile of the dark envelope, and the fewest pixels below it."""
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
    image: NDArray[Any], range_map: NDArray[np.floating], valid: Mask | None
) -> Mask | None:
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        raise InputError(f"the image is of type {image.dtype}: give uint8, uint16 or float32")
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3)):
        raise InputError(f"the image has the shape {image.shape}: give (H, W, 3) or (H, W)")
    if range_map.shape != image.shape[:2]:
        raise InputError(
            f"the range map has the shape {range_map.shape}, the image {image.shape[:2]}: "
            "give one range per pixel")
    return check_valid(valid, image.shape)


def _codes(image: NDArray[Any], transfer: str) -> tuple[NDArray[Any], str]:
    """Return contiguous code values and their transfer; irradiance becomes 16-bit codes."""
    if image.dtype != np.float32:
        return np.ascontiguousarray(image), transfer
    light = np.nan_to_num(np.clip(image, 0.0, 1.0), nan=0.0)
    return (light * 65535 + 0.5).astype(np.uint16), "linear"
