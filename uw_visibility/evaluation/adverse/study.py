# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Adverse study: every effect at every level on every scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import check_range
from uw_visibility.evaluation.adverse.cases import AdverseCase
from uw_visibility.evaluation.adverse.effects import chosen
from uw_visibility.evaluation.adverse.scenes import AdverseSource

ATTENUATIONS = (0.1, 0.3)
DEPTHS = (3.0,)


@dataclass(frozen=True)
class AdversePlan:
    """Plan of an adverse study.

    Attributes
    ----------
    scenes : sequence of AdverseSource
        The scenes.
    effects : tuple of str
        Names of effects; empty for all.
    attenuations, depths : tuple of float
        Attenuation by grey particles, 1/m, and depths of the camera, m.
    seeds : int
        Number of draws of noise and marine snow.
    matched : bool
        Whether disparities are matched instead of true.
    config : PipelineConfig
        What the estimators are told.
    """

    scenes: Sequence[AdverseSource]
    effects: tuple[str, ...] = ()
    attenuations: tuple[float, ...] = ATTENUATIONS
    depths: tuple[float, ...] = DEPTHS
    seeds: int = 1
    matched: bool = False
    config: PipelineConfig = field(default_factory=PipelineConfig)

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated."""
        check_range("number of seeds", self.seeds, 1)
        check_range("attenuations", self.attenuations, 0.0, 5.0, "1/m")
        check_range("depths", self.depths, 0.0, 100.0, "m")
        chosen(self.effects, matched=self.matched)

    def cases(self) -> list[AdverseCase]:
        """Return the cases, scene by scene."""
        effects = chosen(self.effects, matched=self.matched)
        return [
            AdverseCase(scene, effect, level, attenuation, depth, seed, self.matched)
            for scene in self.scenes
            for effect, levels in effects.items()
            for level in levels
            for attenuation in level.attenuations or self.attenuations
            for depth in self.depths
            for seed in range(self.seeds)
        ]
