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
from uw_visibility.evaluation.readings import Reader, Reading, Truth, flat
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.simulation.frame import RenderedFrame
from uw_visibility.simulation.transect import Transect
from uw_visibility.simulation.water import RESPONSE
from uw_visibility.water.filter import WaterFilter


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
        return flat({
            "time": self.time, "true": self.truth, "pipeline": self.reading,
            "tracked": self.tracked, "exact": self.exact,
        })


def evaluate_transect(transect: Transect, config: PipelineConfig) -> list[TransectRow]:
    """Render a transect and assess its frames, each alone and filtered over time.

    Parameters
    ----------
    transect : Transect
        Rendered with the sensor's noise, and the snow and caustics it asks for.
    config : PipelineConfig
        Parameters of the pipeline.

    Returns
    -------
    list of TransectRow
        One a frame; a frame that the pipeline refuses says so.
    """
    pipeline = Pipeline(transect.camera.rig, config)
    kappa = clear_water_attenuation(load_response(RESPONSE))
    water_filter = WaterFilter(config)
    reader = Reader(config)
    rows = []
    for time, frame in transect.render(Workers(config.threads)):
        truth = Truth.of_water(
            frame.attenuation, frame.ambient_light, kappa, frame.depth, config.assessment.contrast
        )
        known = np.isfinite(frame.range_left)
        exact = reader.estimate(
            frame.left, np.where(known, frame.range_left, np.float32(np.nan)))
        rows.append(TransectRow(
            time, truth, *_read(pipeline, water_filter, frame, time), exact))
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
