# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Series of depth over rendered transects."""

from __future__ import annotations

from dataclasses import replace

from uw_visibility.compute.threads import Workers
from uw_visibility_lab.evaluation.plausibility.series import FITTED, LEFT_OUT, render_series
from uw_visibility_lab.simulation.camera import StereoCamera


def test_a_series_has_the_true_depth_of_each_frame() -> None:
    way = replace(
        FITTED["1 grey, 2 to 6 m"], frames=2, camera=StereoCamera(96, 72, 90.0, 0.12), seed=3)
    series = render_series(way, Workers(1))
    assert [(seen.time, seen.truth) for seen in series] == [(0.0, 2.0), (0.5, 6.0)]


def test_no_way_that_is_left_out_was_fitted_to() -> None:
    assert not {t.seed for t in FITTED.values()} & {t.seed for t in LEFT_OUT.values()}
    assert not FITTED.keys() & LEFT_OUT.keys()
