# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense stereo matching of one pair."""

from __future__ import annotations

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import Image
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import StereoResult
from uw_visibility.stereo.rig import StereoRig


def match(
    left: Image,
    right: Image,
    rig: StereoRig,
    config: PipelineConfig | None = None,
) -> StereoResult:
    """Match a rectified pair densely, with its contrast restored where water took it.

    Both steps of the paper's Fig. 4 without the enhanced images; whoever has many
    pairs of one size keeps a `Pipeline` instead.

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
        Disparity, px, with its confidence, and range, m; NaN where unmatched. Nothing
        is filled.

    Raises
    ------
    InputError
        If the images do not fit, or show nothing that could be matched.
    """
    return Pipeline(rig, config).process(left, right, enhance=()).stereo
