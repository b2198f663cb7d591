# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames of a rendered survey: a camera that looks down, to and fro over the same ground."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import check_range
from uw_visibility.evaluation.lamps.cases import DEPTH
from uw_visibility.evaluation.lamps.ground import ground_cells
from uw_visibility.simulation.camera import Pose, StereoCamera
from uw_visibility.simulation.frame import RenderedFrame, Renderer
from uw_visibility.simulation.lamps import Lighting, default_rig
from uw_visibility.simulation.scene import Scene, reef
from uw_visibility.simulation.water import Water

CAMERA = StereoCamera(320, 240, 300.0, 0.12)
ALTITUDES = (1.5, 3.0)
LENGTH = 3.0
"""Length of the lines that the vehicle goes to and fro, m."""

LINES = 4
PERIOD = 17.0
"""Frames in which it rises and sinks once: not a part of a line, so that ground is seen from
several altitudes at the same place of the image, and at several places from the same one."""

FEWEST_FRAMES = 5


@dataclass(frozen=True)
class SurveyPlan:
    """Plan of a survey.

    Attributes
    ----------
    frames : int
        Number of frames.
    lamps : int
        Number of lamps, see `default_rig`.
    mean_attenuation : float
        Attenuation by grey particles, 1/m.
    surfaces : str
        See `LampCase`.
    seed : int
        Seed of ground and noise.
    config : PipelineConfig
        What the pipeline is told beside the lamps.
    """

    frames: int = 100
    lamps: int = 2
    mean_attenuation: float = 0.15
    surfaces: str = "lambertian"
    seed: int = 0
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
    """A frame of a survey, and the ground that it shows.

    Attributes
    ----------
    frame : RenderedFrame
        The pair and its truth.
    cells : ndarray, shape (H, W), int64
        See `ground_cells`.
    """

    frame: RenderedFrame
    cells: NDArray[np.int64]


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
