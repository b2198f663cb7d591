# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of attenuation, veil and light from pixels and ranges (eq. 4-7)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logit

from uw_visibility.config.schema import WaterConfig
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.images.view import ColourSamples, View
from uw_visibility.optics.light_model import contrast_gain, radiance_of
from uw_visibility.status import Status
from uw_visibility.water.blocks import (
    BLOCKS_KEPT,
    Blocks,
    away_from_edges,
    reduce_to_blocks,
    thinned,
    with_ranges,
    without_ranges,
)
from uw_visibility.water.daylight.grey_average import ColourBalance, colour_balance
from uw_visibility.water.daylight.inference import (
    ATTENUATION_AND_VEIL,
    Posterior,
    infer,
    light_status,
)
from uw_visibility.water.daylight.network import Network, trained
from uw_visibility.water.daylight.one_light import Daylight, fit_one_light
from uw_visibility.water.daylight.statistics import Appearance, appearance_of, summarise
from uw_visibility.water.daylight.validation import (
    refuse_attenuation,
    refuse_channel,
    refuse_frame,
    refuse_uncertain,
)
from uw_visibility.water.estimate import (
    WaterEstimate,
    blank,
    of_channels,
    overall_status,
    passed,
    refuse,
    widened,
)
from uw_visibility.water.observations import Envelopes, observe

# Radiance of the brightest patches of a scene, which are nearly white (eq. 5), and its deviation.
BRIGHT_RADIANCE, WHITE_DEVIATION = 0.9, 0.27
# Least radiance of the brightest near patch: darker ones are noise.
LEAST_RADIANCE = 0.05
# Relative standard deviation of the scale of range after calibration, and so of β (belief
# `range.scale` of the laboratory: 8 % at most).
RANGE_SCALE_DEVIATION = 0.046


# Parts of an estimate that do not depend on the ranges. The appearance is computed at first use.
_Picture = tuple[Blocks, Callable[[], Appearance], ColourBalance]


class WaterEstimator:
    """Estimator of the water's state by daylight; one instance may serve several threads.

    `clear_water_attenuation` is κ of the camera, (3,), 1/m; `daylight` the prior of the light's
    colour, for one light of veil and scene; `network` infers the posterior, by default that of the
    package.
    """

    def __init__(
        self, config: WaterConfig, clear_water_attenuation: ArrayLike,
        daylight: Daylight | None = None, network: Network | None = None,
    ) -> None:
        self._config = config
        self._clear_water = np.array(clear_water_attenuation, dtype=np.float64)
        self._daylight = daylight
        self._network = network
        # For views in use: both steps of the pipeline read the same one.
        self._pictures: WeakKeyDictionary[View, _Picture] = WeakKeyDictionary()

    def estimate_view(
        self, view: View, range_map: NDArray[np.floating], *, range_error: float
    ) -> WaterEstimate:
        """Estimate attenuation, veil and light.

        `range_map` (H, W) is the range along the line of sight, m, NaN where unknown, `range_error`
        its standard deviation over its square, 1/m, see `StereoRig.range_error`: measured ranges
        that are passed as exact, 0, bias the attenuation.
        """
        colour = view.colour
        if colour is None:
            return WaterEstimate.not_assessable(Status.NO_COLOUR)
        if not colour.pixels.any():
            return WaterEstimate.not_assessable(Status.TOO_DARK)
        ranges, valid = colour.reduce(np.asarray(range_map, np.float32), view.valid)
        if view not in self._pictures:
            blocks = without_ranges(colour, valid)
            self._pictures[view] = (
                blocks, cache(partial(appearance_of, blocks.light)), colour_balance(view.pixels))
        blocks, appearance, balance = self._pictures[view]
        blocks = with_ranges(blocks, ranges)
        return replace(
            self.estimate_blocks(blocks, range_error, appearance),
            blocks=thinned(blocks, BLOCKS_KEPT), grey_on_average=balance.grey,
            blue_as_green=balance.blue_as_green)

    def estimate_blocks(
        self, blocks: Blocks, range_error: float, appearance: Callable[[], Appearance] | None = None
    ) -> WaterEstimate:
        """Estimate from blocks of one image or of several; `range_error` in 1/m."""
        envelope = observe(blocks, range_error)
        reason = refuse_frame(envelope, self._config.min_range_ratio)
        if reason is not Status.OK:
            return WaterEstimate.not_assessable(reason, envelope)
        statistics = summarise(blocks, range_error, self._clear_water, appearance)
        if statistics is None:
            return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS, envelope)
        networks = self._networks
        posterior = infer(networks, statistics)
        lamps_log_odds = float(logit(posterior.lamps))
        reason = light_status(posterior.lamps)
        if reason is not Status.OK:
            return replace(
                WaterEstimate.not_assessable(reason, envelope), lamps_log_odds=lamps_log_odds)
        status = [refuse_channel(envelope, channel) for channel in range(3)]
        active = passed(status)
        if not active.any():
            return WaterEstimate.not_assessable(overall_status(status), envelope)
        if posterior.unlike > networks.most_unlike:
            status = refuse(status, Status.UNLIKE_TRAINING)
        if posterior.misfit > networks.most_misfit:
            status = refuse(status, Status.NOT_ONE_WATER)
        if self.one_light:
            found = self._one_light(posterior, blocks, range_error, active, self._daylight)
            estimate = self._validated(*found, envelope, status)
        else:
            estimate = self._validated(*_attenuation_and_veil(posterior), envelope, status)
            known = np.isfinite(estimate.attenuation)
            light, light_covariance = _light(posterior, envelope, known)
            estimate = replace(
                estimate, light=light, light_covariance=light_covariance,
                clearest=widened(posterior.clearest(known), RANGE_SCALE_DEVIATION)
                if known.any() else None)
        return replace(
            estimate, transfer_log_odds=float(logit(posterior.other_curve)),
            lamps_log_odds=lamps_log_odds)

    @property
    def one_light(self) -> bool:
        """Whether veil and light on the scene are taken as equal."""
        return self._config.veil == "paper"

    @property
    def _networks(self) -> Network:
        return self._network or trained()

    def _one_light(
        self, posterior: Posterior, blocks: Blocks, range_error: float, seen: Mask,
        daylight: Daylight | None,
    ) -> tuple[Array, Array]:
        """β and B = W of the channels seen, from blocks away from edges; see `fit_one_light`."""
        return fit_one_light(
            posterior, observe(away_from_edges(blocks), range_error), seen, daylight,
            self._config.daylight_tolerance)

    def _validated(
        self, parameters: Array, covariance: Array, envelope: Envelopes, status: list[Status]
    ) -> WaterEstimate:
        """Estimate of β and light, (3, 2), without the channels that are too uncertain."""
        status = refuse_attenuation(
            status, parameters[:, 0], covariance[0::2, 0::2], self._clear_water)
        known = passed(status)
        shown = np.where(known[:, np.newaxis], parameters, np.nan)
        return WaterEstimate(
            **of_channels(status, shown[:, 0], shown[:, 1], blank(covariance, known)),
            iterations=1, bins=len(envelope.range), envelope=envelope)

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
        blocks = reduce_to_blocks(samples, ranges, valid)
        envelope = observe(blocks, range_error)
        reason = refuse_frame(replace(envelope, grey=False), self._config.min_range_ratio)
        if reason is not Status.OK or refuse_channel(envelope, 0) is not Status.OK:
            return None
        statistics = summarise(blocks, range_error, np.full(3, self._clear_water.min()))
        posterior = None if statistics is None else infer(self._networks, statistics)
        if posterior is None or light_status(posterior.lamps) is not Status.OK:
            return None
        parameters, covariance = self._one_light(
            posterior, blocks, range_error, np.ones(3, np.bool_), None)
        attenuation, ambient_light = parameters[0]
        if refuse_uncertain(attenuation, np.sqrt(covariance[0, 0])) is not Status.OK:
            return None
        return float(attenuation), float(ambient_light)


def _attenuation_and_veil(posterior: Posterior) -> tuple[Array, Array]:
    """β and B of the posterior, (3, 2), and their covariance, (6, 6)."""
    parameters = np.exp(posterior.mean[:, :2])
    scale = parameters.ravel()
    of_both = np.ix_(ATTENUATION_AND_VEIL, ATTENUATION_AND_VEIL)
    covariance = posterior.covariance[of_both] * np.outer(scale, scale)
    attenuation = parameters[:, 0]
    covariance[0::2, 0::2] += RANGE_SCALE_DEVIATION**2 * np.outer(attenuation, attenuation)
    return parameters, covariance


def _light(posterior: Posterior, envelope: Envelopes, known: Mask) -> tuple[Array, Array]:
    """Light W on the scene, (3,), and covariance of ln W, (3, 3); NaN for unknown channels.

    An image hardly shows the light's level: scenes may be bright in dim light. So the posterior is
    fused with the prior that the brightest near patch is nearly white (eq. 5).
    """
    attenuation, veil, light = np.exp(posterior.mean).T
    covariance = posterior.covariance[2::3, 2::3]
    brighter = np.zeros(3)
    for c in np.flatnonzero(known).tolist():
        irradiance, distance = envelope.brightest_near(c)
        gain = contrast_gain(attenuation[c], distance)
        radiance = radiance_of(irradiance, gain, veil[c], light[c])
        brighter[c] = math.log(max(radiance, LEAST_RADIANCE) / BRIGHT_RADIANCE)
    noise = WHITE_DEVIATION**2 * np.eye(int(known.sum()))
    # Unknown channels show no white.
    weight = np.zeros((3, 3))
    weight[:, known] = covariance[:, known] @ np.linalg.inv(
        covariance[np.ix_(known, known)] + noise)
    fused = light * np.exp(weight @ brighter)
    fused[~known] = np.nan
    rest = covariance - weight @ covariance
    return fused, np.where(np.outer(known, known), 0.5 * (rest + rest.T), np.nan)
