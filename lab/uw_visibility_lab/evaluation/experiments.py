# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Grid of experiments (section III), case by case, in several processes.

Artificial degradation of scenes with known disparity "to approximate the underwater
survey requirements of an AUV in a depth range of 0 - 5 m and a mean attenuation
coefficient of 0 - 0.3 1/m" (section III).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import check_range
from uw_visibility_lab.evaluation.cases import Case, CaseResult, evaluate_case
from uw_visibility_lab.evaluation.degrade import QUIET, sensor_of
from uw_visibility_lab.evaluation.metrics import reliability_rows
from uw_visibility_lab.evaluation.parallel import Progress, run_all, threads_each
from uw_visibility_lab.evaluation.scenes import Source, load_source
from uw_visibility_lab.evaluation.tables import grouped
from uw_visibility_lab.simulation.camera import NOISELESS

ATTENUATIONS = (0.0, 0.1, 0.2, 0.3)
DEPTHS = (1.0, 2.0, 5.0)
# Values of section III and its figures.
PAPER_ATTENUATIONS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
PAPER_DEPTHS = (0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)
# Figures 3, 7 and 9 show the water that is nearest to these: the paper's Fig. 7 has
# a mean attenuation of 0.2 1/m, its Fig. 6 a depth of 2 m.
SHOWN_ATTENUATION = 0.2
SHOWN_DEPTH = 2.0
# Largest values of a grid, beyond those of sections III and IV.
LARGEST_ATTENUATION = 5.0
LARGEST_DEPTH = 100.0


@dataclass(frozen=True)
class Plan:
    """Plan of an evaluation: scenes and grid of waters."""

    scenes: Sequence[Source]  # scenes of the grid
    attenuations: tuple[float, ...] = ATTENUATIONS  # α, 1/m, rising
    depths: tuple[float, ...] = DEPTHS  # z, m, rising
    # parameters of the pipeline, except its threads. By default the paper's model, in which one
    # ambient light is both the veil and the light on the scene
    config: PipelineConfig = field(
        default_factory=lambda: PipelineConfig.from_parameters({"water.veil": "paper"}))
    # noises of the sensor in addition to none, see `sensor_of`; only at the depth of the figures
    noises: tuple[str, ...] = ()

    def __post_init__(self) -> None:
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
        """Mean attenuation and depth of the grid in figures that show one water only."""
        return (
            min(self.attenuations, key=lambda a: abs(a - SHOWN_ATTENUATION)),
            min(self.depths, key=lambda z: abs(z - SHOWN_DEPTH)),
        )

    def cases(self) -> list[Case]:
        """Return the grid, scene by scene; cases with noise at one depth only."""
        return [
            Case(
                scene, attenuation, depth, (attenuation, depth, noise) == (*self.shown, QUIET),
                noise, thumbnails=(attenuation, noise) == (self.shown[0], QUIET),
            )
            for scene in self.scenes for noise in (QUIET, *self.noises)
            for attenuation in self.attenuations
            for depth in (self.depths if noise == QUIET else self.shown[1:])
        ]


@dataclass(frozen=True)
class Evaluation:
    """Results of an evaluation."""

    plan: Plan
    cases: list[CaseResult]  # in the order of `Plan.cases`

    @property
    def quiet(self) -> list[CaseResult]:
        """Cases without noise of the sensor."""
        return [case for case in self.cases if case.noise == QUIET]

    def reliability(self) -> dict[str, list[dict[str, float]]]:
        """Return `metrics.reliability_rows` of our confidence over all cases of each noise."""
        counted = [
            (case.noise, case.reliability) for case in self.cases if case.reliability is not None]
        return {
            noise: reliability_rows(np.sum([counts for _, counts in same], axis=0))
            for noise, same in grouped(counted, lambda each: each[0]).items()}


def evaluate(plan: Plan, jobs: int = 1, progress: Progress = lambda items, _: items) -> Evaluation:
    """Run the cases of a plan; the result is the same for any number of jobs."""
    # A scene that cannot be loaded is reported before the work begins.
    for scene in plan.scenes:
        load_source(scene)
    config = replace(plan.config, threads=threads_each(jobs))
    results = run_all(partial(evaluate_case, config=config), plan.cases(), jobs, progress)
    return Evaluation(plan, results)
