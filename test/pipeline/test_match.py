# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Matching of one pair in a line."""

from __future__ import annotations

import numpy as np

from uw_visibility import estimate_water, match
from uw_visibility.config.schema import PipelineConfig
from uw_visibility_lab.evaluation.scenes import load_source

CLEAR = np.array([0.228, 0.066, 0.025])


def test_a_pair_is_matched_and_its_water_read():
    scene = load_source(0)
    left, right = scene.degraded(0.2, 2.0, CLEAR)
    rig = scene.rig
    stereo = match(left, right, rig, PipelineConfig.from_parameters({"stereo.max_disparity": 96}))
    matched = np.isfinite(stereo.disparity)
    np.testing.assert_array_equal(np.isfinite(stereo.range), matched)
    with np.errstate(invalid="ignore"):
        hit = np.abs(stereo.disparity - scene.disparity_left) <= 1.0
    assert hit[scene.known].mean() > 0.7
    assert stereo.confidence[hit].mean() > stereo.confidence[matched & scene.known & ~hit].mean()
    found = estimate_water(left, stereo.disparity, rig)
    assert (np.abs(found.water.attenuation - CLEAR - 0.2)
            < 3 * found.water.attenuation_stddev).all()
