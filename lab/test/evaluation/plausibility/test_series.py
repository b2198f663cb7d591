# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Series of depth over rendered transects: the same as alone, kept, refused where of another."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility_lab.evaluation.plausibility.series import (
    FITTED,
    LEFT_OUT,
    MAX_DISPARITY,
    load_series,
    swim,
)
from uw_visibility_lab.simulation.camera import StereoCamera

SMALL = StereoCamera(96, 72, 90.0, 0.12)
WAY = {
    name: replace(transect, frames=2, camera=SMALL, seed=3)
    for name, transect in (*FITTED.items(), *LEFT_OUT.items())
    if name in ("1 grey, 2 to 6 m", "4 grey, 4 m, caustics")
}


def test_transects_of_a_way_are_as_each_alone() -> None:
    together = zip(*swim(list(WAY.values()), Workers(1)), strict=True)
    for transect, series in zip(WAY.values(), together, strict=True):
        pipeline = Pipeline(SMALL.rig, PipelineConfig.from_parameters(
            {"stereo.max_disparity": MAX_DISPARITY, "threads": 1}))
        for seen, (time, frame) in zip(series, transect.render(Workers(1)), strict=True):
            told = pipeline.process(frame.left, frame.right, enhance=()).visibility
            assert (seen.time, seen.truth) == (time, frame.depth)
            np.testing.assert_array_equal(
                (seen.depth, seen.stddev, seen.precision),
                (told.depth, told.depth_stddev, told.depth_precision))


def test_series_are_kept_and_those_of_another_plan_or_damaged_are_refused(tmp_path: Path) -> None:
    (name, plan), *_ = WAY.items()
    first = load_series({name: plan}, tmp_path, Workers(1))
    (file,) = tmp_path.iterdir()
    kept = json.loads(file.read_text())
    kept["seen"][1][2] = 7.5
    kept["seen"][1][3] = None
    file.write_text(json.dumps(kept))
    again = load_series({name: plan}, tmp_path)[name]
    assert (again[0].truth, again[1].depth) == (first[name][0].truth, 7.5)
    assert math.isnan(again[1].stddev)
    with pytest.raises(InputError, match="of another plan or version: remove it"):
        load_series({name: replace(plan, depth=(3.0, 3.0))}, tmp_path)
    file.write_text(json.dumps({**kept, "seen": [[1.0, 2.0]]}))
    with pytest.raises(InputError, match="is damaged: remove it"):
        load_series({name: plan}, tmp_path)


def test_no_way_that_is_left_out_was_fitted_to() -> None:
    assert not {t.seed for t in FITTED.values()} & {t.seed for t in LEFT_OUT.values()}
    assert not FITTED.keys() & LEFT_OUT.keys()
