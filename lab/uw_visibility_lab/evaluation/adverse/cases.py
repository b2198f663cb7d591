# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Cases of the adverse study: a scene, an effect, and each method's estimate of the water."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import check_range
from uw_visibility.images.arrays import Array, Image8
from uw_visibility_lab.evaluation.adverse.effects import Level, chosen
from uw_visibility_lab.evaluation.adverse.scenes import AdverseScene, load_adverse_scene
from uw_visibility_lab.evaluation.fits import fit_backscatter
from uw_visibility_lab.evaluation.readings import Truth, read_exact, reader_of
from uw_visibility_lab.evaluation.scenes import SceneSource
from uw_visibility_lab.evaluation.studies import StudyResult
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.formation import effective_attenuation
from uw_visibility_lab.simulation.frame import Renderer
from uw_visibility_lab.simulation.view import View
from uw_visibility_lab.simulation.water import Water

METHODS = {
    "ours": "ours",
    "paper": "the paper's plain fit",
    "sea_thru": "Sea-thru's backscatter fit",
}
"""Estimates of the water, by their names in tables."""

ATTENUATIONS = (0.1, 0.3)
DEPTHS = (3.0,)

SAND = np.array([0.62, 0.55, 0.45], np.float32)
"""Reflectance that a scene without contrast has."""


@dataclass(frozen=True)
class AdverseCase:
    """A scene, an effect at one level, and the water."""

    source: SceneSource  # the scene
    effect: str  # name of the effect
    level: Level  # the effect
    mean_attenuation: float  # attenuation by grey particles, 1/m
    depth: float  # depth of the camera, m
    seed: int = 0  # seed of noise and marine snow


def adverse_cases(
    scenes: Sequence[SceneSource], effects: Sequence[str], attenuations: Sequence[float],
    depths: Sequence[float], seeds: int,
) -> list[AdverseCase]:
    """Return the cases of a study, scene by scene; without names of effects those of all."""
    check_range("number of seeds", seeds, 1)
    check_range("attenuations", attenuations, 0.0, 5.0, "1/m")
    check_range("depths", depths, 0.0, 100.0, "m")
    return [
        AdverseCase(scene, effect, level, attenuation, depth, seed)
        for scene in scenes
        for effect, levels in chosen(effects).items()
        for level in levels
        for attenuation in level.attenuations or attenuations
        for depth in depths
        for seed in range(seeds)
    ]


def evaluate_adverse_case(case: AdverseCase, config: PipelineConfig) -> StudyResult:
    """Simulate a scene under water with an effect, and estimate the water by each method."""
    scene, level = load_adverse_scene(case.source), case.level
    told = PipelineConfig.from_parameters({**config.to_parameters(), **level.parameters})
    water = Water(case.mean_attenuation, case.depth, None, level.water)
    left, gains = _expose(scene, level, water, case)
    attenuation = effective_attenuation(scene.left.range, scene.geometry, water)
    reader = reader_of(told)
    truth = Truth.of_water(
        attenuation, gains * water.ambient_light(), reader.assessor.clear_water_attenuation,
        case.depth, told.assessment.contrast,
    )
    rig = replace(scene.rig, baseline=scene.rig.baseline * level.range_scale)
    ranges = rig.range_from_disparity(scene.disparity)
    readings = {
        "ours": read_exact(left, scene.disparity, rig, told),
        "paper": reader.fit_plain(left, ranges),
        "sea_thru": reader.read(fit_backscatter(left, ranges, told.camera.transfer)),
    }
    labels = {
        "effect": case.effect, "level": level.label, "scene": scene.name,
        "open_water": scene.open_water, "seed": case.seed,
    }
    return StudyResult(labels, truth, readings)


def _expose(
    scene: AdverseScene, level: Level, water: Water, case: AdverseCase
) -> tuple[Image8, Array]:
    """Return the image under water, and gains of white balance."""
    height, width = scene.disparity.shape
    camera = StereoCamera(width, height, scene.rig.focal_length, scene.rig.baseline)
    renderer = Renderer(camera, level.sensor, level.disturbances, Workers(1), level.camera)
    light = renderer.daylight(
        [_fade(scene.left, level.contrast)], scene.geometry, water, case.seed)
    (image,), gains = renderer.record(light, case.seed)
    return image, gains


def _fade(view: View, contrast: float) -> View:
    """Return the view with the contrast of its surfaces lessened, towards sand's reflectance."""
    if contrast == 1.0:
        return view
    radiance, edge_radiance = (
        SAND + np.float32(contrast) * (part - SAND) for part in (view.radiance, view.edge_radiance)
    )
    return replace(view, radiance=radiance, edge_radiance=edge_radiance)
