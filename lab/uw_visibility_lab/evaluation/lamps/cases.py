# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Case of the study under lamps: a reef by night, and what the pipeline is told of its lamps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.evaluation.studies import StudyResult
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame, Renderer
from uw_visibility_lab.simulation.lamps import (
    Lighting,
    default_rig,
    lighting_parameters,
    misplaced,
)
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera(480, 360, 450.0, 0.12)
DEPTH = 40.0
"""Depth of the camera, m: no daylight is left there, so that none is missing in the frames."""

SHIFT, TURN = 0.05, 5.0
"""How far misplaced lamps are off: m, degrees."""

TOLD = {
    "known": "lamps as they are",
    "misplaced": f"lamps off by {100 * SHIFT:.0f} cm and {TURN:.0f}°",
    "daylight": "told of daylight",
}
"""What the pipeline is told of the lamps, by the names in tables."""

SURFACES = ("lambertian", "facing")


@dataclass(frozen=True)
class LampCase:
    """A reef by night."""

    seed: int  # seed of reef, pose, noise and misplacement
    lamps: int  # number of lamps, see `default_rig`
    mean_attenuation: float  # attenuation by grey particles, 1/m
    # ``lambertian``, or ``facing``: each surface faces each lamp, as in the light model
    surfaces: str = "lambertian"


def pose_of(seed: int) -> Pose:
    """Draw a view ahead over a reef, tilted down by 8 to 30 degrees."""
    random = np.random.default_rng([seed, 5])
    return Pose(
        (random.uniform(0.0, 1.0), 0.0, random.uniform(1.2, 1.9)),
        heading=random.uniform(-0.3, 0.3),
        tilt=np.radians(random.uniform(8.0, 30.0)),
        roll=np.radians(random.uniform(-3.0, 3.0)),
    )


def render_reef(
    seed: int, lighting: Lighting, mean_attenuation: float, workers: Workers
) -> RenderedFrame:
    """Render a reef by night, as `CAMERA` sees it from a pose of the seed."""
    return Renderer(CAMERA, workers=workers, lighting=lighting).render(
        reef(seed, length=1.0), pose_of(seed), Water(mean_attenuation, DEPTH), seed=seed)


def evaluate_lamp_case(case: LampCase, config: PipelineConfig) -> StudyResult:
    """Render a frame under lamps, and estimate the water by what is told of them."""
    lamps = default_rig(case.lamps)
    lighting = Lighting(lamps, daylight=False, shaded=case.surfaces == "lambertian")
    frame = render_reef(case.seed, lighting, case.mean_attenuation, Workers(config.threads))
    told = {
        "known": lighting_parameters(lamps, daylight=False),
        "misplaced": lighting_parameters(
            misplaced(lamps, SHIFT, TURN, case.seed), daylight=False),
        "daylight": {"lighting.model": "daylight"},
    }
    truth = Truth.of_water(
        frame.attenuation, frame.ambient_light, clear_water(config), DEPTH,
        config.assessment.contrast,
    )
    readings = {
        name: _process(
            frame, PipelineConfig.from_parameters({**config.to_parameters(), **parameters}))
        for name, parameters in told.items()
    }
    return StudyResult(dict(vars(case)), truth, readings)


def _process(frame: RenderedFrame, config: PipelineConfig) -> Reading:
    """Match and estimate, as far as the true disparities go."""
    largest = int(np.nanmax(frame.disparity_left)) + 8
    config = replace(config, stereo=replace(config.stereo, max_disparity=largest))
    try:
        return Reading.of_result(Pipeline(CAMERA.rig, config).process(frame.left, frame.right))
    except InputError as error:
        return Reading.refused(f"pair refused: {error}")


def clear_water(config: PipelineConfig) -> Array:
    """Clear water's attenuation as the told camera sees it, 1/m, RGB."""
    return clear_water_attenuation(load_response(config.camera.response))
