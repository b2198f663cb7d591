# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Parts of the pipeline put together otherwise: image of step 1, matching with true water.

The pipeline needs the contrast of step 1 only, for matching. Fig. 7 of the paper
shows its colours too, so they are made here from the same parts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.evaluation.readings import Truth
from uw_visibility.images.arrays import DisparityMap, Image8
from uw_visibility.images.view import StereoViews, View
from uw_visibility.pipeline.first_step import CoarseEstimate
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import StageClock
from uw_visibility.pipeline.second_step import SecondStep
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import WaterEstimate


def first_enhancement(
    left: NDArray[Any],
    right: NDArray[Any],
    pipeline: Pipeline,
) -> NDArray[Any]:
    """Restore the left image with the coarse map of step 1 and its estimate of the water.

    Parameters
    ----------
    left, right : (H, W, 3) ndarray
        The pair under water.
    pipeline : Pipeline
        Takes the first step.

    Returns
    -------
    ndarray
        Like `left`.
    """
    config = pipeline.config
    first = pipeline.coarse_estimate(left, right)
    dense = first.whole_disparity()
    restorer = Restorer(config.enhancement, config.camera.transfer, Workers(config.threads))
    enhanced, _ = restorer.restore(left, pipeline.rig.range_from_disparity(dense), first.water)
    return np.asarray(enhanced)


def match_with_truth(
    left: Image8,
    right: Image8,
    disparity: DisparityMap,
    truth: Truth,
    rig: StereoRig,
    config: PipelineConfig,
) -> DisparityMap:
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
