# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence: what it is called to be, on scenes whose disparity is known."""

import numpy as np
import pytest

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility_lab.evaluation.degrade import load_scene
from uw_visibility_lab.evaluation.scenes import render_scene, search_limit
from uw_visibility_lab.simulation.camera import Sensor

PARTS = 5


def matched(scene, mean_attenuation, codes=0.0, **parameters):
    """Process a scene at a depth of 2 m, its images with Gaussian noise."""
    kappa = clear_water_attenuation(load_response("nikon_d5100"))
    config = PipelineConfig.from_parameters(
        {"stereo.max_disparity": search_limit(scene) - 1, "threads": 1, **parameters})
    rig = scene.rig
    pair = scene.degraded(mean_attenuation, 2.0, kappa, Sensor.gaussian(codes))
    return Pipeline(rig, config).process(*pair, enhance=())


def curve(scene, mean_attenuation, codes=0.0):
    """Confidence, share within 1 px and mean error, by fifths of the confidence."""
    result = matched(scene, mean_attenuation, codes)
    assert result.stereo.confidence.dtype == np.float32
    np.testing.assert_array_equal(result.stereo.confidence > 0, np.isfinite(result.disparity))
    known = scene.known & np.isfinite(result.disparity)
    confidence = result.stereo.confidence[known]
    error = np.abs(result.disparity - scene.disparity_left)[known]
    edges = np.quantile(confidence, np.linspace(0, 1, PARTS + 1))
    part = np.clip(np.searchsorted(edges, confidence, "right") - 1, 0, PARTS - 1)
    return np.array([
        (confidence[part == k].mean(), np.mean(error[part == k] <= 1), error[part == k].mean())
        for k in range(PARTS)
    ])


@pytest.mark.parametrize("mean_attenuation", [0.0, 0.3])
@pytest.mark.parametrize("name", ["art", "dolls", "moebius"])
def test_it_is_the_share_of_right_disparities(shared_data, name, mean_attenuation):
    confidence, right, error = curve(
        load_scene(shared_data / "middlebury" / name), mean_attenuation).T
    assert np.all(np.diff(error) < 0)
    assert np.all(np.diff(right) > 0)
    assert np.abs(confidence - right).max() < 0.13
    assert abs(confidence.mean() - right.mean()) < 0.05
    # It tells much: among the best fifth hardly any is wrong, among the worst many are.
    assert right[-1] > 0.96
    assert right[0] < 0.8


def test_it_falls_with_the_error_on_a_rendered_scene():
    confidence, right, error = curve(render_scene(5), 0.2).T
    assert error[0] > 2 * error[1]
    assert right[0] < right[1:].min()
    assert np.abs(confidence - right).max() < 0.06


@pytest.mark.parametrize(("codes", "mean_attenuation"), [(2.0, 0.1), (2.0, 0.3), (4.0, 0.2)])
@pytest.mark.parametrize("name", ["art", "dolls", "moebius"])
def test_noise_makes_it_less_sure(shared_data, name, codes, mean_attenuation):
    scene = load_scene(shared_data / "middlebury" / name)
    confidence, right, _ = curve(scene, mean_attenuation, codes).T
    assert np.all(np.diff(right) > 0)
    # Without regard to noise it says 0.87 on average, where 0.46 to 0.85 are right.
    assert abs(confidence.mean() - right.mean()) < 0.12
    assert abs(confidence[-1] - right[-1]) < 0.12


def test_unsure_matches_are_left_out_where_that_is_asked_for(shared_data):
    scene = load_scene(shared_data / "middlebury" / "dolls")
    whole = matched(scene, 0.2, 2.0)
    sure = matched(scene, 0.2, 2.0, **{"stereo.min_confidence": 0.6})
    kept = np.isfinite(sure.disparity)
    np.testing.assert_array_equal(kept, whole.stereo.confidence >= 0.6)
    np.testing.assert_array_equal(sure.disparity[kept], whole.disparity[kept])
    np.testing.assert_array_equal(sure.stereo.confidence > 0, kept)
    hidden = unseen_in_right(scene)
    assert kept[hidden].mean() < 0.16
    tell = np.abs(whole.disparity - scene.disparity_left) <= 1
    assert (tell & kept).sum() > 0.9 * tell.sum()


@pytest.mark.parametrize(("codes", "mean_attenuation", "seen"), [
    (0.0, 0.2, 0.9), (1.0, 0.2, 0.88), (2.0, 0.2, 0.8), (4.0, 0.3, 0.6),
])
def test_hardly_any_of_what_the_right_image_does_not_show_is_matched(
    shared_data, codes, mean_attenuation, seen
):
    of_hidden, of_seen = [], []
    for name in ("art", "dolls", "moebius"):
        scene = load_scene(shared_data / "middlebury" / name)
        found = np.isfinite(matched(scene, mean_attenuation, codes).disparity)
        hidden = unseen_in_right(scene)
        of_hidden.append(found[hidden].mean())
        of_seen.append(found[scene.known & ~hidden].mean())
    # In noise three pixels of ten were, before look-alikes were asked.
    assert np.mean(of_hidden) < 0.185
    assert np.mean(of_seen) > seen


def unseen_in_right(scene):
    """Pixels of the left image that the right one does not show: something nearer is there."""
    truth = scene.disparity_left
    rows, columns = np.indices(truth.shape)
    there = np.rint(columns - np.nan_to_num(truth)).astype(int)
    nearer = scene.disparity_right[rows, np.maximum(there, 0)] > truth + 1.5
    return np.isfinite(truth) & ((there < 0) | nearer)
