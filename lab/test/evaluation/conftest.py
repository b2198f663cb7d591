# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A small scene of the Middlebury form, rendered by the tests themselves."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from uw_visibility_lab.evaluation.scenes import render_scene
from uw_visibility_lab.simulation.camera import StereoCamera

# The form fixes focal length and baseline; this camera's disparities fit them, so that
# ranges are those of a scene a few metres away.
CAMERA = StereoCamera(240, 180, 200.0, 0.6)


def save_scene(folder: Path, seed: int = 0) -> Path:
    """Save a rendered scene as third-size Middlebury scene, whose disparities count thirds."""
    scene = render_scene(seed, CAMERA)
    folder.mkdir(parents=True)
    for name, image in (("view1", scene.left), ("view5", scene.right)):
        cv2.imwrite(str(folder / f"{name}.png"), image[:, :, ::-1])
    for name, disparity in (("disp1", scene.disparity_left), ("disp5", scene.disparity_right)):
        thirds = np.nan_to_num(np.round(3 * disparity))
        thirds[thirds > 255] = 0
        cv2.imwrite(str(folder / f"{name}.png"), thirds.astype(np.uint8))
    return folder


@pytest.fixture(scope="session")
def scene_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of one scene."""
    return save_scene(tmp_path_factory.mktemp("dataset") / "reef")
