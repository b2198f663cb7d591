# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rendered transect, assessed frame by frame against the truth (Fig. 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.evaluation.readings import Reading, Truth, flat
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.simulation.camera import StereoCamera
from uw_visibility.simulation.frame import Effects, RenderedFrame
from uw_visibility.simulation.transect import Transect
from uw_visibility.simulation.water import RESPONSE
from uw_visibility.water.assessment import Assessor
from uw_visibility.water.estimation import WaterEstimator
from uw_visibility.water.filter import WaterFilter


@dataclass(frozen=True)
class TransectPlan:
    """Plan of a rendered transect; small, so that processes can exchange it.

    Attributes
    ----------
    frames : int
        Number of stereo frames, 2 a second.
    width, height : int
        Size of an image, px.
    marine_snow, caustics : float
        What disturbs the light model; see `Effects`.
    seed : int
        Seed of reef, noise and particles.
    """

    frames: int
    width: int = 640
    height: int = 480
    marine_snow: float = 0.0
    caustics: float = 0.0
    seed: int = 0

    def transect(self, threads: int = 1) -> Transect:
        """Return the transect: from 2 to 6 m of depth, α from 0.05 to 0.3 1/m.

        Raises
        ------
        InputError
            If a number is out of its range.
        """
        return Transect(
            frames=self.frames,
            seed=self.seed,
            camera=StereoCamera(self.width, self.height, self.width * 15 / 16),
            effects=Effects(self.marine_snow, self.caustics),
            workers=Workers(threads),
        )


@dataclass(frozen=True)
class TransectRow:
    """One frame of a transect.

    Attributes
    ----------
    time : float
        s from the first frame.
    truth : Truth
        The water.
    reading : Reading
        What the pipeline says of this frame.
    tracked : Reading
        The same filtered over the frames so far.
    exact : Reading
        What the same estimate says with exact ranges: what is left are noise,
        particles and caustics.
    """

    time: float
    truth: Truth
    reading: Reading
    tracked: Reading
    exact: Reading

    def row(self) -> dict[str, Any]:
        """Return the frame as a row of a table."""
        return {
            "time": self.time, **flat({
                "true": self.truth, "pipeline": self.reading, "tracked": self.tracked,
                "exact": self.exact,
            }),
        }


def evaluate_transect(plan: TransectPlan, config: PipelineConfig) -> list[TransectRow]:
    """Render a transect and assess its frames, each alone and filtered over time.

    Parameters
    ----------
    plan : TransectPlan
        Rendered with the sensor's noise, and the snow and caustics it asks for.
    config : PipelineConfig
        Parameters of the pipeline.

    Returns
    -------
    list of TransectRow
        One a frame; a frame that the pipeline refuses says so.
    """
    transect = plan.transect(config.threads)
    camera = transect.camera
    rig = camera.rig
    pipeline = Pipeline(rig, config)
    kappa = clear_water_attenuation(load_response(RESPONSE))
    water_filter = WaterFilter(config)
    assessor = Assessor.from_config(config)
    estimator = WaterEstimator(
        config.water, assessor.clear_water_attenuation, config.camera.transfer,
        assessor.daylight)
    rows = []
    for time, frame in transect.render():
        truth = Truth.of_water(
            frame.attenuation, frame.ambient_light, kappa, frame.depth, config.assessment.contrast
        )
        known = np.isfinite(frame.range_left)
        exact = estimator.estimate(
            frame.left, np.where(known, frame.range_left, np.float32(np.nan)), range_error=0.0)
        rows.append(TransectRow(
            time, truth, *_read(pipeline, water_filter, frame, time),
            Reading.of(exact, assessor.assess(exact))))
    return rows


def _read(
    pipeline: Pipeline, water_filter: WaterFilter, frame: RenderedFrame, time: float
) -> tuple[Reading, Reading]:
    """Read a frame alone, and the state filtered up to it."""
    try:
        result = pipeline.process(frame.left, frame.right, enhance=())
    except InputError as error:
        refused = Reading.refused(f"pair refused: {error}")
        return refused, refused
    alone = Reading.of_result(result)
    filtered = water_filter.update(result.water, time)
    if filtered is None:
        return alone, Reading.refused("tracking is off")
    return alone, Reading.of_result(filtered)


def frame_to_frame(truths: Sequence[Truth], readings: Sequence[Reading]) -> float:
    """Root mean square of how the error of α changes from frame to frame, 1/m.

    Frames without an estimate are left out, with both of their neighbours' steps.
    """
    errors = np.array([
        reading.mean_attenuation - truth.mean_attenuation
        for truth, reading in zip(truths, readings, strict=True)])
    steps = np.diff(errors)
    steps = steps[np.isfinite(steps)]
    return float(np.sqrt(np.mean(steps**2))) if steps.size else float("nan")
