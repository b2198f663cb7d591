# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Study under lamps: reefs by night in waters of several turbidities, and a survey."""

from __future__ import annotations

from dataclasses import dataclass, field

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import check_range
from uw_visibility.evaluation.lamps.cases import SURFACES, LampCase
from uw_visibility.evaluation.lamps.survey_frames import SurveyPlan

ATTENUATIONS = (0.05, 0.1, 0.2, 0.3)
LAMPS = (2, 4)
SEEDS = 3
FRAMES = 100


@dataclass(frozen=True)
class LampPlan:
    """Plan of a study under lamps.

    Attributes
    ----------
    attenuations : tuple of float
        Attenuation by grey particles, 1/m.
    lamps : tuple of int
        Numbers of lamps, see `default_rig`.
    surfaces : tuple of str
        Of `SURFACES`.
    seeds : int
        Number of reefs, each with a pose and noise of its own.
    matched : bool
        Whether ranges are matched by the pipeline instead of true.
    survey : SurveyPlan, optional
        The survey; None for none.
    config : PipelineConfig
        What the pipeline is told beside the lamps.
    """

    attenuations: tuple[float, ...] = ATTENUATIONS
    lamps: tuple[int, ...] = LAMPS
    surfaces: tuple[str, ...] = SURFACES
    seeds: int = SEEDS
    matched: bool = True
    survey: SurveyPlan | None = None
    config: PipelineConfig = field(default_factory=PipelineConfig)

    def __post_init__(self) -> None:
        """Refuse what cannot be rendered."""
        check_range("number of seeds", self.seeds, 1)
        check_range("attenuations", self.attenuations, 0.0, 5.0, "1/m")

    def cases(self) -> list[LampCase]:
        """Return the cases, reef by reef."""
        return [
            LampCase(seed, lamps, attenuation, surfaces, self.matched)
            for seed in range(self.seeds)
            for lamps in self.lamps
            for surfaces in self.surfaces
            for attenuation in self.attenuations
        ]
