# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Series of depth over rendered transects: the same as alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility_lab.evaluation.plausibility.series import (
    FITTED,
    LEFT_OUT,
    MAX_DISPARITY,
    render_series,
)
from uw_visibility_lab.simulation.camera import StereoCamera

SMALL = StereoCamera(96, 72, 90.0, 0.12)
WAY = {
    name: replace(transect, frames=2, camera=SMALL, seed=3)
    for name, transect in (*FITTED.items(), *LEFT_OUT.items())
    if name in ("1 grey, 2 to 6 m", "4 grey, 4 m, caustics")
}


def test_transects_of_a_way_are_as_each_alone() -> None:
    together = render_series(WAY, Workers(1))
    for name, transect in WAY.items():
        pipeline = Pipeline(SMALL.rig, PipelineConfig.from_parameters(
            {"stereo.max_disparity": MAX_DISPARITY, "threads": 1}))
        for seen, (time, frame) in zip(together[name], transect.render(Workers(1)), strict=True):
            told = pipeline.process(frame.left, frame.right, enhance=()).visibility
            assert (seen.time, seen.truth) == (time, frame.depth)
            np.testing.assert_array_equal(
                (seen.depth, seen.stddev, seen.precision),
                (told.depth, told.depth_stddev, told.depth_precision))


def test_no_way_that_is_left_out_was_fitted_to() -> None:
    assert not {t.seed for t in FITTED.values()} & {t.seed for t in LEFT_OUT.values()}
    assert not FITTED.keys() & LEFT_OUT.keys()
