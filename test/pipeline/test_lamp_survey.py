# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A frame from above under lamps: as it is, until frames from other heights tell the light."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import flat_floor

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.water.estimate import LampLight
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame, Renderer
from uw_visibility_lab.simulation.lamps import Lighting, default_rig, lighting_parameters
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera(320, 240, 300.0, 0.12)
LAMPS = default_rig(2)
CONFIG = PipelineConfig.from_parameters(lighting_parameters(LAMPS, daylight=False))


@pytest.fixture(scope="module")
def frame() -> RenderedFrame:
    renderer = Renderer(CAMERA, lighting=Lighting(LAMPS, daylight=False))
    above = Pose((0.0, 0.0, 2.0), tilt=math.pi / 2)
    return renderer.render(flat_floor(seed=3), above, Water(0.1, 30.0))


def light_of(frame: RenderedFrame) -> LampLight:
    zero = np.zeros(3)
    power = np.array(frame.lamps[0].power)
    return LampLight(frame.attenuation, power, zero, zero, zero)


def test_light_of_one_channel_alone_gives_the_image_no_cast(frame: RenderedFrame) -> None:
    known = light_of(frame)
    partly = replace(known, attenuation=np.array([known.attenuation[0], np.nan, np.nan]))
    result = Pipeline(CAMERA.rig, CONFIG).process(frame.left, frame.right, known_light=partly)
    np.testing.assert_array_equal(result.left_enhanced, frame.left)
    np.testing.assert_array_equal(result.right_enhanced, frame.right)


def test_known_light_makes_the_floor_even(frame: RenderedFrame) -> None:
    result = Pipeline(CAMERA.rig, CONFIG).process(
        frame.left, frame.right, known_light=light_of(frame))
    reflectance = frame.radiance_left
    bright = reflectance.min(axis=2) > 0.3
    before, after = (
        image[bright] / 255.0 / reflectance[bright]
        for image in (frame.left, result.left_enhanced)
    )
    assert (after.std(axis=0) / after.mean(axis=0)).max() < 0.15
    # Red is as bright as blue again.
    assert before[:, 0].mean() < 0.7 * before[:, 2].mean()
    assert after[:, 0].mean() == pytest.approx(after[:, 2].mean(), rel=0.1)
