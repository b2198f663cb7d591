# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Assessment of mean attenuation, visibility distance and depth (eq. 9-14)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.status import Status
from uw_visibility.water.daylight.validation import MIN_CODES, SIGNIFICANT
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.depth import DepthModel

# Largest ratio of the 84 % to the 16 % quantile of a distance, and largest standard deviation of a
# depth, as a part of the largest depth; beyond, they are refused.
WIDEST_INTERVAL = 4.0
MAX_RELATIVE_STDDEV = 0.5
_NO_DEPTH = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Visibility:
    """Mean attenuation, visibility distance and depth; NaN where not assessable.

    Attributes
    ----------
    status : Status
        Of the distance; mean attenuation is known where all channels with light are.
    depth_status : Status
        Of the depth.
    mean_attenuation, mean_attenuation_stddev : float
        α (eq. 9), 1/m, the mean over `channels`.
    distance, distance_stddev : float
        Visibility distance (eq. 12), m: its median, and half of the interval from 16 to 84 %.
    distance_low, distance_high : float
        16 and 84 % quantiles of the distance, m. Attenuation is uncertain by a factor,
        so that the distance is farther above the median than below.
    depth, depth_stddev : float
        Depth (eq. 13), m, positive down.
    depth_precision : float
        The part of `depth_stddev` that varies between the frames of a dive, m: without
        water type and white balance.
    channels : str
        Channels that have light, such as ``"GB"`` where water took the red.
    """

    status: Status
    depth_status: Status
    mean_attenuation: float = math.nan
    mean_attenuation_stddev: float = math.nan
    distance: float = math.nan
    distance_stddev: float = math.nan
    depth: float = math.nan
    depth_stddev: float = math.nan
    depth_precision: float = math.nan
    distance_low: float = math.nan
    distance_high: float = math.nan
    channels: str = ""


class Assessor:
    """Assessment of visibility and depth from an estimate of the water's state.

    `clear_water_attenuation` is κ, (3,), 1/m, `daylight` the prior of the ambient light's colour,
    for the estimate. Raises `InputError` if the camera's spectral response cannot be loaded.
    """

    def __init__(self, config: PipelineConfig) -> None:
        white, response = config.camera.white_reference, load_response(config.camera.response)
        # Another reference was measured, and images may be grey with it.
        self._white_is_daylight = np.ptp(np.asarray(white, np.float64)) == 0.0
        self._config = config.assessment
        self.clear_water_attenuation = clear_water_attenuation(response)
        self._depth = DepthModel(self._config.water_type, response, white, self._config.max_depth)
        self.daylight = self._depth.daylight

    def assess(self, estimate: WaterEstimate, by_lamps: bool = False) -> Visibility:
        """Assess visibility and depth, with standard deviations by propagation.

        Under lamps the colour does not show the depth.

        A channel that is too dark to be assessed does not count: mean attenuation is that of the
        others, depth needs two of them, and the distance is that of the best one.
        """
        seen = np.isfinite(estimate.attenuation)
        status = estimate.status
        alpha = alpha_stddev = low = distance = high = math.nan
        if seen.any() and not estimate.refused_in_light.any():
            # By particles over the channels seen (eq. 9).
            alpha = float(np.mean((estimate.attenuation - self.clear_water_attenuation)[seen]))
            own = estimate.covariance[0::2, 0::2][np.ix_(seen, seen)]
            alpha_stddev = math.sqrt(own.sum()) / int(seen.sum())
            low, distance, high = self._distance(estimate).tolist()
            if math.isnan(distance) and status is Status.OK:
                status = Status.ATTENUATION_UNCERTAIN
        depth_status, depth = self._assess_depth(estimate, seen, by_lamps)
        return Visibility(
            status, depth_status, alpha, alpha_stddev, distance, 0.5 * (high - low), *depth,
            distance_low=low, distance_high=high,
            channels="".join(name for name, there in zip("RGB", seen, strict=True) if there))

    def _assess_depth(
        self, estimate: WaterEstimate, seen: Mask, by_lamps: bool
    ) -> tuple[Status, tuple[float, float, float]]:
        """Depth by the colour of daylight, its standard deviation and its precision; or why not.

        The colour is that of the scene light, where it is known apart from the veil; then the
        deviation includes the water type above and the camera's white. With one light for both, as
        in the paper, these are taken as known.
        """
        if by_lamps:
            return Status.NO_DEPTH_BY_LAMPS, _NO_DEPTH
        if estimate.status is not Status.OK:
            return estimate.status, _NO_DEPTH
        if seen.sum() < 2:
            return Status.NO_COLOUR, _NO_DEPTH
        if estimate.grey_on_average and self._white_is_daylight:
            return Status.GREY_ON_AVERAGE, _NO_DEPTH
        model = self._depth.of_channels(seen)
        attenuation, light = estimate.attenuation[seen], estimate.scene_light[seen]
        both = np.repeat(seen, 2)
        depth, precision = model.depth(
            attenuation, light, covariance_with_light(estimate)[np.ix_(both, both)])
        stddev = precision
        if estimate.light is not None:
            of_model, colour_error = model.model_stddev(
                depth, attenuation, estimate.attenuation_stddev[seen], light)
            stddev = math.hypot(precision, of_model)
            # By daylight a channel becomes too dark only far below.
            deepest = depth + SIGNIFICANT * stddev
            lost = self._depth.light(deepest, estimate.scene_light, seen) > _least_light(estimate)
            if colour_error > SIGNIFICANT or (lost & ~seen).any():
                return Status.NO_DAYLIGHT_COLOUR, _NO_DEPTH
        if not stddev <= MAX_RELATIVE_STDDEV * self._config.max_depth:
            return Status.AMBIENT_LIGHT_UNBOUNDED, _NO_DEPTH
        return Status.OK, (depth, stddev, precision)

    def _distance(self, estimate: WaterEstimate) -> Array:
        """Distance at which contrast falls to the threshold, in the best channel (eq. 12).

        Returns its 16, 50 and 84 %, m; NaN where they are too far apart.
        """
        logarithm = estimate.clearest
        if logarithm is None:
            best = int(np.nanargmin(estimate.attenuation))
            attenuation = estimate.attenuation[best]
            # β is uncertain by a factor (log-normal), and with it the distance.
            spread = estimate.attenuation_stddev[best] / attenuation
            logarithm = np.array((-spread, 0.0, spread)) - math.log(attenuation)
        if not logarithm[2] - logarithm[0] <= math.log(WIDEST_INTERVAL):
            return np.full(3, np.nan)
        return np.exp(logarithm) * visibility_distance(1.0, self._config.contrast)


def _least_light(estimate: WaterEstimate) -> Array:
    """Least light of an assessable channel, (3,); inf where unknown."""
    if estimate.envelope is None:
        return np.full(3, np.inf)
    step = estimate.envelope.step
    return MIN_CODES * np.where(np.isfinite(step), step, np.inf).min(axis=1, initial=np.inf)


def covariance_with_light(estimate: WaterEstimate) -> Array:
    """Covariance of an estimate with the scene light in the place of I∞.

    That of the light's own where it is known apart from the veil.
    """
    joint = estimate.covariance.copy()
    if estimate.light_covariance is not None:
        light = estimate.scene_light
        joint[1::2, :] = joint[:, 1::2] = 0.0
        joint[1::2, 1::2] = estimate.light_covariance * np.outer(light, light)
    return joint
