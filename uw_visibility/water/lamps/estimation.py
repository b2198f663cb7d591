# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of attenuation and scattering where lamps light the scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erfcx

from uw_visibility.config.lighting import LightingConfig
from uw_visibility.config.schema import WaterConfig
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.images.view import View
from uw_visibility.optics.lamps import LEFT_EYE, LampTables, at_attenuation, tabulate
from uw_visibility.status import Status
from uw_visibility.water.blocks import reduce_to_blocks
from uw_visibility.water.daylight.validation import MAX_CLIPPED_FRACTION, refuse_attenuation
from uw_visibility.water.estimate import (
    LampLight,
    WaterEstimate,
    blank,
    of_channels,
    overall_status,
    passed,
    refuse,
    widened,
)
from uw_visibility.water.lamps.nodes import USELESS, Nodes, reduce_to_nodes
from uw_visibility.water.lamps.posterior import CLEAR_WATER_DEVIATION, FEWEST_NODES, infer
from uw_visibility.water.lamps.track_fit import TrackFit
from uw_visibility.water.lamps.tracks import GroundView

# Relative error of β from scale of range, transfer and shape of beams.
MODEL_ERROR = 0.07
# Chi squared of tracks against the posterior, for three channels, beyond which they contradict it:
# 5 % by chance.
CONTRADICTION = 7.8
# Deviation of ln power, of all channels alike, in nights of three worlds (0.6, 0.8 and 1.0):
# ground is darker than white, and the attenuation in error. `WaterEstimate.light_covariance` alone
# has it.
POWER_DEVIATION = 0.8
# Quantiles of range that are taken as its limits: most ranges beyond are wrong.
RANGE_LIMITS = (0.005, 0.98)


def estimate_nodes(
    frames: Sequence[Nodes], lighting: LightingConfig, clear_water: Array,
    refused: Sequence[Status] = (Status.OK,) * 3, tracks: TrackFit | None = None,
) -> WaterEstimate:
    """Estimate from nodes of frames in the order of time, and tracks of ground points.

    `clear_water` is κ of the camera, (3,), 1/m; `refused` says why channels are not assessable.
    """
    status = list(refused)
    for c in range(3):
        useful = sum(int((nodes.variance[:, c] < USELESS**2).sum()) for nodes in frames)
        if status[c] is Status.OK and useful < FEWEST_NODES:
            status[c] = Status.TOO_DARK
    seen, posterior = passed(status), None
    if seen.any():
        posterior = infer(frames, lighting, clear_water, seen)
    if posterior is None:
        reason = Status.TOO_FEW_OBSERVATIONS if seen.any() else overall_status(status)
        nothing, no = WaterEstimate.not_assessable(reason), np.full(3, np.nan)
        return replace(nothing, lamps=LampLight(no, no, no, no, no, frames[-1]))
    if posterior.misfit:
        status = refuse(status, Status.NOT_ONE_WATER)
    log_beta, covariance = posterior.log_attenuation, posterior.covariance
    clearest: Array | None = widened(posterior.clearest, MODEL_ERROR)
    if tracks is not None:
        fused = _joined(log_beta, covariance, tracks)
        if fused is not None:
            # The clearest channel's distribution is that of the nodes alone.
            (log_beta, covariance), clearest = fused, None
    beta = np.exp(log_beta)
    beta, covariance = _above_clear_water(
        beta, covariance * np.outer(beta, beta), seen, clear_water)
    levels = posterior.levels(beta)
    status = refuse_attenuation(status, beta, covariance, clear_water)
    known = passed(status)
    beta = np.where(known, beta, np.nan)
    far = np.exp(at_attenuation(frames[-1].log_far, beta))
    veil = np.where(known, levels.scattering * far, np.nan)
    joint = np.zeros((6, 6))
    joint[0::2, 0::2] = covariance
    joint[1::2, 1::2] = np.diag((posterior.scattering_stddev * veil) ** 2)
    # The lamps' colours are known, so that their power is one number.
    scene_light = np.where(known, levels.power, np.nan)
    return WaterEstimate(
        **of_channels(
            status, beta, np.where(known, np.maximum(veil + levels.veil, 1e-9), np.nan),
            blank(joint, known)),
        iterations=1, bins=sum(len(nodes.range) for nodes in frames), light=scene_light,
        light_covariance=np.where(np.outer(known, known), POWER_DEVIATION**2, np.nan),
        clearest=clearest if known.any() else None,
        lamps=LampLight(
            beta, scene_light, np.where(known, levels.scattering, np.nan),
            levels.daylight, levels.veil, frames[-1]))


class LampEstimator:
    """Estimator of the water's state under lamps.

    `clear_water_attenuation` is κ of the camera, (3,), 1/m; `rays` gives unit directions,
    (Y, X, 3), through a grid of columns and rows, px.
    """

    def __init__(
        self, config: WaterConfig, lighting: LightingConfig, clear_water_attenuation: ArrayLike,
        rays: Callable[[Array, Array], Array],
    ) -> None:
        self._config = config
        self._lighting = lighting
        self._clear_water = np.array(clear_water_attenuation, dtype=np.float64)
        self._rays = rays

    def tables(self, shape: tuple[int, int]) -> LampTables:
        """Tables for images of a height and width, px."""
        return tabulate(self._rays, shape, tuple(self._lighting.lamps()), LEFT_EYE)

    def estimate_view(
        self, view: View, range_map: NDArray[np.floating], *, range_error: float = 0.0
    ) -> WaterEstimate:
        """Estimate attenuation and scattering from a view; see `WaterEstimator.estimate_view`.

        `range_error` counts in surveys.
        `ambient_light` of the result is that of the water at infinity in the image's middle.
        """
        if view.colour is None:
            return WaterEstimate.not_assessable(Status.NO_COLOUR)
        if not view.colour.pixels.any():
            return WaterEstimate.not_assessable(Status.TOO_DARK)
        full = np.asarray(range_map, np.float32)
        blocks = reduce_to_blocks(view.colour, *view.colour.reduce(full, view.valid))
        refused = [
            Status.SATURATED if blocks.clipped[c] > MAX_CLIPPED_FRACTION
            else Status.TOO_DARK if blocks.black[c] > MAX_CLIPPED_FRACTION else Status.OK
            for c in range(3)]
        if Status.OK not in refused:
            return WaterEstimate.not_assessable(overall_status(refused))
        rows, columns = (
            np.asarray((np.arange(size) + 0.5) * blocks.side - 0.5) for size in blocks.range.shape)
        nodes = reduce_to_nodes(blocks, self._rays(columns, rows), self.tables(view.shape))
        if len(nodes.range) < FEWEST_NODES:
            return WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
        low, high = np.quantile(nodes.range, RANGE_LIMITS)
        if high < self._config.min_range_ratio * low:
            # Many such frames together may be assessable.
            refused = [Status.RANGE_SPREAD_TOO_SMALL] * 3
        water = estimate_nodes([nodes], self._lighting, self._clear_water, refused)
        assert water.lamps is not None
        ground = GroundView.of(view, full, self._rays, range_error)
        return replace(water, lamps=replace(water.lamps, ground=ground))


def _above_clear_water(
    beta: Array, covariance: Array, seen: Mask, clear: Array
) -> tuple[Array, Array]:
    """Raise β to clear water's, its lower bound (eq. 3), and add the model's error."""
    for c in np.argsort(beta - clear):
        if seen[c] and beta[c] < clear[c]:
            beta, covariance = _raised(beta, covariance, c, float(clear[c]))
    return beta, covariance + MODEL_ERROR**2 * np.outer(beta, beta)


def _joined(log_beta: Array, covariance: Array, tracks: TrackFit) -> tuple[Array, Array] | None:
    """Weighted mean of the nodes' ln β and that of tracks; None where tracks contradict it."""
    away = tracks.log_attenuation - log_beta
    weight = np.linalg.inv(covariance + tracks.covariance)
    if away @ weight @ away > CONTRADICTION:
        return None
    gain = covariance @ weight
    return log_beta + gain @ away, covariance - gain @ covariance


def _raised(mean: Array, covariance: Array, c: int, least: float) -> tuple[Array, Array]:
    """Truncate one variable of a Gaussian at a lower bound, which is uncertain itself.

    Its variance is that of the truncated normal distribution; the others change by their covariance
    with it.
    """
    stddev = math.sqrt(covariance[c, c] + (CLEAR_WATER_DEVIATION * least) ** 2)
    below = (least - mean[c]) / stddev
    # Inverse Mills ratio φ(a) / (1 − Φ(a)): mean of a normal law that is truncated at a.
    ratio = math.sqrt(2.0 / math.pi) / float(erfcx(below / math.sqrt(2.0)))
    gain = covariance[:, c] / stddev
    fresh = covariance - ratio * (ratio - below) * np.outer(gain, gain)
    return mean + below * gain, 0.5 * (fresh + fresh.T)
