# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Survey of the floor under lamps: water after many frames, and the colour of the same ground.

The camera looks down and goes to and fro over the same ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.transfer import to_linear
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.water.series.filter import WaterFilter
from uw_visibility_lab.evaluation.lamps.cases import DEPTH, clear_water
from uw_visibility_lab.evaluation.metrics import colour_difference
from uw_visibility_lab.evaluation.parallel import Progress, run_all
from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.frame import RenderedFrame, Renderer
from uw_visibility_lab.simulation.lamp_light import direct_light, scatter
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

CELL = 0.1
"""Width of a piece of ground, m."""

HALF_WIDTH = 0.6
"""Ground counts so far to either side of the way, m: beyond stand corals."""

WHOLE = 0.8
"""Share of a piece's pixels that a frame must show, of those that a level one has."""

FEWEST_VIEWS = 8
"""Frames that must show a piece."""

STEADY = 0.03
"""Largest variation of the true reflectance: what varies more is hidden in some frames."""

DARK = 0.05
"""Reflectance below which a piece's relative variation says little."""


def ground_cells(
    ranges: Map, camera: StereoCamera, pose: Pose, length: float
) -> NDArray[np.int64]:
    """Number of the piece of ground that each pixel sees; −1 for what does not count.

    Ground counts up to a length along x, m, and pieces that the frame shows whole.
    """
    rays = camera.rig.ray_directions((camera.height, camera.width))
    distance = np.where(np.isfinite(ranges), ranges, 0.0)[..., np.newaxis]
    points = distance * (rays @ pose.rotation().T) + pose.position
    column, row = (np.floor(points[..., k] / CELL).astype(np.int64) for k in (0, 1))
    columns, rows = round(length / CELL), round(HALF_WIDTH / CELL)
    inside = np.isfinite(ranges) & (column >= 0) & (column < columns)
    inside &= (row >= -rows) & (row < rows)
    cells = np.where(inside, (row + rows) * columns + column, -1)
    count = np.bincount(cells[inside], minlength=2 * rows * columns)
    depth = distance[..., 0] * rays[..., 2]
    total = np.bincount(cells[inside], depth[inside], minlength=len(count))
    level = (CELL * camera.focal_length * count / np.maximum(total, 1e-9)) ** 2
    part = count < WHOLE * level
    cells[inside & part[cells]] = -1
    return np.asarray(cells)


@dataclass(frozen=True)
class GroundCells:
    """Pieces of ground that several frames show whole."""

    cells: Sequence[NDArray[np.int64]]  # (H, W); by frame, see `ground_cells`
    steady: NDArray[np.bool_]  # (n, 3); pieces that count, by channel
    views: int  # median number of frames that see one

    @classmethod
    def of(cls, truth: Sequence[Map], cells: Sequence[NDArray[np.int64]]) -> GroundCells:
        """Choose the pieces of ground that look alike in the frames' true reflectance."""
        size = max(int(c.max()) for c in cells) + 1
        everything = cls(cells, np.ones((max(size, 1), 3), np.bool_), 0)
        means = everything.means(truth)
        views = np.isfinite(means[..., 1]).sum(axis=0)
        mean, deviation = _moments(means)
        steady = (views >= FEWEST_VIEWS)[:, np.newaxis] & (mean > DARK)
        steady &= deviation <= STEADY * mean
        seen = views[steady.any(axis=1)]
        return cls(cells, steady, int(np.median(seen)) if len(seen) else 0)

    @property
    def count(self) -> int:
        """Number of pieces that count."""
        return int(self.steady.any(axis=1).sum())

    def means(self, images: Sequence[Map]) -> Array:
        """Mean of each piece in each frame, (frames, n, 3); NaN where it is not seen."""
        size = len(self.steady)
        means = np.full((len(images), size, 3), np.nan)
        for k, (image, cells) in enumerate(zip(images, self.cells, strict=True)):
            known = (cells >= 0) & np.isfinite(image).all(axis=2)
            count = np.bincount(cells[known], minlength=size)
            seen = count > 0
            for c in range(3):
                total = np.bincount(cells[known], image[known][:, c], minlength=size)
                means[k, seen, c] = total[seen] / count[seen]
        return means

    def variation(self, images: Sequence[Map]) -> Array:
        """Standard deviation over mean of the same ground over the frames, RGB."""
        mean, deviation = _moments(self.means(images))
        relative = deviation / np.maximum(mean, 1e-9)
        return np.array([
            relative[self.steady[:, c], c].mean() if self.steady[:, c].any() else np.nan
            for c in range(3)
        ])


def _moments(means: Array) -> tuple[Array, Array]:
    """Mean and standard deviation over the frames that see a piece; 0 for none."""
    seen = np.ma.masked_invalid(means)
    return seen.mean(axis=0).filled(0.0), seen.std(axis=0).filled(0.0)


LAMPS = 2
MEAN_ATTENUATION = 0.15
"""Attenuation by grey particles, 1/m."""

LIGHTING = Lighting(default_rig(LAMPS), daylight=False)


def pose_of(index: int, frames: int) -> Pose:
    """Return the camera's pose in a frame of so many: to and fro along lines 0.4 m apart."""
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
    """Render one frame of a survey of so many; all have one exposure."""
    scene, renderer, exposure = _prepared(CAMERA)
    return renderer.render(
        scene, pose_of(index, frames), Water(MEAN_ATTENUATION, DEPTH, exposure), seed=index)


@lru_cache(maxsize=1)
def _prepared(camera: StereoCamera) -> tuple[Scene, Renderer, float]:
    """Return ground, renderer, and the exposure that suits the lowest frame."""
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
    number: int, config: PipelineConfig, jobs: int = 1,
    progress: Progress = lambda items, _: items,
) -> SurveyResult:
    """Render a survey of so many frames, process them in turn, and compare the ground's colours.

    config: what the pipeline is told beside the lamps.
    """
    frames = run_all(render_survey_frame, range(number), (number,), jobs, progress)
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
    cells = [
        ground_cells(frame.range_left, CAMERA, pose_of(k, number), LENGTH)
        for k, frame in enumerate(frames)]
    ground, first = GroundCells.of(truth, cells), round(LEARNING * number)
    later = GroundCells.of(truth[first:], cells[first:])
    return SurveyResult(
        Truth.of_water(
            frames[0].attenuation, np.zeros(3), clear_water(config), DEPTH,
            config.assessment.contrast),
        single,
        pooled,
        {name: ground.variation(images[name]) for name in PICTURES},
        later.variation(images["online"][first:]),
        {name: mean_difference(scaled[name], truth) for name in PICTURES},
        ground.count,
        ground.views,
        [{name: scaled[name][k] for name in PICTURES}
         for k in sorted({(k * number) // 3 for k in range(3)})],
    )


def _process(
    config: PipelineConfig, frames: Sequence[RenderedFrame], progress: Progress
) -> tuple[list[Reading], list[Reading], dict[str, list[Map]]]:
    """Let the pipeline and the filter see the frames in turn, then restore them once more."""
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
        single.append(Reading.of_result(result))
        filtered = water_filter.update(result.water, float(index))
        pooled.append(single[-1] if filtered is None else Reading.of_result(filtered))
    # As for a mosaic: with the light of all frames.
    for _, frame in progress(iter(enumerate(frames)), len(frames)):
        see(frame, "ours")
    return single, pooled, restored


def _oracle(frame: RenderedFrame) -> Map:
    """Invert the light model by the renderer's own integrals: what no estimate can beat."""
    rays = CAMERA.rig.ray_directions((CAMERA.height, CAMERA.width))
    beta = frame.attenuation
    light = direct_light(rays, frame.range_left, None, frame.lamps, beta)
    veil = scatter(
        rays, frame.range_left, frame.lamps, beta, beta * LIGHTING.scattering_albedo,
        LIGHTING.phase_function, Workers(1),
    )
    seen = to_linear(frame.left, "linear")
    return np.maximum((seen - veil) / np.maximum(light, np.float32(1e-6)), 0.0)


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
