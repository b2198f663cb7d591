# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Assessment of mean attenuation, visibility distance and depth (eq. 9-14)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.config.schema import AssessmentConfig, PipelineConfig
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.optics.spectra import CameraResponse, clear_water_attenuation, load_response
from uw_visibility.status import Status
from uw_visibility.water.depth import DepthModel
from uw_visibility.water.estimate import WaterEstimate

# A distance or depth whose standard deviation is beyond this fraction of it, or
# of the largest depth, says nothing.
MAX_RELATIVE_STDDEV = 0.5
# Light whose colour is farther from that of any daylight below water tells no depth.
MAX_COLOUR_ERROR = 3.0


@dataclass(frozen=True)
class Visibility:
    """Mean attenuation, visibility distance and depth; NaN where not assessable.

    Attributes
    ----------
    status : Status
        Of the distance; mean attenuation is known where that of all channels is.
    depth_status : Status
        Of the depth.
    mean_attenuation, mean_attenuation_stddev : float
        α (eq. 9), 1/m.
    distance, distance_stddev : float
        Visibility distance (eq. 12), m.
    depth, depth_stddev : float
        Depth (eq. 13), m, positive down.
    depth_precision : float
        The part of `depth_stddev` that differs between the frames of a dive, m: without
        water type and white balance, which stay the same.
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


class Assessor:
    """Assessment of visibility and depth from an estimate of the water's state.

    Parameters
    ----------
    config : AssessmentConfig
    response : CameraResponse
        Gives κ (eq. 10).
    white_reference : (3,) array_like
        The camera's R, G, B of white at the surface; the scale is free.
    by_daylight : bool
        Whether daylight alone lights the scene, so that its colour tells the depth.

    Attributes
    ----------
    clear_water_attenuation : (3,) float64 ndarray
        κ, 1/m.
    daylight : Daylight
        What the ambient light is made of, for the estimate.
    """

    def __init__(
        self,
        config: AssessmentConfig,
        response: CameraResponse,
        white_reference: ArrayLike = (1.0, 1.0, 1.0),
        by_daylight: bool = True,
    ) -> None:
        self._by_daylight = by_daylight
        # Where it is another, the balance was measured, and images may well be grey with it.
        self._white_is_daylight = np.ptp(np.asarray(white_reference, np.float64)) == 0.0
        self._config = config
        self.clear_water_attenuation = clear_water_attenuation(response)
        self._depth = DepthModel(config.water_type, response, white_reference, config.max_depth)
        self.daylight = self._depth.daylight

    @classmethod
    def from_config(cls, config: PipelineConfig) -> Assessor:
        """Make the assessor that a pipeline's parameters describe.

        Raises
        ------
        InputError
            If the camera's spectral response cannot be loaded.
        """
        camera = config.camera
        return cls(
            config.assessment, load_response(camera.response), camera.white_reference,
            config.lighting.model == "daylight")

    def assess(self, estimate: WaterEstimate) -> Visibility:
        """Assess visibility and depth, with standard deviations by propagation.

        Returns
        -------
        Visibility
            Mean attenuation and depth need all three channels. The distance
            is that of the best channel; a channel too dark to be assessed is
            not the best one.
        """
        covariance = joint_covariance(estimate)
        seen = np.isfinite(estimate.attenuation)
        alpha, alpha_stddev = self._mean_attenuation(estimate, covariance)
        status, distance, distance_stddev = estimate.status, math.nan, math.nan
        if seen.any() and not estimate.refused_in_light.any():
            distance, distance_stddev = self._distance(estimate, covariance)
            if not distance_stddev <= MAX_RELATIVE_STDDEV * distance:
                status, distance, distance_stddev = _first(
                    status, Status.RANGE_SPREAD_TOO_SMALL), math.nan, math.nan
        depth_status, depth = estimate.status, (math.nan, math.nan, math.nan)
        if not self._by_daylight:
            depth_status = Status.NO_DEPTH_BY_LAMPS
        elif estimate.status is Status.OK:
            depth_status, depth = self._assess_depth(estimate)
            if estimate.grey_on_average and self._white_is_daylight and estimate.light is not None:
                depth_status, depth = Status.GREY_ON_AVERAGE, (math.nan,) * 3
            largest = MAX_RELATIVE_STDDEV * self._config.max_depth
            if depth_status is Status.OK and not depth[1] <= largest:
                depth_status, depth = Status.AMBIENT_LIGHT_UNBOUNDED, (math.nan,) * 3
        return Visibility(
            status, depth_status, alpha, alpha_stddev, distance, distance_stddev, *depth)

    def _assess_depth(self, estimate: WaterEstimate) -> tuple[Status, tuple[float, float, float]]:
        """Depth by the colour of daylight, its standard deviation and its precision.

        Where veil and light are told apart, the light is what came down; its depth
        holds what is not known of the water above and of the camera's white.
        """
        depth, precision = self._depth.depth(
            estimate.attenuation, estimate.scene_light, covariance_with_light(estimate))
        if estimate.light is None:
            return Status.OK, (depth, precision, precision)
        patches = np.zeros((6, 6))
        # The veil's part of it is in the precision.
        of_veil = estimate.ambient_light_stddev * estimate.scene_light / estimate.veil
        patches[1::2, 1::2] = np.diag(
            np.maximum(estimate.scene_light_stddev**2 - of_veil**2, 0.0))
        _, scene = self._depth.depth(estimate.attenuation, estimate.scene_light, patches)
        model, colour_error = self._depth.model_stddev(
            depth, estimate.attenuation, estimate.attenuation_stddev, estimate.scene_light)
        if colour_error > MAX_COLOUR_ERROR:
            return Status.NO_DAYLIGHT_COLOUR, (math.nan, math.nan, math.nan)
        return Status.OK, (depth, math.hypot(precision, scene, model), precision)

    def _mean_attenuation(
        self, estimate: WaterEstimate, covariance: NDArray[np.float64]
    ) -> tuple[float, float]:
        """Mean attenuation by particles (eq. 9)."""
        alpha = float(np.mean(estimate.attenuation - self.clear_water_attenuation))
        return alpha, math.sqrt(covariance[0::2, 0::2].sum()) / 3

    def _distance(
        self, estimate: WaterEstimate, covariance: NDArray[np.float64]
    ) -> tuple[float, float]:
        """Distance at which contrast falls to the visible one, in the best channel (eq. 12)."""
        contrast = self._config.contrast
        best = int(np.nanargmin(estimate.attenuation))
        attenuation = float(estimate.attenuation[best])
        distance = visibility_distance(attenuation, contrast)
        part = math.sqrt(covariance[2 * best, 2 * best]) / attenuation
        # The distance goes as 1/β: where β is uncertain it is farther more than nearer, which
        # the second order of half the difference between both says.
        return distance, distance * part * (1.0 + part**2)


def joint_covariance(estimate: WaterEstimate) -> NDArray[np.float64]:
    """Return the covariance of β_R, I∞_R, β_G, I∞_G, β_B, I∞_B, (6, 6) float64.

    The channels of an estimate that has none are taken as independent.
    """
    if estimate.joint_covariance is not None:
        return estimate.joint_covariance
    joint = np.zeros((6, 6))
    for channel in range(3):
        block = slice(2 * channel, 2 * channel + 2)
        joint[block, block] = estimate.covariance[channel]
    return joint


def covariance_with_light(estimate: WaterEstimate) -> NDArray[np.float64]:
    """Return `joint_covariance` with the light on the scene in the place of I∞.

    How the light differs between frames of one scene is how the veil does.
    """
    scale = np.ones(6)
    scale[1::2] = estimate.scene_light / estimate.ambient_light
    return np.asarray(joint_covariance(estimate) * np.outer(scale, scale))


def _first(status: Status, other: Status) -> Status:
    return other if status is Status.OK else status
