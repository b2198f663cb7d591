# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Survey of the floor under lamps: water after many frames, and the colour of the same ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.evaluation.lamps.cases import DEPTH, clear_water
from uw_visibility.evaluation.lamps.ground import GroundCells
from uw_visibility.evaluation.lamps.survey_frames import (
    CAMERA,
    SurveyFrame,
    SurveyPlan,
    render_survey_frame,
)
from uw_visibility.evaluation.metrics import colour_difference
from uw_visibility.evaluation.parallel import Progress, run_all
from uw_visibility.evaluation.readings import Reading, Truth, flat
from uw_visibility.evaluation.survey_statistics import SurveyStatistics
from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.transfer import to_linear
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.simulation.frame import RenderedFrame
from uw_visibility.simulation.lamp_light import lamp_array, light_surfaces, scatter
from uw_visibility.simulation.lamps import lighting_parameters
from uw_visibility.water.filter import WaterFilter

PICTURES = {
    "raw": "as recorded",
    "statistics": "statistics of the survey",
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
class SurveyRow:
    """What a frame of a survey says of the water, and what all up to it say.

    Attributes
    ----------
    truth : Truth
        The water.
    single, pooled : Reading
        The frame alone, and the filter over the frames up to it.
    """

    truth: Truth
    single: Reading
    pooled: Reading

    def row(self, index: int) -> dict[str, Any]:
        """Return the frame as a row of a table."""
        return flat({
            "frame": index, "true": self.truth, "single": self.single, "pooled": self.pooled})


@dataclass(frozen=True)
class SurveyResult:
    """Results of a survey.

    Attributes
    ----------
    rows : list of SurveyRow
        By frame.
    variation : dict of str to ndarray
        Standard deviation over mean of the same ground over the frames, RGB, by the
        names of `PICTURES`; the truth's is what changes of resolution leave of it.
    settled : ndarray, shape (3,), float64
        Variation by the light of the frames before, without the first part of them, in which
        the light is not known yet.
    difference : dict of str to float
        Mean ΔE*ab against the reflectance, at each method's best exposure.
    cells, views : int
        Pieces of ground that count, and median number of frames that see one.
    shown : list of dict of str to ndarray
        Some frames by the names of `PICTURES`, at each method's best exposure.
    """

    rows: list[SurveyRow]
    variation: dict[str, Array]
    settled: Array
    difference: dict[str, float]
    cells: int
    views: int
    shown: list[dict[str, Map]]


def run_survey(
    plan: SurveyPlan, jobs: int = 1, progress: Progress = lambda items, _: items
) -> SurveyResult:
    """Render a survey, process it frame by frame, and compare the ground's colours.

    Parameters
    ----------
    plan : SurveyPlan
        What to render.
    jobs : int
        Processes that render; the result is the same for any number.
    progress : callable
        Takes an iterator over what is done and its length, and yields from it.
    """
    frames = run_all(render_survey_frame, range(plan.frames), (plan,), jobs, progress)
    rows, ours = _process(plan, frames, progress)
    images = {**ours, "oracle": _oracle(plan, frames), **_peers(frames)}
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
    # As for a mosaic: with the light of all frames, as the statistical method has it too.
    for _, survey_frame in progress(iter(enumerate(frames)), len(frames)):
        see(survey_frame.frame, "ours")
    return rows, restored


def _peers(frames: Sequence[SurveyFrame]) -> dict[str, list[Map]]:
    """Return the frames as recorded, corrected by statistics with true ranges, and the truth."""
    raw = [to_linear(frame.frame.left, "linear") for frame in frames]
    ranges = [frame.frame.range_left for frame in frames]
    statistics = SurveyStatistics.fit(raw, ranges)
    return {
        "raw": raw,
        "statistics": [statistics.correct(*pair) for pair in zip(raw, ranges, strict=True)],
        "truth": [frame.frame.radiance_left for frame in frames],
    }


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
