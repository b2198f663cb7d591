# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence is the share of correct disparities on known scenes; look-alikes determine it."""

import numpy as np
import pytest

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas import confidence
from uw_visibility.stereo.elas.descriptors import BYTES
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
    sure = result.stereo.confidence[known]
    error = np.abs(result.disparity - scene.disparity_left)[known]
    edges = np.quantile(sure, np.linspace(0, 1, PARTS + 1))
    part = np.clip(np.searchsorted(edges, sure, "right") - 1, 0, PARTS - 1)
    return np.array([
        (sure[part == k].mean(), np.mean(error[part == k] <= 1), error[part == k].mean())
        for k in range(PARTS)
    ])


@pytest.mark.parametrize(("name", "mean_attenuation"), [
    ("art", 0.0), ("dolls", 0.3), ("moebius", 0.3)])
def test_it_is_the_share_of_right_disparities(shared_data, name, mean_attenuation):
    sure, right, error = curve(
        load_scene(shared_data / "middlebury" / name), mean_attenuation).T
    assert np.all(np.diff(error) < 0)
    assert np.all(np.diff(right) > 0)
    # In the least certain fifth fewer are right than the confidence: 0.34 instead of 0.55 on art.
    assert abs(sure[0] - right[0]) < 0.21
    assert np.abs(sure - right)[1:].max() < 0.13
    assert abs(sure.mean() - right.mean()) < 0.05
    # It separates well: hardly any of the best fifth are wrong, but many of the worst are.
    assert right[-1] > 0.96
    assert right[0] < 0.8


def test_it_falls_with_the_error_on_a_rendered_scene():
    sure, right, error = curve(render_scene(5), 0.2).T
    assert error[0] > 2 * error[1]
    assert right[0] < right[1:].min()
    assert np.abs(sure - right).max() < 0.06


@pytest.mark.parametrize(("name", "codes", "mean_attenuation"), [
    ("art", 2.0, 0.1), ("dolls", 2.0, 0.3), ("moebius", 4.0, 0.2)])
def test_noise_makes_it_less_sure(shared_data, name, codes, mean_attenuation):
    scene = load_scene(shared_data / "middlebury" / name)
    sure, right, _ = curve(scene, mean_attenuation, codes).T
    assert np.all(np.diff(right) > 0)
    # Without a term for noise it is 0.87 on average, where 0.46 to 0.85 are right.
    assert abs(sure.mean() - right.mean()) < 0.12
    assert abs(sure[-1] - right[-1]) < 0.12


def test_unsure_matches_are_left_out_where_that_is_asked_for(shared_data):
    scene = load_scene(shared_data / "middlebury" / "dolls")
    whole = matched(scene, 0.2, 2.0)
    limited = matched(scene, 0.2, 2.0, **{"stereo.min_confidence": 0.6})
    kept = np.isfinite(limited.disparity)
    np.testing.assert_array_equal(kept, whole.stereo.confidence >= 0.6)
    np.testing.assert_array_equal(limited.disparity[kept], whole.disparity[kept])
    np.testing.assert_array_equal(limited.stereo.confidence > 0, kept)
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
    # In noise it was three pixels of ten without the look-alikes' votes.
    assert np.mean(of_hidden) < 0.185
    assert np.mean(of_seen) > seen


def unseen_in_right(scene):
    """Pixels of the left image that are outside of the right one, or occluded in it."""
    truth = scene.disparity_left
    rows, columns = np.indices(truth.shape)
    there = np.rint(columns - np.nan_to_num(truth)).astype(int)
    nearer = scene.disparity_right[rows, np.maximum(there, 0)] > truth + 1.5
    return np.isfinite(truth) & ((there < 0) | nearer)


HEIGHT, WIDTH = 60, 120
# Column of the edge between a dark surface and a bright one right of it, and how far the bright
# one's disparity extends over the dark one, px.
EDGE, GROWN = 60, 8
NEAR, FAR = 20.0, 8.0


def image(noise: float = 0.0) -> ContrastNormalizer:
    """Return two tones, 100 levels apart, with noise of some levels."""
    shown = ContrastNormalizer((HEIGHT, WIDTH))
    tones = np.where(np.arange(WIDTH) < EDGE, 80.0, 180.0)
    rng = np.random.default_rng(3)
    shown.grey[:] = 256 * (tones + noise * rng.standard_normal((HEIGHT, WIDTH)))
    shown.gain[:] = 1 / 256
    return shown


def rated(disparity: np.ndarray, noise: float = 0.0) -> np.ndarray:
    blank = np.full(HEIGHT * WIDTH * BYTES, 128, np.uint8)
    # The right view denies no match, so that tones alone decide.
    right = np.full((HEIGHT, WIDTH), -1, np.int16)
    return confidence.rate(disparity, right, (blank, blank), image(noise), Workers(1))


@pytest.mark.parametrize("behind", [np.nan, FAR])
@pytest.mark.parametrize("noise", [0.0, 8.0])
def test_what_grew_over_an_edge_is_doubted(behind: float, noise: float) -> None:
    disparity = np.full((HEIGHT, WIDTH), NEAR, np.float32)
    disparity[:, : EDGE - GROWN] = behind
    found = rated(disparity, noise)
    grown = found[:, EDGE - GROWN : EDGE - 2]
    own = found[:, EDGE + 2 : EDGE + GROWN]
    # The grown part is wrong five times as often.
    assert 1 - np.quantile(grown, 0.9) > 5 * (1 - np.quantile(own, 0.1))
    assert (found[np.isnan(disparity)] == 0).all()


def test_what_the_right_view_denies_is_doubted() -> None:
    disparity = np.full((HEIGHT, WIDTH), NEAR, np.float32)
    blank = np.full(HEIGHT * WIDTH * BYTES, 128, np.uint8)
    right = np.full((HEIGHT, WIDTH), NEAR, np.int16)
    right[:30] = FAR
    found = confidence.rate(disparity, right, (blank, blank), image(), Workers(1))
    assert found[:15, 50:].max() < 0.5 < found[45:, 50:].min()


def test_of_a_surface_single_doubtful_pixels_stay_and_regions_go() -> None:
    disparity = np.full((HEIGHT, WIDTH), NEAR, np.float32)
    disparity[:, :10] = np.nan
    sure = np.where(np.isnan(disparity), 0, 0.9).astype(np.float32)
    sure[20, 50] = sure[30:50, 70:100] = 0.2
    confidence.drop_doubtful(disparity, sure, 0.5, Workers(1))
    assert disparity[20, 50] == NEAR
    assert np.isnan(disparity[30:50, 70:100]).all()
    assert np.isnan(disparity[:, :10]).all()
    assert (disparity[:, 40:70] == NEAR).all()
