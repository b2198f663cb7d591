# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The pipeline under lamps: pairs are matched, restored evenly, held over frames."""

from __future__ import annotations

from dataclasses import replace

import lamp_scene
import numpy as np
import pytest

from uw_visibility import Pipeline, PipelineConfig, estimate_water
from uw_visibility.compute.jit import counts
from uw_visibility.images.view import View
from uw_visibility.pipeline.lamps import Estimators
from uw_visibility.status import Status
from uw_visibility.water.daylight.inference import DECLARED
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility.water.series.filter import WaterFilter
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame, Renderer
from uw_visibility_lab.simulation.lamps import Lighting, default_rig, lighting_parameters
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera(320, 240, 300.0, 0.12)
LAMPS = default_rig(2)


@pytest.fixture(scope="module")
def night() -> RenderedFrame:
    """Return a reef by night, rendered by the simulator."""
    renderer = Renderer(CAMERA, lighting=Lighting(LAMPS, daylight=False, shaded=False))
    pose = Pose((0.0, 0.0, 1.5), tilt=np.radians(25.0))
    return renderer.render(reef(3, length=0.0), pose, Water(0.15, 40.0), seed=3)


@pytest.fixture(scope="module")
def pipeline() -> Pipeline:
    return Pipeline(CAMERA.rig, PipelineConfig.from_parameters(
        lighting_parameters(LAMPS, daylight=False)))


def test_a_night_is_assessed_and_restored(night: RenderedFrame, pipeline: Pipeline) -> None:
    result = pipeline.process(night.left, night.right)
    assert result.status is Status.OK
    error = result.water.attenuation - night.attenuation
    assert (np.abs(error) < 3 * result.water.attenuation_stddev).all()
    error = result.water.scene_light - night.lamps[0].power
    assert (np.abs(error) < result.water.scene_light_stddev).all()
    assert result.visibility.depth_status is Status.NO_DEPTH_BY_LAMPS
    seen = np.isfinite(result.disparity) & ~result.images.limited & (night.range_left < 5.0)
    assert seen.mean() > 0.2
    truth = night.radiance_left[seen]
    # The light falls over the picture; restored, places differ by what is there alone.
    raw, restored = (
        np.corrcoef(image[seen][:, 2].astype(float), truth[:, 2])[0, 1]
        for image in (night.left, result.left_enhanced))
    assert 1.0 - restored < 0.3 * (1.0 - raw)
    # Nothing there is brighter than white, and little is shown as if it were.
    assert truth.max() < 1.0
    assert (result.left_enhanced[seen] == 255).any(axis=1).mean() < 0.05


def test_open_water_by_night_keeps_its_light(pipeline: Pipeline) -> None:
    renderer = Renderer(CAMERA, lighting=Lighting(LAMPS, daylight=False, shaded=False))
    level = Pose((0.0, 0.0, 1.2), tilt=np.radians(5.0))
    night = renderer.render(reef(1, length=0.0), level, Water(0.15, 40.0), seed=1)
    result = pipeline.process(night.left, night.right)
    water = ~np.isfinite(night.range_left)
    near = np.isfinite(result.disparity) & (night.range_left < 3.0)
    changed = np.abs(result.left_enhanced.astype(float) - night.left).mean(axis=2)
    assert changed[water].mean() < 1.0
    assert result.images.limited[water].mean() > 0.9
    assert changed[near].mean() > 10.0


def test_water_is_told_from_ranges_that_only_a_coarser_scale_shows(pipeline: Pipeline) -> None:
    renderer = Renderer(CAMERA, lighting=Lighting(LAMPS, daylight=False, shaded=False))
    pose = Pose((0.0, 0.0, 1.5), tilt=np.radians(15.0))
    dark = renderer.render(reef(3, length=0.0), pose, Water(0.3, 40.0), seed=3)
    result = pipeline.process(dark.left, dark.right, enhance=())
    assert result.water.lamps is not None and result.water.lamps.nodes is not None
    nodes = result.water.lamps.nodes
    far = (dark.range_left > 5.0) & (dark.range_left < 8.0)
    matched = np.isfinite(result.stereo.range[far]).mean()
    seen = ((nodes.range > 5.0) & (nodes.range < 8.0)).sum()
    whole = far.mean() * np.prod(nodes.place.max(axis=0) + 1)
    assert matched < 0.75
    assert seen > 0.9 * matched * whole


def test_light_that_is_known_is_held(night: RenderedFrame, pipeline: Pipeline) -> None:
    result = pipeline.process(night.left, night.right, enhance=("left",))
    water_filter = WaterFilter(pipeline.config)
    assert water_filter.lamps is None
    water_filter.update(result.water, 0.0, CAMERA.rig)
    light = water_filter.lamps
    assert light is not None
    # Half of the exposure: by itself the frame would be restored as bright as before.
    dark = [(image // 2).astype(np.uint8) for image in (night.left, night.right)]
    own = pipeline.process(*dark, enhance=("left",)).left_enhanced.mean()
    held = pipeline.process(*dark, enhance=("left",), known_light=light).left_enhanced.mean()
    assert held < 0.7 * own


def test_by_daylights_model_a_night_says_what_to_set(night: RenderedFrame) -> None:
    result = Pipeline(CAMERA.rig).process(night.left, night.right)
    assert result.status is Status.LIT_BY_LAMPS
    np.testing.assert_array_equal(result.left_enhanced, night.left)


def auto() -> PipelineConfig:
    """Lamps on board, which light the scene or not."""
    told = lighting_parameters(LAMPS, daylight=False)
    return PipelineConfig.from_parameters(told | {"lighting.model": "auto"})


def test_where_lamps_are_known_a_frame_tells_whether_they_light_it(
    night: RenderedFrame, pipeline: Pipeline
) -> None:
    either = Pipeline(CAMERA.rig, auto())
    by_night = either.process(night.left, night.right)
    told = pipeline.process(night.left, night.right)
    assert by_night.water.lamps_log_odds > 2.2
    np.testing.assert_array_equal(by_night.water.attenuation, told.water.attenuation)
    np.testing.assert_array_equal(by_night.left_enhanced, told.left_enhanced)
    assert by_night.visibility.depth_status is Status.NO_DEPTH_BY_LAMPS
    pose = Pose((0.0, 0.0, 1.5), tilt=np.radians(25.0))
    day = Renderer(CAMERA).render(reef(3, length=0.0), pose, Water(0.15, 3.0), seed=3)
    by_day, plain = (
        each.process(day.left, day.right) for each in (either, Pipeline(CAMERA.rig)))
    assert by_day.water.lamps_log_odds < -2.2
    np.testing.assert_array_equal(by_day.water.attenuation, plain.water.attenuation)
    np.testing.assert_array_equal(by_day.left_enhanced, plain.left_enhanced)
    assert by_day.visibility.depth == plain.visibility.depth


def test_a_frame_in_doubt_is_for_surveys_alone(night: RenderedFrame) -> None:
    config = auto()
    estimators = Estimators(config, Assessor(config), CAMERA.rig)
    first = replace(WaterEstimate.not_assessable(Status.OK), lamps_log_odds=1.0 - DECLARED)
    found = estimators.estimate(View.of(night.left), night.range_left, 0.0, first)
    assert found.status is Status.LIGHT_UNCERTAIN and found.lamps_log_odds == pytest.approx(1.0)
    assert found.lamps is not None and found.lamps.nodes is not None
    # No image is restored with it.
    assert np.isnan(found.lamps.attenuation).all()


def test_frames_together_tell_what_lights_a_recording(
    night: RenderedFrame, pipeline: Pipeline
) -> None:
    """Frames in doubt are refused, and the filter begins anew where lamps come on."""
    lit = replace(pipeline.process(night.left, night.right, enhance=()).water, lamps_log_odds=5.0)
    doubt = replace(
        WaterEstimate.not_assessable(Status.LIGHT_UNCERTAIN), lamps=lit.lamps, lamps_log_odds=1.0)
    day = WaterEstimate(
        Status.OK, np.array([0.5, 0.3, 0.2]), np.array([0.1, 0.4, 0.6]),
        np.diag([0.02**2, 0.01**2] * 3), 9, 30, (Status.OK,) * 3, lamps_log_odds=-5.0)
    kept = WaterFilter(auto())
    found = [
        kept.update(one, 0.2 * k) for k, one in enumerate([lit, lit, doubt, doubt, *[day] * 24])]
    states = [one for one in found if one is not None]
    by_lamps = [one.visibility.depth_status is Status.NO_DEPTH_BY_LAMPS for one in states]
    assert by_lamps[:4] == [True] * 4 and by_lamps[-1] is False
    assert all(np.isfinite(one.visibility.distance) for one in (*states[:3], states[-1]))
    # Between them it is not certain what lights the recording, and nothing is told.
    between = [one for one in states[4:-1] if not np.isfinite(one.visibility.distance)]
    assert {one.water.status for one in between} == {Status.LIGHT_UNCERTAIN}
    # The water by daylight is no mean of both.
    np.testing.assert_allclose(states[-1].water.attenuation, day.attenuation)


def test_warm_up_compiles_all_that_lamps_need(night: RenderedFrame) -> None:
    config = PipelineConfig.from_parameters(lamp_scene.parameters())
    pipeline = Pipeline(CAMERA.rig, config)
    pipeline.warm_up(night.left.shape[:2])
    before = counts.compiled + counts.loaded
    pipeline.process(night.left, night.right)
    assert counts.compiled + counts.loaded == before


def test_under_lamps_ranges_of_ones_own_tell_attenuation_but_no_depth() -> None:
    shown = lamp_scene.render(0.15)
    config = PipelineConfig.from_parameters(lamp_scene.parameters())
    disparity = lamp_scene.RIG.disparity_from_range(shown.range)
    found = estimate_water(shown.image, disparity, lamp_scene.RIG, config)
    assert found.status is Status.OK
    error = found.water.attenuation - shown.attenuation
    assert (np.abs(error) < 3 * found.water.attenuation_stddev).all()
    assert np.isfinite(found.visibility.distance)
    assert found.visibility.depth_status is Status.NO_DEPTH_BY_LAMPS
    assert not np.isfinite(found.visibility.depth)
