# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rendered scenes in air, for experiments without a recorded dataset."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.evaluation.degrade import Scene
from uw_visibility.simulation.camera import NOISELESS, Pose, StereoCamera
from uw_visibility.simulation.frame import Renderer
from uw_visibility.simulation.scene import reef
from uw_visibility.simulation.water import Water

# A view down onto the reef, without open water that no recorded scene has either.
ALTITUDE = 1.6
TILT = np.radians(30.0)


def render_scene(seed: int, camera: StereoCamera | None = None) -> Scene:
    """Render a reef in air, with its exact disparity.

    Parameters
    ----------
    seed : int
        Seed of the reef; the same seed gives the same bits.
    camera : StereoCamera, optional
        640 by 480 px where absent.

    Returns
    -------
    Scene
        Named ``reef<seed>``. Disparity is NaN where there is open water, whose
        radiance is 1: at any range it is seen as ambient light.
    """
    camera = camera or StereoCamera()
    frame = Renderer(camera, sensor=NOISELESS, workers=Workers(1)).render(
        reef(seed, length=0.0), Pose((0.0, 0.0, ALTITUDE), tilt=TILT), Water(0.0, 0.0), seed=seed
    )
    return Scene(
        name=f"reef{seed}",
        left=_as_image(frame.radiance_left),
        right=_as_image(frame.radiance_right),
        disparity_left=frame.disparity_left,
        disparity_right=frame.disparity_right,
        focal_length=camera.focal_length,
        baseline=camera.baseline,
        principal_point=camera.principal_point,
    )


def _as_image(radiance: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.asarray(np.clip(radiance * 255 + 0.5, 0, 255), dtype=np.uint8)
