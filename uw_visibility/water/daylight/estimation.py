# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of attenuation, veil and light from pixels and ranges (eq. 4-7)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logit

from uw_visibility.config.schema import WaterConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Mask, RangeMap
from uw_visibility.images.pair import check_valid
from uw_visibility.images.view import ColourSamples, View
from uw_visibility.optics.light_model import contrast_gain, radiance_of
from uw_visibility.status import Status
from uw_visibility.water.blocks import BLOCKS_KEPT, FEWEST_BLOCKS, Blocks, reduce_to_blocks, thinned
from uw_visibility.water.daylight.dark_fit import fit_one_light
from uw_visibility.water.daylight.fit import Fit
from uw_visibility.water.daylight.grey_average import colour_balance
from uw_visibility.water.daylight.inference import Posterior, infer
from uw_visibility.water.daylight.network import Network, trained
from uw_visibility.water.daylight.priors import (
    BRIGHT_RADIANCE,
    WHITE_DEVIATION,
    Daylight,
    fuse,
)
from uw_visibility.water.daylight.statistics import (
    summarise,
)
from uw_visibility.water.daylight.validation import (
    brightest_patch,
    least_ambient_light,
    refuse_channel,
    refuse_frame,
    refuse_spread,
    refute_clearness,
    validate_fit,
)
from uw_visibility.water.estimate import (
    ONE_SIGMA,
    WaterEstimate,
    assemble,
    overall_status,
    refuse,
)
from uw_visibility.water.observations import Envelopes, observe

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
# The brightest patch near by is at least so bright: of a darker one noise decides.
LEAST_RADIANCE = 0.05


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
        Prior of the colour of the ambient light, with one light for veil and scene.
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
        ranges, valid = colour.reduce(np.asarray(range_map, np.float32), view.valid)
        dark = self._darkest(range_map.size, range_error, coarse)
        envelope = self._observe(colour, ranges, valid, range_error, dark)
        if envelope.pixels == 0 and not colour.pixels.any():
            return WaterEstimate.not_assessable(Status.TOO_DARK, envelope)
        if self.by_posterior:
            blocks = reduce_to_blocks(colour, ranges, valid)
            estimate = replace(
                self.estimate_blocks(blocks, envelope, range_error),
                blocks=thinned(blocks, BLOCKS_KEPT))
        else:
            estimate = self._estimate(envelope, self._fewest_pixels(colour), start)
            if np.isfinite(estimate.attenuation).any():
                posterior = self._infer(reduce_to_blocks(colour, ranges, valid), range_error)
                if posterior is not None and posterior.lit_by_lamps:
                    estimate = WaterEstimate.not_assessable(Status.LIT_BY_LAMPS, envelope)
        balance = colour_balance(view.pixels)
        return replace(estimate, grey_on_average=balance.grey, blue_as_green=balance.blue_as_green)

    @property
    def by_posterior(self) -> bool:
        """Whether veil and light are apart, and so the trained posterior tells them."""
        return self._config.method != "paper" and self._config.veil == "free"

    def estimate_envelope(self, envelope: Envelopes) -> WaterEstimate:
        """Estimate from envelopes alone, with one light for veil and scene, as of many frames."""
        return self._estimate(envelope, self._config.min_bin_pixels, None)

    def estimate_blocks(
        self, blocks: Blocks, envelope: Envelopes, range_error: float
    ) -> WaterEstimate:
        """Estimate by the trained posterior, from blocks of one image or of several.

        `envelope` is that of the same pixels, for refusals; `range_error` in 1/m.
        """
        status = self._validate(
            envelope, min(self._config.min_bin_pixels, FEWEST_BLOCKS))
        if isinstance(status, Status):
            return WaterEstimate.not_assessable(status, envelope)
        posterior = self._infer(blocks, range_error)
        if posterior is None:
            return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS, envelope)
        if posterior.lit_by_lamps:
            return WaterEstimate.not_assessable(Status.LIT_BY_LAMPS, envelope)
        network = self._networks
        if posterior.unlike > network.most_unlike:
            status = refuse(status, Status.UNLIKE_TRAINING)
        if posterior.misfit > network.most_misfit:
            status = refuse(status, Status.NOT_ONE_WATER)
        attenuation, veil, _ = np.exp(posterior.mean).T
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
        light, light_covariance = _light(posterior, envelope, known)
        return replace(
            estimate, light=light, light_stddev=light * np.sqrt(np.diag(light_covariance)),
            light_covariance=light_covariance,
            clearest=posterior.clearest(known, ONE_SIGMA) if known.any() else None,
            transfer_log_odds=float(logit(posterior.other_curve)))

    @property
    def _networks(self) -> Network:
        return self._network or trained()

    def _infer(self, blocks: Blocks, range_error: float) -> Posterior | None:
        """Infer the posterior of blocks of pixels; None where too few ranges are known."""
        statistics = summarise(blocks, range_error, self._clear_water)
        return None if statistics is None else infer(self._networks, statistics)

    def _validate(
        self, envelope: Envelopes, fewest_pixels: int
    ) -> Status | list[Status]:
        """Validate the observations: why the frame is refused, or the status of each channel."""
        reason = refuse_frame(envelope, fewest_pixels, self._config.min_range_ratio)
        if reason is not Status.OK:
            return reason
        status = [refuse_channel(envelope, channel) for channel in range(3)]
        if envelope.grey:
            return Status.NO_COLOUR
        if all(reason is not Status.OK for reason in status):
            return overall_status(status)
        return status

    def _estimate(
        self, envelope: Envelopes, fewest_pixels: int, start: WaterEstimate | None
    ) -> WaterEstimate:
        """Estimate with one light for veil and scene: validate, fit, validate the fit."""
        status = self._validate(envelope, fewest_pixels)
        if isinstance(status, Status):
            return WaterEstimate.not_assessable(status, envelope)
        active = np.array([reason is Status.OK for reason in status])
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

    def estimate_grey_view(
        self, view: View, range_map: NDArray[np.floating], *, range_error: float
    ) -> tuple[float, float] | None:
        """Attenuation, 1/m, and ambient light of a grey view, to restore its contrast.

        None where not assessable. A grey camera's response is assumed to reach the least attenuated
        channel.
        """
        samples = ColourSamples(
            np.dstack((view.pixels,) * 3), view.transfer, np.repeat(view.noise, 3))
        ranges, valid = samples.reduce(np.asarray(range_map, np.float32), view.valid)
        dark = self._darkest(range_map.size, range_error, coarse=False)
        envelope = self._observe(samples, ranges, valid, range_error, dark)
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
        self, samples: ColourSamples, ranges: RangeMap, valid: Mask | None, range_error: float,
        dark: tuple[float, float],
    ) -> Envelopes:
        """Observe samples with their ranges; `dark` as `_darkest` has it."""
        config = self._config
        plain = config.method == "paper"
        dark_quantile, fewest_dark = dark
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


def _light(posterior: Posterior, envelope: Envelopes, known: Mask) -> tuple[Array, Array]:
    """Light W on the scene, (3,), and covariance of ln W, (3, 3); NaN for unknown channels.

    The image hardly tells its level: scenes may be bright in dim light. So that of the posterior
    is fused with the expectation that the brightest patch near by is nearly white (eq. 5).
    """
    attenuation, veil, light = np.exp(posterior.mean).T
    covariance = posterior.covariance[2::3, 2::3]
    white = light.copy()
    for c in np.flatnonzero(known).tolist():
        irradiance, distance = brightest_patch(envelope, c)
        gain = contrast_gain(attenuation[c], distance)
        radiance = radiance_of(irradiance, gain, veil[c], light[c])
        white[c] = light[c] * max(radiance, LEAST_RADIANCE) / BRIGHT_RADIANCE
    noise = np.eye(3) * WHITE_DEVIATION**2
    weight = covariance @ np.linalg.inv(covariance + noise)
    fused = light * np.exp(weight @ np.log(white / light))
    fused[~known] = np.nan
    rest = covariance - weight @ covariance
    return fused, np.where(np.outer(known, known), 0.5 * (rest + rest.T), np.nan)


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
