# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes of the adverse study: what a camera sees in air, with exact ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Map
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.evaluation.degrade import Scene, fill_from_background, load_scene
from uw_visibility_lab.evaluation.scenes import ALTITUDE, TILT, SceneSource, find_scenes
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.formation import Geometry
from uw_visibility_lab.simulation.frame import Renderer
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.view import View

CAMERA = StereoCamera(480, 360, 450.0, 0.12)
SEEDS = (0, 1)
OPEN_TILT = np.radians(14.0)
"""Tilt of a camera that sees open water above the reef; the other one, `TILT`, sees none."""

LARGEST_WIDTH = 700
"""Wider images are halved until they are not: many cases in little time."""

HEIGHT = 1.0
"""Height above the floor, m, taken for cameras of recorded scenes, which look ahead."""


@dataclass(frozen=True)
class AdverseScene:
    """A scene in air, seen by the left camera of a pair."""

    name: str  # for tables
    # radiance and range; a range is inf in open water, and filled from the background where a
    # recorded scene does not know it
    left: View
    geometry: Geometry  # where the pixels look
    rig: StereoRig  # the true calibration
    disparity: Map  # (H, W); true left disparity in px; NaN where unknown and in open water
    open_water: bool  # whether open water is in view


def find_adverse_scenes(datasets: Sequence[Path]) -> list[SceneSource]:
    """Find the scenes of datasets; without any, reefs are rendered, with open water and without."""
    if datasets:
        return find_scenes(datasets)
    return [SceneSource(seed=seed, open_water=seen) for seen in (False, True) for seed in SEEDS]


@lru_cache(maxsize=1)
def load_adverse_scene(source: SceneSource) -> AdverseScene:
    """Load a scene, or render it; the last one is kept."""
    if source.folder is None:
        return _rendered(source.seed, source.open_water)
    return _recorded(load_scene(source.folder))


def _rendered(seed: int, open_water: bool) -> AdverseScene:
    pose = Pose((0.0, 0.0, ALTITUDE), tilt=OPEN_TILT if open_water else TILT)
    left = Renderer(CAMERA, workers=Workers(1)).look(reef(seed, length=0.0), CAMERA, pose, 0.0)
    ranges = left.view.range
    return AdverseScene(
        name=f"reef{seed}{' open' if open_water else ''}",
        left=left.view,
        geometry=left.geometry,
        rig=CAMERA.rig,
        disparity=CAMERA.rig.disparity_from_range(
            np.where(np.isfinite(ranges), ranges, np.nan)),
        open_water=open_water,
    )


def _recorded(scene: Scene) -> AdverseScene:
    """Take a scene whose code values are radiance, as `degrade` does."""
    halvings = 0
    while scene.left.shape[1] >> halvings > LARGEST_WIDTH:
        halvings += 1
    step = 1 << halvings
    height, width = (n // step for n in scene.left.shape[:2])
    window = np.s_[: height * step, : width * step]
    disparity = scene.disparity_left[window][::step, ::step] / np.float32(step)
    rig = StereoCamera(width, height, scene.rig.focal_length / step, scene.rig.baseline).rig
    small = cv2.resize(scene.left[window], (width, height), interpolation=cv2.INTER_AREA)
    return AdverseScene(
        name=scene.name,
        left=View.of_pixels(
            small.astype(np.float32) / np.float32(255),
            rig.range_from_disparity(fill_from_background(disparity))),
        geometry=Geometry.of_rays(
            rig.ray_directions((height, width)), np.array([0.0, -1.0, 0.0]), HEIGHT),
        rig=rig,
        disparity=disparity,
        open_water=False,
    )
