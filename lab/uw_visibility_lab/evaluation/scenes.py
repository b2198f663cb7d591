# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Sources of scenes of an evaluation: folders, or reefs of our own renderer."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility.optics.transfer import from_linear
from uw_visibility_lab.evaluation.degrade import IMAGE_SUFFIXES, Scene, load_scene
from uw_visibility_lab.simulation.camera import NOISELESS, Pose, StereoCamera
from uw_visibility_lab.simulation.frame import Renderer
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.water import Water

RENDERED_SEEDS = (0, 1, 2)
"""Seeds of the reefs that are rendered if no dataset is given."""

FULL_SIZE_WIDTH = 1000
"""Beyond this width, px, a disparity is correct within 2 px instead of 1."""

# A view down onto the reef, without open water, as in recorded scenes.
ALTITUDE = 1.6
TILT = np.radians(30.0)

Source: TypeAlias = Path | int
"""Folder of a Middlebury-like scene, or seed of a rendered one."""


@lru_cache(maxsize=1)
def load_source(source: Source) -> Scene:
    """Load or render a scene; the last one is kept."""
    return render_scene(source) if isinstance(source, int) else load_scene(source)


def find_scenes(datasets: Sequence[Path]) -> Sequence[Source]:
    """Find the scenes of datasets: folders of a scene, or of scenes, which are sorted by name.

    Without datasets, the scenes are rendered.
    """
    if not datasets:
        return RENDERED_SEEDS
    folders: list[Path] = []
    for dataset in datasets:
        folders += _scene_folders(dataset)
    names = [folder.resolve().name for folder in folders]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"two scenes are named {name}: rename one, tables tell them apart by name"
            )
    return [folder.resolve() for folder in folders]


def search_limit(scene: Scene) -> int:
    """Number of disparities, from 0, that every matcher searches: a multiple of 16 for OpenCV."""
    largest = float(np.nanmax(scene.disparity_left))
    return 16 * (int(largest) // 16 + 1)


def tolerance(scene: Scene) -> float:
    """Largest error of a correct disparity, px."""
    return 2.0 if scene.left.shape[1] > FULL_SIZE_WIDTH else 1.0


def _scene_folders(dataset: Path) -> list[Path]:
    if not dataset.is_dir():
        raise InputError(f"there is no folder {dataset}: give a scene or a folder of scenes")
    if _is_scene(dataset):
        return [dataset]
    scenes = sorted(folder for folder in dataset.iterdir() if folder.is_dir() and _is_scene(folder))
    if not scenes:
        raise InputError(
            f"{dataset} holds no scene: a scene is a folder with view1, view5 and disp1.png"
        )
    return scenes


def _is_scene(folder: Path) -> bool:
    """Tell whether a folder is meant as a scene; missing files are reported on loading."""
    return any((folder / f"view1{suffix}").is_file() for suffix in IMAGE_SUFFIXES)


def render_scene(seed: int, camera: StereoCamera | None = None) -> Scene:
    """Render a reef in air, with its exact disparity; 640 by 480 px without a camera.

    Disparity is NaN in open water, whose radiance is 1: it shows ambient light at any range.
    """
    camera = camera or StereoCamera()
    frame = Renderer(camera, sensor=NOISELESS, workers=Workers(1)).render(
        reef(seed, length=0.0), Pose((0.0, 0.0, ALTITUDE), tilt=TILT), Water(0.0, 0.0), seed=seed
    )
    left, right = (
        np.asarray(from_linear(radiance, "linear", np.uint8), np.uint8)
        for radiance in (frame.radiance_left, frame.radiance_right))
    return Scene(
        name=f"reef{seed}",
        left=left,
        right=right,
        disparity_left=frame.disparity_left,
        disparity_right=frame.disparity_right,
        rig=camera.rig,
    )
