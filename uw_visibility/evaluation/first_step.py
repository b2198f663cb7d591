# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The image after the first enhancement (Fig. 4, step 1), which the pipeline never makes.

The pipeline needs the contrast of step 1 only, for matching. Fig. 7 of the paper
shows its colours too, so they are made here from the same parts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config import PipelineConfig
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.parallel import Workers
from uw_visibility.result import FrameResult
from uw_visibility.stages import Stages
from uw_visibility.stereo.rig import StereoRig


def first_enhancement(
    left: NDArray[Any],
    right: NDArray[Any],
    result: FrameResult,
    rig: StereoRig,
    config: PipelineConfig,
) -> NDArray[Any]:
    """Restore the left image with the coarse map of step 1 and what it says of the water.

    Parameters
    ----------
    left, right : (H, W, 3) ndarray
        The pair under water.
    result : FrameResult
        What the pipeline said of the pair; `step1` is used.
    rig, config
        Those of the pipeline.

    Returns
    -------
    ndarray
        Like `left`.
    """
    workers = Workers(config.threads)
    stages = Stages((left.shape[0], left.shape[1]), rig, config, workers)
    stages.describe_raw(left, right)
    support = stages.matcher.support_points()
    dense = stages.dense_map(stages.matcher.coarse_disparity(support), support, left)
    restorer = Restorer(config.enhancement, config.camera.transfer, workers)
    enhanced, _ = restorer.restore(left, rig.range_from_disparity(dense), result.step1)
    return np.asarray(enhanced)
