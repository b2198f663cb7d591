# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The pipeline as a library, on pairs with known water."""

import numpy as np
import pytest
from scenes import blurred, codes, stereo_pair, texture

from uw_visibility import Pipeline, PipelineConfig, StereoRig
from uw_visibility.errors import InputError
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline.warm_up import warm_up_pair
from uw_visibility.status import Status
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility_lab.evaluation.degrade import load_scene

CLEAR = clear_water_attenuation(load_response("nikon_d5100"))
DEPTH = 2.0
SCENES = {"aloe": (287, 2), "art": (95, 1), "dolls": (95, 1), "moebius": (95, 1)}


@pytest.fixture(scope="module")
def in_water(shared_data):
    """Results of the four scenes at a mean attenuation of 0.2 1/m and 2 m of depth."""
    results = {}
    for name, (max_disparity, _) in SCENES.items():
        scene = load_scene(shared_data / "middlebury" / name)
        left, right = scene.degraded(0.2, DEPTH, CLEAR)
        config = PipelineConfig.from_parameters({"stereo.max_disparity": max_disparity})
        rig = scene.rig
        results[name] = scene, left, Pipeline(rig, config).process(left, right)
    return results


def test_disparity_is_right_where_raw_matching_fails(in_water):
    """Mean over the scenes; semi-global matching of the raw pairs has 0.573."""
    correct = []
    for name, (scene, _, result) in in_water.items():
        with np.errstate(invalid="ignore"):
            hit = np.abs(result.disparity - scene.disparity_left) <= SCENES[name][1]
        correct.append(hit[scene.known].mean())
    assert np.mean(correct) > 0.68


@pytest.mark.parametrize("name", SCENES)
def test_mean_attenuation_is_near_the_truth(in_water, name):
    result = in_water[name][2]
    assert result.status is Status.OK
    error = result.visibility.mean_attenuation - 0.2
    assert abs(error) <= 0.065
    assert abs(error) <= 1.2 * result.visibility.mean_attenuation_stddev


def test_mean_attenuation_is_near_the_truth_on_average(in_water):
    found = [result.visibility.mean_attenuation for _, _, result in in_water.values()]
    assert np.mean(np.abs(np.array(found) - 0.2)) < 0.035


@pytest.mark.parametrize("name", SCENES)
def test_colours_come_back(in_water, name):
    """Mean absolute error of the image, against that of the image under water.

    In art attenuation is told 0.06 1/m too small: its far wall stays pale. Aloe's far wall has no
    contrast above the codes' rounding left: it keeps the look of the water.
    """
    assert error_left(*in_water[name]) < {"art": 1.1, "aloe": 0.75}.get(name, 0.5)


def test_colours_come_back_on_average(in_water):
    assert np.mean([error_left(*each) for each in in_water.values()]) < 0.56


def error_left(scene, degraded, result):
    truth = scene.left.astype(float)
    return np.abs(result.left_enhanced - truth).mean() / np.abs(degraded - truth).mean()


@pytest.mark.parametrize("name", SCENES)
def test_nothing_unannounced_leaves(in_water, name):
    _, _, result = in_water[name]
    assert np.isfinite(result.stereo.filled).all()
    # What is filled is for colour: the range is a measured one, of matched pixels alone.
    assert not np.isnan(result.stereo.filled_range).any()
    matched = np.isfinite(result.disparity)
    assert 0.5 < matched.mean() < 1.0
    np.testing.assert_array_equal(np.isfinite(result.range), matched)
    np.testing.assert_allclose(
        result.range[matched], result.stereo.filled_range[matched], rtol=1e-5)
    assert np.nanmin(result.disparity) >= result.stereo.min_disparity
    assert np.nanmax(result.disparity) <= result.stereo.max_disparity + 1
    stages = {name: time for name, time in result.timing_ms.items() if name != "total"}
    assert result.timing_ms["total"] >= max(stages.values()) > 0


def scene_pair(disparity=14, seed=0, shape=(160, 240)):
    """A textured pair in colour: two planes, so that ranges differ."""
    wide = codes(blurred(texture((shape[0], shape[1] + 40, 3), seed), 0.6))
    return stereo_pair(wide, np.repeat((6, disparity), shape[0] // 2), shape[1])


RIG = StereoRig(focal_length=300.0, baseline=0.1, principal_point=(119.5, 79.5))


@pytest.fixture(scope="module")
def pipeline():
    return Pipeline(RIG, PipelineConfig.from_parameters({"stereo.max_disparity": 40}))


def arrays(result):
    """Return all arrays of a pair's stereo and images, by name."""
    groups = {**vars(result.stereo), **vars(result.images)}
    return {name: value for name, value in groups.items() if isinstance(value, np.ndarray)}


def test_the_same_pair_gives_the_same_bits_whatever_the_threads():
    left, right = scene_pair()
    results = [
        Pipeline(
            RIG, PipelineConfig.from_parameters({"threads": n, "stereo.max_disparity": 40})
        ).process(left, right, match_original=True)
        for n in (1, 2, 3)
    ]
    for other in results[1:]:
        for name, array in arrays(results[0]).items():
            np.testing.assert_array_equal(arrays(other)[name], array, name)
        np.testing.assert_array_equal(other.water.attenuation, results[0].water.attenuation)


def test_results_do_not_change_when_the_next_pair_comes(pipeline):
    left, right = scene_pair()
    first = pipeline.process(left, right)
    kept = {name: array.copy() for name, array in arrays(first).items()}
    pipeline.process(*scene_pair(disparity=20, seed=5))
    for name, value in kept.items():
        np.testing.assert_array_equal(arrays(first)[name], value, name)


def test_sixteen_bits_match_like_eight(pipeline):
    left, right = scene_pair()
    eight = pipeline.process(left, right)
    sixteen = pipeline.process(left.astype(np.uint16) * 257, right.astype(np.uint16) * 257)
    assert sixteen.left_enhanced.dtype == np.uint16
    both = np.isfinite(eight.disparity) & np.isfinite(sixteen.disparity)
    assert both.mean() > 0.9 * np.isfinite(eight.disparity).mean()
    # Noise is measured in other units, so that single pixels fall on the other side of an edge.
    assert np.mean(np.abs(eight.disparity - sixteen.disparity)[both] >= 2) < 0.005


def test_size_may_change_between_frames(pipeline):
    pipeline.process(*scene_pair())
    small = pipeline.process(*(np.ascontiguousarray(i[:100, :160]) for i in scene_pair()))
    assert small.disparity.shape == (100, 160)
    assert pipeline.process(*scene_pair()).disparity.shape == (160, 240)


@pytest.mark.parametrize(
    ("left", "says"),
    [
        (np.zeros((160, 240, 3), np.uint8), "left image: too dark"),
        (np.full((160, 240, 3), 255, np.uint8), "left image: saturated"),
        (np.full((160, 240, 3), 90, np.uint8), "left image: no texture"),
    ],
)
def test_blind_pairs_are_refused_with_the_cause_and_the_next_is_processed(pipeline, left, says):
    with pytest.raises(InputError, match=says):
        pipeline.process(left, left)
    assert np.isfinite(pipeline.process(*scene_pair()).disparity).mean() > 0.5


@pytest.mark.parametrize("options, says", [
    ({"valid": np.ones((3, 3), bool)}, "shape .3, 3."),
    ({"valid": np.ones((120, 160), np.uint8)}, "valid pixels are uint8"),
    ({"valid": [[True]]}, r"valid pixels are bool of shape \(1, 1\)"),
    ({"valid": [[True], [True, False]]}, "valid pixels are object"),
    ({"enhance": ["Left"]}, r"enhance is \['Left'\]: give a tuple"),
    ({"enhance": "left"}, "enhance is 'left': give a tuple"),
    ({"enhance": None}, "enhance is None: give a tuple"),
])
def test_options_that_do_not_fit_the_pair_are_named(pipeline, options, says):
    left, right = warm_up_pair((120, 160), np.dtype(np.uint8))
    with pytest.raises(InputError, match=says):
        pipeline.process(left, right, **options)


def test_exchanged_images_are_recognised(pipeline):
    left, right = scene_pair()
    with pytest.raises(InputError, match="exchange left and right"):
        pipeline.process(right, left)


def test_a_search_range_that_leaves_nothing_is_refused():
    config = PipelineConfig.from_parameters(
        {"stereo.min_disparity": 50, "stereo.max_disparity": 52}
    )
    with pytest.raises(InputError, match=r"stereo\.min_disparity is 50"):
        Pipeline(RIG, config).process(*scene_pair())


@pytest.mark.parametrize("given, says", [
    ((None,), "rig is a NoneType: give a StereoRig"),
    ((RIG, {"threads": 1}), r"config is a dict: give a PipelineConfig"),
])
def test_arguments_of_other_types_are_named(given, says):
    with pytest.raises(InputError, match=says):
        Pipeline(*given)


def test_an_image_is_restored_with_step_1_where_step_2_is_refused(monkeypatch):
    """The estimate stays refused; the image is not handed back as it came."""
    left, right = warm_up_pair((160, 240), np.dtype(np.uint8))
    pipeline = Pipeline(RIG, PipelineConfig.from_parameters({"stereo.max_disparity": 40}))
    estimate = WaterEstimator.estimate_view

    calls = []

    def only_once(self, *arguments, **named):
        calls.append(arguments)
        if len(calls) == 2:
            return WaterEstimate.not_assessable(Status.FIT_FAILED)
        return estimate(self, *arguments, **named)

    monkeypatch.setattr(WaterEstimator, "estimate_view", only_once)
    refused = pipeline.process(left, right)
    assert refused.status is Status.FIT_FAILED
    assert refused.coarse_water.status is Status.OK
    assert np.isnan(refused.visibility.distance)
    assert np.abs(refused.left_enhanced.astype(int) - left).mean() > 2
