# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Errors beside depth edges, and what the matcher reaches with the truth."""

from dataclasses import replace

import numpy as np
import pytest

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility_lab.evaluation.cases import match_with_truth
from uw_visibility_lab.evaluation.degrade import fill_from_background
from uw_visibility_lab.evaluation.depth_edges import MAPS, edge_errors
from uw_visibility_lab.evaluation.metrics import correct_fraction
from uw_visibility_lab.evaluation.readings import Truth
from uw_visibility_lab.evaluation.scenes import render_scene
from uw_visibility_lab.simulation.camera import StereoCamera

ALPHA, DEPTH = 0.3, 2.0
CLEAR_WATER = clear_water_attenuation(load_response("nikon_d5100"))


@pytest.fixture(scope="module")
def seen():
    """A rendered scene in turbid water, and what the pipeline says of it."""
    camera = StereoCamera(320, 240, 280.0, 0.2)
    scene = render_scene(0, camera)
    truth = Truth.of_clear_water_and_particles(ALPHA, DEPTH, CLEAR_WATER, 0.05)
    left, right = scene.degraded(ALPHA, DEPTH, CLEAR_WATER)
    config = PipelineConfig.from_parameters({"threads": 1, "stereo.max_disparity": 63})
    rig = scene.rig
    return scene, truth, left, right, rig, config, Pipeline(rig, config).process(left, right)


def test_errors_near_edges_fall_from_the_mesh_to_the_truth(seen):
    scene, _, left, right, rig, config, result = seen
    errors = {e.map: e for e in edge_errors(scene, left, right, result, rig, config)}
    assert list(errors) == list(MAPS)
    assert errors["truth"].disparity_near == errors["truth"].disparity_elsewhere == 0
    for field in ("disparity_near", "colour_near"):
        mesh, guided, final, truth = (
            getattr(errors[name], field) for name in ("mesh", "guided", "final", "truth"))
        assert truth < final < guided < mesh
    # The filter stands for the solve.
    assert errors["guided"].disparity_near < 1.15 * errors["laplacian"].disparity_near


def test_the_truth_matches_at_least_as_much(seen):
    scene, truth, left, right, rig, config, result = seen
    filled = fill_from_background(scene.disparity_left)
    known = match_with_truth(left, right, filled, truth, rig, config)
    ours, oracle = (
        correct_fraction(d, scene.disparity_left) for d in (result.disparity, known))
    assert oracle > ours - 0.01
    # Ranges that are wrong take contrast from where it is needed, in turbid water.
    turbid = Truth.of_clear_water_and_particles(0.5, DEPTH, CLEAR_WATER, 0.05)
    pair = scene.degraded(0.5, DEPTH, CLEAR_WATER)
    right_ranges, wrong_ranges = (
        correct_fraction(match_with_truth(*pair, ranges, turbid, rig, config), scene.disparity_left)
        for ranges in (filled, np.full_like(filled, 60)))
    assert right_ranges > wrong_ranges


def test_the_truth_is_matched_on_small_copies_too(seen):
    scene, truth, left, right, rig, config, _ = seen
    config = replace(config, stereo=replace(config.stereo, reduction=2))
    filled = fill_from_background(scene.disparity_left)
    known = match_with_truth(left, right, filled, truth, rig, config)
    ours = Pipeline(rig, config).process(left, right).disparity
    assert known.shape == filled.shape
    oracle, found = (correct_fraction(d, scene.disparity_left) for d in (known, ours))
    assert oracle > found - 0.01
