# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Survey of the sea floor under lamps: water after many frames, and colours of the same ground.

The camera looks down and moves back and forth over the same ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import Array, Map
from uw_visibility.images.cells import means
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.optics.transfer import to_linear
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.water.series.filter import WaterFilter
from uw_visibility_lab.evaluation.metrics import at_best_exposure, colour_difference
from uw_visibility_lab.evaluation.parallel import Progress, run_all
from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame, Renderer
from uw_visibility_lab.simulation.lamp_light import direct_light, scatter
from uw_visibility_lab.simulation.lamps import Lighting, default_rig, lighting_parameters
from uw_visibility_lab.simulation.phase_functions import phase_table
from uw_visibility_lab.simulation.scene import Scene, reef
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera(320, 240, 300.0, 0.12)
ALTITUDES = (1.5, 3.0)
LENGTH = 3.0
"""Length of the survey's lines, m."""

LINES = 4
PERIOD = 17.0
"""Period of the changes of altitude, in frames. A line is no multiple of it: ground is seen from
several altitudes at one place of the image, and at several places from one altitude."""

FRAMES, FEWEST_FRAMES = 100, 5

PICTURES = {
    "raw": "as recorded",
    "online": "ours, earlier frames",
    "ours": "ours, all frames",
    "oracle": "lamps, water, ranges known",
    "truth": "reflectance",
}
"""Pictures of a survey, by the names in tables; the last one is the truth. The oracle assumes
that every surface faces the lamps."""

NEAREST = 0.7
"""Least range that is searched for matches, m."""

BLOCK = 16
"""Width of a piece of ground in an image, px."""

DARK = 0.05
"""Least reflectance of a piece that is counted: relative variations of darker ones are noise."""

LAMPS = 2
DEPTH = 40.0
"""Depth of the camera, m: so deep that there is no daylight, as in the frames."""

MEAN_ATTENUATION = 0.15
"""Attenuation by grey particles, 1/m."""

LIGHTING = Lighting(default_rig(LAMPS), daylight=False)


def pose_of(index: int, frames: int) -> Pose:
    """Return the camera's pose in a frame of so many: back and forth on lines 0.4 m apart."""
    progress = LINES * index / frames
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


def render_survey_frame(index: int, frames: int) -> RenderedFrame:
    """Render one of so many frames of a survey; all have the same exposure."""
    scene, renderer, exposure = _prepared(CAMERA)
    return renderer.render(
        scene, pose_of(index, frames), Water(MEAN_ATTENUATION, DEPTH, exposure), seed=index)


@lru_cache(maxsize=1)
def _prepared(camera: StereoCamera) -> tuple[Scene, Renderer, float]:
    """Return ground, renderer, and the exposure for the lowest altitude."""
    scene = reef(length=LENGTH, view=12.0)
    renderer = Renderer(camera, workers=Workers(1), lighting=LIGHTING)
    water = Water(MEAN_ATTENUATION, DEPTH)
    exposure = min(
        renderer.exposure_for(scene, Pose((x, 0.0, ALTITUDES[0]), tilt=math.pi / 2), water)
        for x in np.linspace(0.0, LENGTH, 5).tolist()
    )
    return scene, renderer, exposure


@dataclass(frozen=True)
class SurveyResult:
    """Results of a survey."""

    truth: Truth  # the water
    # single, pooled: by frame; of the frame alone, and of the filter over the frames up to it
    single: list[Reading]
    pooled: list[Reading]
    # of the same reflectance, RGB, by the names of `PICTURES`; see `variation`
    variation: dict[str, Array]
    # mean ΔE*ab against the reflectance, at each method's best exposure
    difference: dict[str, float]
    # some frames by the names of `PICTURES`, at each method's best exposure
    shown: list[dict[str, Map]]


def run_survey(
    number: int, config: PipelineConfig, jobs: int = 1,
    progress: Progress = lambda items, _: items,
) -> SurveyResult:
    """Render a survey of so many frames, process them in order, and compare the ground's colours.

    config: parameters of the pipeline; those of the lamps are added.
    """
    frames = run_all(
        partial(render_survey_frame, frames=number), range(number), jobs, progress)
    config = PipelineConfig.from_parameters({
        **config.to_parameters(),
        **lighting_parameters(LIGHTING.lamps, daylight=False),
        "stereo.max_disparity": int(CAMERA.focal_length * CAMERA.baseline / NEAREST),
    })
    single, pooled, ours = _process(config, frames, progress)
    images = {
        **ours, "oracle": [_oracle(frame) for frame in frames],
        "raw": [to_linear(frame.left, "linear") for frame in frames],
        "truth": [frame.radiance_left for frame in frames]}
    truth = images["truth"]
    scaled = {name: at_best_exposure(some, truth) for name, some in images.items()}
    return SurveyResult(
        Truth.of_water(
            frames[0].attenuation, np.zeros(3),
            clear_water_attenuation(load_response(config.camera.response)), DEPTH,
            config.assessment.contrast),
        single,
        pooled,
        {name: variation(images[name], truth) for name in PICTURES},
        {name: mean_difference(scaled[name], truth) for name in PICTURES},
        [{name: scaled[name][k] for name in PICTURES}
         for k in sorted({(k * number) // 3 for k in range(3)})],
    )


def _process(
    config: PipelineConfig, frames: Sequence[RenderedFrame], progress: Progress
) -> tuple[list[Reading], list[Reading], dict[str, list[Map]]]:
    """Process the frames in order with pipeline and filter, then restore them once more."""
    pipeline, water_filter = Pipeline(CAMERA.rig, config), WaterFilter(config)
    single: list[Reading] = []
    pooled: list[Reading] = []
    restored: dict[str, list[Map]] = {"online": [], "ours": []}

    def see(frame: RenderedFrame, name: str) -> FrameResult:
        result = pipeline.process(
            frame.left, frame.right, enhance=("left",), known_light=water_filter.lamps)
        restored[name].append(to_linear(result.left_enhanced, config.camera.transfer))
        return result

    for index, frame in progress(iter(enumerate(frames)), len(frames)):
        result = see(frame, "online")
        single.append(Reading.of(result.water, result.visibility))
        filtered = water_filter.update(result.water, float(index))
        pooled.append(single[-1] if filtered is None else Reading.of(
            filtered.water, filtered.visibility))
    # As for a mosaic: with the light of all frames.
    for _, frame in progress(iter(enumerate(frames)), len(frames)):
        see(frame, "ours")
    return single, pooled, restored


def _oracle(frame: RenderedFrame) -> Map:
    """Invert the light model with true lamps, water and ranges: the bound of what is possible."""
    rays = CAMERA.rig.ray_directions((CAMERA.height, CAMERA.width))
    beta = frame.attenuation
    light = direct_light(rays, frame.range_left, None, frame.lamps, beta)
    veil = scatter(
        rays, frame.range_left, frame.lamps, beta, beta * LIGHTING.scattering_albedo,
        phase_table(LIGHTING.phase_function), Workers(1),
    )
    seen = to_linear(frame.left, "linear")
    return np.maximum((seen - veil) / np.maximum(light, np.float32(1e-6)), 0.0)


def variation(images: Sequence[Map], truth: Sequence[Map]) -> Array:
    """Variation of pictures of the same reflectance, over frames and ground, RGB.

    It is that of the ratio of shown to true reflectance of pieces of ground: half of the difference
    between the 84 and 16 % quantiles, over the median.
    """
    seen, true = (
        np.concatenate([means(image, BLOCK).reshape(-1, 3) for image in some]).astype(np.float64)
        for some in (images, truth))
    low, middle, high = np.nanquantile(
        np.where(true > DARK, seen / np.maximum(true, DARK), np.nan), (0.16, 0.5, 0.84), axis=0)
    return np.asarray((high - low) / (2.0 * middle))


def mean_difference(images: Sequence[Map], truth: Sequence[Map]) -> float:
    """Mean ΔE*ab over all frames, of linear images, without pixels that are not finite."""
    return float(np.mean([
        colour_difference(np.clip(np.nan_to_num(image), 0.0, 1.0), true)[
            np.isfinite(image).all(axis=2)].mean()
        for image, true in zip(images, truth, strict=True)
    ]))
