# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Case of the adverse study: a scene, an effect, and each method's estimate of the water."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.evaluation.adverse.effects import Level
from uw_visibility.evaluation.adverse.scenes import AdverseScene, AdverseSource
from uw_visibility.evaluation.backscatter import fit_backscatter
from uw_visibility.evaluation.readings import Reader, Reading, Truth, flat, match_and_read
from uw_visibility.pipeline.estimate_water import estimate_water
from uw_visibility.simulation.camera import StereoCamera
from uw_visibility.simulation.effects import marine_snow
from uw_visibility.simulation.formation import effective_attenuation, form_image
from uw_visibility.simulation.view import View
from uw_visibility.simulation.water import Water

Image = NDArray[np.uint8]
Map = NDArray[np.float32]

METHODS = {
    "ours": "ours",
    "paper": "the paper's plain fit",
    "sea_thru": "Sea-thru's backscatter fit",
}
"""Estimates of the water, by their names in tables."""

SAND = np.array([0.62, 0.55, 0.45], np.float32)
"""Reflectance that a scene without contrast has."""


@dataclass(frozen=True)
class AdverseCase:
    """A scene, an effect at one level, and the water.

    Attributes
    ----------
    source : AdverseSource
        The scene.
    effect : str
        Name of the effect.
    level : Level
        The effect.
    mean_attenuation : float
        Attenuation by grey particles, 1/m.
    depth : float
        Depth of the camera, m.
    seed : int
        Seed of noise and marine snow.
    matched : bool
        Whether the estimators get matched disparities instead of true ones.
    """

    source: AdverseSource
    effect: str
    level: Level
    mean_attenuation: float
    depth: float
    seed: int = 0
    matched: bool = False


@dataclass(frozen=True)
class AdverseResult:
    """Results of a case.

    Attributes
    ----------
    effect, level, scene : str
        What it was.
    open_water : bool
        Whether open water is in view.
    seed : int
        Of noise and marine snow.
    truth : Truth
        The water; with β effective over the ranges in view.
    readings : dict of str to Reading
        By the names of `METHODS`.
    """

    effect: str
    level: str
    scene: str
    open_water: bool
    seed: int
    truth: Truth
    readings: dict[str, Reading]

    def row(self) -> dict[str, Any]:
        """Return the case as a row of a table."""
        return {
            "effect": self.effect, "level": self.level, "scene": self.scene,
            "open_water": self.open_water, "seed": self.seed,
            **flat({"true": self.truth, **self.readings}),
        }


def evaluate_adverse_case(case: AdverseCase, config: PipelineConfig) -> AdverseResult:
    """Simulate a scene under water with an effect, and estimate the water by each method.

    Parameters
    ----------
    case : AdverseCase
        What to simulate.
    config : PipelineConfig
        What the estimators are told, but for what the level tells them.

    Raises
    ------
    InputError
        If the scene cannot be loaded.
    """
    scene, level = case.source.load(), case.level
    told = PipelineConfig.from_parameters({**config.to_parameters(), **level.parameters})
    water = Water(case.mean_attenuation, case.depth, None, level.water)
    left, right, gains = _expose(scene, level, water, case)
    attenuation = effective_attenuation(scene.left.range, scene.geometry, water)
    reader = _reader(told)
    truth = Truth.of_water(
        attenuation, gains * water.ambient_light(), reader.assessor.clear_water_attenuation,
        case.depth, told.assessment.contrast,
    )
    rig = replace(scene.rig, baseline=scene.rig.baseline * level.range_scale)
    disparity: Map | None = scene.disparity
    if case.matched and right is not None:
        ours, disparity = match_and_read(left, right, rig, scene.disparity, told)
    else:
        ours = Reading.of_result(
            estimate_water(left, scene.disparity, rig, told, disparity_stddev=0.0))
    readings = dict.fromkeys(METHODS, ours)
    if disparity is not None:
        # The peers take the disparities that ours has.
        ranges = rig.range_from_disparity(disparity)
        readings["paper"] = reader.estimate(left, ranges, "paper")
        readings["sea_thru"] = reader.read(fit_backscatter(left, ranges, told.camera.transfer))
    return AdverseResult(
        case.effect, level.label, scene.name, scene.open_water, case.seed, truth, readings,
    )


def _expose(
    scene: AdverseScene, level: Level, water: Water, case: AdverseCase
) -> tuple[Image, Image | None, NDArray[np.float64]]:
    """Return the pair (the right image where it is wanted) and the gains of white balance."""
    views = [scene.left, scene.right] if case.matched else [scene.left]
    height, width = scene.disparity.shape
    camera = StereoCamera(width, height, scene.rig.focal_length, scene.rig.baseline)
    snow = marine_snow(
        camera, level.disturbances.marine_snow, np.random.default_rng([case.seed, 2]))
    particles = level.disturbances.snow_brightness * water.ambient_light()
    light = []
    for view, cover in zip(views, snow, strict=False):
        irradiance = form_image(_fade(view, level.contrast), scene.geometry, water)
        irradiance += cover[..., np.newaxis] * (particles.astype(np.float32) - irradiance)
        light.append(irradiance)
    gains = level.camera.gains(light[0])
    images = [
        level.camera.record(
            irradiance, level.sensor, np.random.default_rng([case.seed, side]), gains,
            right=side == 1,
        )
        for side, irradiance in enumerate(light)
    ]
    return images[0], images[1] if case.matched else None, gains


def _fade(view: View, contrast: float) -> View:
    """Return the view with the contrast of its surfaces lessened, towards sand's reflectance."""
    if contrast == 1.0:
        return view
    radiance, edge_radiance = (
        SAND + np.float32(contrast) * (part - SAND) for part in (view.radiance, view.edge_radiance)
    )
    return replace(view, radiance=radiance, edge_radiance=edge_radiance)


@lru_cache(maxsize=8)
def _reader(config: PipelineConfig) -> Reader:
    return Reader(config)
