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
from uw_visibility.enhancement.matting import Matting
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.parallel import Workers
from uw_visibility.result import FrameResult
from uw_visibility.stereo.contrast import EvenContrast
from uw_visibility.stereo.elas import Matcher
from uw_visibility.stereo.interpolation import fill_plane
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
        What the pipeline said of the pair; `step1` and the limits of the search are used.
    rig, config
        Those of the pipeline.

    Returns
    -------
    ndarray
        Like `left`.
    """
    workers = Workers(config.threads)
    limits = (result.min_disparity, result.max_disparity)
    matcher = Matcher(left.shape[:2], limits, config.stereo, workers)
    contrasts = (EvenContrast(left.shape[:2]), EvenContrast(left.shape[:2]))
    for contrast, image in zip(contrasts, (left, right), strict=True):
        contrast.stretch(image, workers)
    matcher.describe(*contrasts)
    support = matcher.support_points()
    mesh = matcher.coarse_disparity(support)
    coarse, _ = fill_plane(mesh, support.points)
    dense = Matting(config.enhancement, workers).refine(coarse, None, left).disparity
    restorer = Restorer(config.enhancement, config.camera.transfer, workers)
    enhanced, _ = restorer.restore(left, rig.range_from_disparity(dense), result.step1)
    return np.asarray(enhanced)
