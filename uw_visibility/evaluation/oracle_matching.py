# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Oracle of stereo matching: our matcher given the true water and ranges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.evaluation.readings import Truth
from uw_visibility.pipeline.second_step import Stages
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimation import WaterEstimate


def match_with_truth(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    disparity: NDArray[np.float32],
    truth: Truth,
    rig: StereoRig,
    config: PipelineConfig,
) -> NDArray[np.float32]:
    """Match a pair as step 2 does, with nothing estimated.

    Parameters
    ----------
    left, right : (H, W, 3) uint8 ndarray
        The pair under water.
    disparity : (H, W) float32 ndarray
        True disparity of the left view, without holes, px.
    truth : Truth
        The water.
    rig, config
        Those of the pipeline.

    Returns
    -------
    (H, W) float32 ndarray
        Disparity, px; NaN where unmatched.
    """
    stages = Stages((left.shape[0], left.shape[1]), rig, config, Workers(config.threads))
    water = WaterEstimate(
        Status.OK, np.array(truth.attenuation), np.array(truth.ambient_light),
        np.zeros((3, 2, 2)), 0, 0, (Status.OK,) * 3,
    )
    stages.describe_raw(left, right)
    raw = stages.matcher.support_points().points
    airlight = stages.airlight_prior(left, water, raw)
    stages.describe_restored(left, right, disparity, rig, water, np.ones(3))
    support = stages.matcher.support_points(airlight, raw)
    return stages.matcher.dense_disparity(support, airlight).disparity
