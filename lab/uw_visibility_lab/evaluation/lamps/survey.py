# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Survey of the floor under lamps: water after many frames, and the colour of the same ground.

The camera looks down and goes to and fro over the same ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import check_range
from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.transfer import to_linear
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.water.series.filter import WaterFilter
from uw_visibility_lab.evaluation.lamps.cases import DEPTH, clear_water
from uw_visibility_lab.evaluation.lamps.ground import GroundCells, ground_cells
from uw_visibility_lab.evaluation.metrics import colour_difference
from uw_visibility_lab.evaluation.parallel import Progress, run_all
from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.evaluation.tables import flat
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame, Renderer
from uw_visibility_lab.simulation.lamp_light import lamp_array, light_surfaces, scatter
from uw_visibility_lab.simulation.lamps import Lighting, default_rig, lighting_parameters
from uw_visibility_lab.simulation.scene import Scene, reef
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera(320, 240, 300.0, 0.12)
ALTITUDES = (1.5, 3.0)
LENGTH = 3.0
"""Length of the lines that the vehicle goes to and fro, m."""

LINES = 4
PERIOD = 17.0
"""Frames in which it rises and sinks once: not a part of a line, so that ground is seen from
several altitudes at the same place of the image, and at several places from the same one."""

FEWEST_FRAMES = 5

PICTURES = {
    "raw": "as recorded",
    "online": "ours, by frames before",
    "ours": "ours, by all frames",
    "oracle": "lamps, water, ranges known",
    "truth": "reflectance",
}
"""Pictures of a survey, by the names in tables; the last one is the truth. The oracle takes
every surface for facing the lamps, as the light model has it."""

LEARNING = 0.3
"""Part of the frames in which the light of those before is not known well yet."""

NEAREST = 0.7
"""Range in m that disparities are searched to."""


@dataclass(frozen=True)
class SurveyPlan:
    """Plan of a survey."""

    frames: int = 100  # number of frames
    lamps: int = 2  # number of lamps, see `default_rig`
    mean_attenuation: float = 0.15  # attenuation by grey particles, 1/m
    surfaces: str = "lambertian"  # see `LampCase`
    seed: int = 0  # seed of ground and noise
    # what the pipeline is told beside the lamps
    config: PipelineConfig = field(default_factory=PipelineConfig)

    def __post_init__(self) -> None:
        """Refuse a survey of too few frames."""
        check_range("number of frames of the survey", self.frames, FEWEST_FRAMES, 10_000)

    @property
    def lighting(self) -> Lighting:
        """What lights the ground."""
        return Lighting(
            default_rig(self.lamps), daylight=False, shaded=self.surfaces == "lambertian")

    def pose(self, index: int) -> Pose:
        """Return the camera's pose in a frame: to and fro along lines 0.4 m apart."""
        progress = LINES * index / self.frames
        line = int(progress)
        along, forth = progress - line, line % 2 == 0
        low, high = ALTITUDES
        rise = 0.5 - 0.5 * math.cos(2.0 * math.pi * index / PERIOD)
        return Pose(
            (
                LENGTH * (along if forth else 1.0 - along),
                0.2 if line % LINES in (1, 2) else -0.2,
                low + (high - low) * rise,
            ),
            heading=(0.0 if forth else math.pi) + 0.1 * math.sin(0.7 * index),
            tilt=math.pi / 2 + 0.06 * math.sin(0.9 * index),
            roll=0.05 * math.sin(0.5 * index + 0.5),
        )


@dataclass(frozen=True)
class SurveyFrame:
    """A frame of a survey, and the ground that it shows."""

    frame: RenderedFrame  # the pair and its truth
    cells: NDArray[np.int64]  # (H, W); see `ground_cells`


def render_survey_frame(index: int, plan: SurveyPlan) -> SurveyFrame:
    """Render one frame of a survey; all have one exposure."""
    scene, renderer, exposure = _prepared(plan.seed, plan.mean_attenuation, plan.lighting)
    pose = plan.pose(index)
    frame = renderer.render(
        scene, pose, Water(plan.mean_attenuation, DEPTH, exposure),
        seed=plan.seed * 1_000_003 + index,
    )
    return SurveyFrame(frame, ground_cells(frame.range_left, CAMERA, pose, LENGTH))


@lru_cache(maxsize=2)
def _prepared(
    seed: int, mean_attenuation: float, lighting: Lighting
) -> tuple[Scene, Renderer, float]:
    """Return ground, renderer, and the exposure that suits the lowest frame."""
    scene = reef(seed, length=LENGTH, view=12.0)
    renderer = Renderer(CAMERA, workers=Workers(1), lighting=lighting)
    water = Water(mean_attenuation, DEPTH)
    exposure = min(
        renderer.exposure_for(scene, Pose((x, 0.0, ALTITUDES[0]), tilt=math.pi / 2), water)
        for x in np.linspace(0.0, LENGTH, 5).tolist()
    )
    return scene, renderer, exposure


@dataclass(frozen=True)
class SurveyRow:
    """What a frame of a survey says of the water, and what all up to it say."""

    truth: Truth  # the water
    single: Reading  # single, pooled: the frame alone, and the filter over the frames up to it
    pooled: Reading

    def row(self, index: int) -> dict[str, Any]:
        """Return the frame as a row of a table."""
        return flat({
            "frame": index, "true": self.truth, "single": self.single, "pooled": self.pooled})


@dataclass(frozen=True)
class SurveyResult:
    """Results of a survey."""

    rows: list[SurveyRow]  # by frame
    # standard deviation over mean of the same ground over the frames, RGB, by the names of
    # `PICTURES`; the truth's is what changes of resolution leave of it
    variation: dict[str, Array]
    # (3,); variation by the light of the frames before, without the first part of them, in which
    # the light is not known yet
    settled: Array
    # mean ΔE*ab against the reflectance, at each method's best exposure
    difference: dict[str, float]
    # cells, views: pieces of ground that count, and median number of frames that see one
    cells: int
    views: int
    # some frames by the names of `PICTURES`, at each method's best exposure
    shown: list[dict[str, Map]]


def run_survey(
    plan: SurveyPlan, jobs: int = 1, progress: Progress = lambda items, _: items
) -> SurveyResult:
    """Render a survey, process it frame by frame, and compare the ground's colours."""
    frames = run_all(render_survey_frame, range(plan.frames), (plan,), jobs, progress)
    rows, ours = _process(plan, frames, progress)
    images = {
        **ours, "oracle": _oracle(plan, frames),
        "raw": [to_linear(frame.frame.left, "linear") for frame in frames],
        "truth": [frame.frame.radiance_left for frame in frames]}
    truth = images["truth"]
    scaled = {name: at_best_exposure(some, truth) for name, some in images.items()}
    ground = GroundCells.of(truth, [frame.cells for frame in frames])
    first = round(LEARNING * len(frames))
    later = GroundCells.of(truth[first:], [frame.cells for frame in frames[first:]])
    shown = sorted({(k * len(frames)) // 3 for k in range(3)})
    return SurveyResult(
        rows,
        {name: ground.variation(images[name]) for name in PICTURES},
        later.variation(images["online"][first:]),
        {name: mean_difference(scaled[name], truth) for name in PICTURES},
        ground.count,
        ground.views,
        [{name: scaled[name][k] for name in PICTURES} for k in shown],
    )


def _process(
    plan: SurveyPlan, frames: Sequence[SurveyFrame], progress: Progress
) -> tuple[list[SurveyRow], dict[str, list[Map]]]:
    """Let the pipeline and the filter see the frames in turn, then restore them once more."""
    config = PipelineConfig.from_parameters({
        **plan.config.to_parameters(),
        **lighting_parameters(plan.lighting.lamps, daylight=False),
        "stereo.max_disparity": int(CAMERA.focal_length * CAMERA.baseline / NEAREST),
    })
    truth = Truth.of_water(
        frames[0].frame.attenuation, np.zeros(3), clear_water(config), DEPTH,
        config.assessment.contrast,
    )
    pipeline, water_filter = Pipeline(CAMERA.rig, config), WaterFilter(config)
    rows: list[SurveyRow] = []
    restored: dict[str, list[Map]] = {"online": [], "ours": []}

    def see(frame: RenderedFrame, name: str) -> FrameResult:
        result = pipeline.process(
            frame.left, frame.right, enhance=("left",), known_light=water_filter.lamps)
        restored[name].append(to_linear(result.left_enhanced, config.camera.transfer))
        return result

    for index, survey_frame in progress(iter(enumerate(frames)), len(frames)):
        result = see(survey_frame.frame, "online")
        single = Reading.of_result(result)
        filtered = water_filter.update(result.water, float(index))
        pooled = single if filtered is None else Reading.of_result(filtered)
        rows.append(SurveyRow(truth, single, pooled))
    # As for a mosaic: with the light of all frames.
    for _, survey_frame in progress(iter(enumerate(frames)), len(frames)):
        see(survey_frame.frame, "ours")
    return rows, restored


def _oracle(plan: SurveyPlan, frames: Sequence[SurveyFrame]) -> list[Map]:
    """Invert the light model by the renderer's own integrals: what no estimate can beat."""
    rays = CAMERA.rig.ray_directions((CAMERA.height, CAMERA.width))
    lighting, workers = plan.lighting, Workers(1)
    restored = []
    for survey_frame in frames:
        frame = survey_frame.frame
        lamps, beta = lamp_array(frame.lamps, 0.0), frame.attenuation
        white = np.ones_like(frame.radiance_left)
        light = light_surfaces(rays, frame.range_left, white, None, lamps, beta, workers)
        veil = scatter(
            rays, frame.range_left, lamps, beta, beta * lighting.scattering_albedo,
            lighting.phase_function, workers,
        )
        seen = to_linear(frame.left, "linear")
        restored.append(np.maximum((seen - veil) / np.maximum(light, np.float32(1e-6)), 0.0))
    return restored


def at_best_exposure(images: Sequence[Map], truth: Sequence[Map]) -> list[Map]:
    """Multiply images by the one gain with which they come nearest to the truth."""
    product = sum(float(np.nansum(i * t)) for i, t in zip(images, truth, strict=True))
    square = sum(float(np.nansum(np.square(i))) for i in images)
    gain = np.float32(product / square if square > 0.0 else 1.0)
    return [gain * image for image in images]


def mean_difference(images: Sequence[Map], truth: Sequence[Map]) -> float:
    """Mean ΔE*ab over all frames, of linear images."""
    return float(np.mean([
        np.nanmean(colour_difference(np.clip(image, 0.0, 1.0), true))
        for image, true in zip(images, truth, strict=True)
    ]))
