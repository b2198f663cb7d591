# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Oracle of stereo matching: our matcher given the true water and ranges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.evaluation.readings import Truth
from uw_visibility.images.view import StereoViews, View
from uw_visibility.pipeline.first_step import CoarseEstimate
from uw_visibility.pipeline.second_step import SecondStep
from uw_visibility.pipeline.timing import StageClock
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import WaterEstimate


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
    transfer = config.camera.transfer
    views = StereoViews(View.of(left, transfer), View.of(right, transfer))
    step = SecondStep(views.left.shape, rig, config, Workers(config.threads))
    water = WaterEstimate(
        Status.OK, np.array(truth.attenuation), np.array(truth.ambient_light),
        np.zeros((3, 2, 2)), 0, 0, (Status.OK,) * 3,
    )
    raw = step.support_points(*views)
    known = CoarseEstimate(water, raw, disparity, rig, views.left, np.ones(3), 1.0)
    return step.run(views, known, StageClock()).disparity
