# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Single cases of the adverse study: what a level does reaches the estimators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uw_visibility.config.schema import PipelineConfig
from uw_visibility_lab.evaluation.adverse.cases import (
    AdverseCase,
    evaluate_adverse_case,
)
from uw_visibility_lab.evaluation.adverse.effects import Level
from uw_visibility_lab.evaluation.adverse.scenes import find_adverse_scenes, load_adverse_scene
from uw_visibility_lab.evaluation.scenes import SceneSource
from uw_visibility_lab.evaluation.studies import StudyResult
from uw_visibility_lab.simulation.camera import CameraEffects
from uw_visibility_lab.simulation.water import WaterEffects

CONFIG = PipelineConfig.from_parameters({"threads": 1})


def run(source: SceneSource, alpha: float = 0.3, **level: object):
    case = AdverseCase(source, "test", Level("test", **level), alpha, 2.0)
    return evaluate_adverse_case(case, CONFIG)


@pytest.fixture(scope="module")
def source(scene_folder: Path) -> SceneSource:
    (found,) = find_adverse_scenes([scene_folder])
    return found


@pytest.fixture(scope="module")
def plain(source: SceneSource) -> StudyResult:
    return run(source)


def test_ranges_that_are_twice_as_long_halve_the_attenuation(source, plain) -> None:
    scaled = run(source, range_scale=2.0)
    assert scaled.truth == plain.truth
    ratios = {
        name: 2.0 * np.array(scaled.readings[name].attenuation) / plain.readings[name].attenuation
        for name in ("paper", "sea_thru")}
    np.testing.assert_allclose(ratios["paper"], 1.0, rtol=0.02)
    # Sea-thru's fit of red has two minima of nearly one cost; rounding chooses.
    assert (np.abs(ratios["sea_thru"] - 1.0) < 0.02).sum() >= 2


def test_a_scene_without_contrast_is_sand(source, plain) -> None:
    """Nothing is dark, which the plain fit takes for turbid water."""
    faded = run(source, contrast=0.3)
    assert faded.truth == plain.truth
    assert (faded.readings["paper"].mean_attenuation
            > plain.readings["paper"].mean_attenuation + 0.05)


def test_what_the_estimator_is_told_of_the_camera_reaches_it(source, plain) -> None:
    told = run(source, camera=CameraEffects(transfer="srgb"),
               parameters={"camera.transfer": "srgb"})
    untold = run(source, camera=CameraEffects(transfer="srgb"))
    errors = [
        abs(result.readings["paper"].mean_attenuation
            - plain.readings["paper"].mean_attenuation) for result in (told, untold)
    ]
    assert errors[0] < 0.02
    assert errors[1] > 0.05


def test_the_truth_holds_the_white_balance(source, plain) -> None:
    balanced = run(source, camera=CameraEffects(white_balance=(1.2, 1.0, 0.5)))
    np.testing.assert_allclose(
        balanced.truth.ambient_light, np.array(plain.truth.ambient_light) * [1.2, 1.0, 0.5])


def test_rendered_scenes_with_and_without_open_water() -> None:
    sources = find_adverse_scenes([])
    assert sorted({source.open_water for source in sources}) == [False, True]
    for source in sources[1:3]:
        scene = load_adverse_scene(source)
        unknown = np.isnan(scene.disparity)
        np.testing.assert_array_equal(unknown, np.isinf(scene.left.range))
        assert (unknown.mean() > 0.05) == source.open_water
        ranges = scene.rig.range_from_disparity(scene.disparity)
        np.testing.assert_allclose(ranges[~unknown], scene.left.range[~unknown], rtol=1e-5)


def test_the_effective_attenuation_is_the_truth_of_a_spectrum(source, plain) -> None:
    water = run(source, alpha=0.0, water=WaterEffects(water_type="III")).truth
    # Red, of which water takes the far end of the spectrum first.
    assert water.attenuation[0] > water.attenuation[2] > 0.14
    assert water.distance == pytest.approx(np.log(10.5) / min(water.attenuation))
