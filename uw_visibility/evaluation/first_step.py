# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""First enhancement (Fig. 4, step 1), an image that the pipeline never makes.

The pipeline needs the contrast of step 1 only, for matching. Fig. 7 of the paper
shows its colours too, so they are made here from the same parts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.pipeline.pipeline import Pipeline


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
