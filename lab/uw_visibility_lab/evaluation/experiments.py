# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Grid of experiments (section III), case by case, in several processes.

Artificial degradation of scenes with known disparity "to approximate the underwater
survey requirements of an AUV in a depth range of 0 - 5 m and a mean attenuation
coefficient of 0 - 0.3 1/m" (section III), and a transect like those of section IV.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError, check_range
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.water.series.filter import WaterFilter
from uw_visibility_lab.evaluation.cases import Case, CaseResult, evaluate_case
from uw_visibility_lab.evaluation.degrade import sensor_of
from uw_visibility_lab.evaluation.parallel import Progress, run_cases
from uw_visibility_lab.evaluation.readings import Reader, Reading, Truth
from uw_visibility_lab.evaluation.reliability import Reliability
from uw_visibility_lab.evaluation.scenes import SceneSource
from uw_visibility_lab.evaluation.tables import flat
from uw_visibility_lab.simulation.camera import NOISELESS
from uw_visibility_lab.simulation.frame import RenderedFrame
from uw_visibility_lab.simulation.transect import Transect
from uw_visibility_lab.simulation.water import RESPONSE

ATTENUATIONS = (0.0, 0.1, 0.2, 0.3)
DEPTHS = (1.0, 2.0, 5.0)
# What section III and its figures show.
PAPER_ATTENUATIONS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
PAPER_DEPTHS = (0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)
# Figures 3, 7 and 9 show the water that is nearest to these: the paper's Fig. 7 has
# a mean attenuation of 0.2 1/m, its Fig. 6 a depth of 2 m.
SHOWN_ATTENUATION = 0.2
SHOWN_DEPTH = 2.0
# Range of what section III and IV look into; it also keeps code values above zero.
LARGEST_ATTENUATION = 5.0
LARGEST_DEPTH = 100.0


@dataclass(frozen=True)
class Plan:
    """Plan of an evaluation: scenes and grid of waters."""

    scenes: Sequence[SceneSource]  # scenes of the grid
    attenuations: tuple[float, ...] = ATTENUATIONS  # α, 1/m, rising
    depths: tuple[float, ...] = DEPTHS  # z, m, rising
    transect: Transect | None = None  # the transect, where one is wanted
    # parameters of the pipeline, but for its threads. The paper's experiments have the paper's
    # model: one ambient light that is veil and light at once
    config: PipelineConfig = field(
        default_factory=lambda: PipelineConfig.from_parameters({"water.veil": "paper"}))
    # noises of the sensor beside none, see `sensor_of`; at the depth that figures show
    noises: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Validate the waters and sort the grid."""
        for name, unit, largest in (
            ("attenuations", "1/m", LARGEST_ATTENUATION), ("depths", "m", LARGEST_DEPTH),
        ):
            values = tuple(sorted(set(getattr(self, name))))
            check_range(name, values, 0.0, largest, unit)
            object.__setattr__(self, name, values)
        noisy = [noise for noise in dict.fromkeys(self.noises) if sensor_of(noise) != NOISELESS]
        object.__setattr__(self, "noises", tuple(noisy))

    @property
    def shown(self) -> tuple[float, float]:
        """Mean attenuation and depth of the grid that figures show where they show one."""
        return (
            min(self.attenuations, key=lambda a: abs(a - SHOWN_ATTENUATION)),
            min(self.depths, key=lambda z: abs(z - SHOWN_DEPTH)),
        )

    def cases(self) -> list[Case]:
        """Return the grid, scene by scene."""
        return [
            Case(
                scene, attenuation, depth, (attenuation, depth) == self.shown,
                thumbnails=attenuation == self.shown[0],
            )
            for scene in self.scenes for attenuation in self.attenuations for depth in self.depths
        ]

    def noisy_cases(self) -> list[Case]:
        """Return the cases with noise, scene by scene, at one depth."""
        return [
            Case(scene, attenuation, self.shown[1], noise=noise)
            for scene in self.scenes for attenuation in self.attenuations for noise in self.noises
        ]


@dataclass(frozen=True)
class TransectRow:
    """One frame of a transect."""

    time: float  # s from the first frame
    truth: Truth  # the water
    reading: Reading  # what the pipeline says of this frame
    tracked: Reading  # the same filtered over the frames so far
    # what the same estimate says with exact ranges: what is left are noise, particles and caustics
    exact: Reading

    def row(self) -> dict[str, Any]:
        """Return the frame as a row of a table."""
        return flat({
            "time": self.time, "true": self.truth, "pipeline": self.reading,
            "tracked": self.tracked, "exact": self.exact,
        })


def evaluate_transect(transect: Transect, config: PipelineConfig) -> list[TransectRow]:
    """Render a transect and assess its frames, each alone and filtered over time."""
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


@dataclass(frozen=True)
class Evaluation:
    """Results of an evaluation."""

    plan: Plan  # what was asked for
    cases: list[CaseResult]  # in the order of `Plan.cases`
    transect: list[TransectRow]  # empty where none was wanted
    noisy: list[CaseResult] = field(default_factory=list)  # in the order of `Plan.noisy_cases`

    def reliability(self) -> dict[str, Reliability]:
        """Return the reliability of our confidence over all cases of each noise."""
        by_noise: dict[str, list[Reliability]] = {}
        for case in (*self.cases, *self.noisy):
            if case.reliability is not None:
                by_noise.setdefault(case.noise, []).append(case.reliability)
        return {noise: Reliability.total(parts) for noise, parts in by_noise.items()}


def evaluate(plan: Plan, jobs: int = 1, progress: Progress = lambda items, _: items) -> Evaluation:
    """Run the cases of a plan; the result is the same for any number of jobs."""
    for scene in plan.scenes:
        scene.load()
    # The transect goes first: it is the longest piece.
    work: list[Transect | Case] = [] if plan.transect is None else [plan.transect]
    cases, noisy = plan.cases(), plan.noisy_cases()
    work += [*cases, *noisy]
    ordered = run_cases(_evaluate, work, plan.config, jobs, progress)
    transect = ordered.pop(0) if plan.transect is not None else []
    return Evaluation(plan, ordered[:len(cases)], transect, ordered[len(cases):])


def _evaluate(piece: Transect | Case, config: PipelineConfig) -> Any:
    if isinstance(piece, Case):
        return evaluate_case(piece, config)
    return evaluate_transect(piece, config)
