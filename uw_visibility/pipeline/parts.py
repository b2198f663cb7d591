# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parts of the pipeline: estimation of the water from given disparities, and dense matching."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Image, Mask, RangeMap
from uw_visibility.images.pair import check_image, check_valid
from uw_visibility.images.view import View
from uw_visibility.images.vignetting import FlatFieldCorrection
from uw_visibility.pipeline.coincidence import show_one_scene
from uw_visibility.pipeline.lamps import Estimators
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import StereoResult
from uw_visibility.status import Status
from uw_visibility.stereo.rig import DISPARITY_STDDEV, StereoRig
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor, Visibility
from uw_visibility.water.meaning.derived import DerivedModel, DerivedQuantities


@dataclass(frozen=True)
class WaterResult:
    """Water and visibility from one image and its ranges.

    Attributes
    ----------
    status : Status
        Whether the water could be assessed (that of `water`).
    water : WaterEstimate
        Attenuation, veil and scene light with their covariance.
    visibility : Visibility
        Mean attenuation, visibility distance and depth with standard deviations.
    derived : DerivedQuantities
        Black-disc visibility, Secchi depth, Kd and the nearest Jerlov type.
    clear_water_attenuation : ndarray
        ``(3,)`` float64, 1/m, RGB.
    range : ndarray
        ``(H, W)`` float32, m, along the line of sight; NaN where unknown.
    """

    status: Status
    water: WaterEstimate
    visibility: Visibility
    derived: DerivedQuantities
    clear_water_attenuation: Array
    range: RangeMap

    @property
    def reasons(self) -> dict[str, str]:
        """Reasons for quantities that are not assessed, by their name; empty if all are."""
        named = {
            "attenuation": self.water.status,
            "visibility": self.visibility.status,
            "depth": self.visibility.depth_status,
            "water type": self.derived.water_type_status}
        return {name: str(reason) for name, reason in named.items() if reason is not Status.OK}


def estimate_water(
    image: Image, disparity: NDArray[np.floating], rig: StereoRig,
    config: PipelineConfig | None = None, *, valid: Mask | None = None,
    disparity_stddev: float = DISPARITY_STDDEV,
) -> WaterResult:
    """Estimate attenuation, visibility and depth from an image and its disparities.

    For ranges from other sources: another matcher, structure from motion
    (disparity = focal length × baseline / Z), or a depth camera.

    Parameters
    ----------
    image : ndarray
        ``(H, W, 3)`` RGB, uint8 or uint16.
    disparity : ndarray
        ``(H, W)``, px; NaN where unknown. Leave open water unknown: it is found in the
        image. If edges of the image and steps of the ranges coincide no more than by
        chance, the status is `Status.RANGES_OF_ANOTHER_SCENE`.
    rig : StereoRig
        Geometry of the pair.
    config : PipelineConfig, optional
        The parameters of `Pipeline`.
    valid : ndarray, optional
        ``(H, W)`` bool, the pixels that show the scene.
    disparity_stddev : float
        Standard deviation of the disparities, px; 0 for exact ones.

    Returns
    -------
    WaterResult

    Raises
    ------
    InputError
        If shapes or types do not fit, or the image is smaller than 96x64 px.
    """
    image, disparity = check_image("the image", image), np.asarray(disparity)
    if disparity.shape != image.shape[:2] or disparity.dtype.kind != "f":
        raise InputError(
            f"the disparities are {disparity.dtype} of shape {disparity.shape}, the image has "
            f"the shape {image.shape}: give one floating-point number per pixel, px, NaN where "
            "unknown")
    valid = check_valid(valid, image.shape)
    number = isinstance(disparity_stddev, int | float | np.number)
    if not (number and 0.0 <= disparity_stddev < math.inf):
        raise InputError(
            f"disparity_stddev is {disparity_stddev}: give 0 or a positive, finite number, px")
    config = config or PipelineConfig()
    camera = config.camera
    centres = (rig.principal_point, rig.principal_point_right or rig.principal_point)
    image, _ = FlatFieldCorrection(camera, centres, Workers(1)).correct(image, image)
    assessor = Assessor(config)
    estimators = Estimators(config, assessor, rig)
    range_map = rig.range_from_disparity(disparity.astype(np.float32))
    if show_one_scene(image, range_map):
        view = View.of(image, camera.transfer, valid)
        error = rig.range_error(disparity_stddev)
        water = estimators.first.estimate_view(view, range_map, range_error=error)
        by_lamps = estimators.lit_by_lamps(water)
        if config.lighting.model == "auto":
            water = estimators.estimate(view, range_map, error, water)
    else:
        water = WaterEstimate.not_assessable(Status.RANGES_OF_ANOTHER_SCENE)
        by_lamps = estimators.by_daylight is None
    return WaterResult(
        water.status, water, assessor.assess(water, by_lamps),
        DerivedModel(config).derive(water), assessor.clear_water_attenuation,
        range_map)


def match(
    left: Image, right: Image, rig: StereoRig, config: PipelineConfig | None = None
) -> StereoResult:
    """Match a rectified pair densely, after restoring its contrast.

    Both steps of the paper's Fig. 4 without the enhanced images. For many pairs of
    one size, use a `Pipeline` instead.

    Parameters
    ----------
    left, right : ndarray
        ``(H, W, 3)`` RGB or ``(H, W)`` grey; uint8 or uint16; rectified.
    rig : StereoRig
        Geometry of the pair.
    config : PipelineConfig, optional
        The parameters of `Pipeline`.

    Returns
    -------
    StereoResult
        Disparity, px, with its confidence, and range, m; NaN where unmatched. Gaps are
        not filled.

    Raises
    ------
    InputError
        If the images do not fit, or show nothing that could be matched.
    """
    return Pipeline(rig, config).process(left, right, enhance=()).stereo
