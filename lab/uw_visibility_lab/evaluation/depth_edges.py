# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Halos: errors of range and colour at depth edges, by dense disparity map.

The same image, in the same water, is restored with several dense disparity maps, so
that their colours differ by what the maps do: the mesh of step 1 alone, its matting by
the guided filter and by the matting Laplacian that the filter stands for, step 2's
matches with gaps filled, and the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.matting import Matting
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.images.arrays import Image8, Map
from uw_visibility.images.view import View
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.pipeline.second_step import SecondStep
from uw_visibility.stereo.interpolation import inpaint
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.evaluation.degrade import Scene, fill_from_background
from uw_visibility_lab.evaluation.matting_laplacian import refine_by_laplacian
from uw_visibility_lab.evaluation.metrics import colour_difference, halo

MAPS = {
    "mesh": "mesh of step 1",
    "guided": "step 1, guided filter",
    "laplacian": "step 1, matting Laplacian",
    "final": "step 2, gaps filled",
    "truth": "true ranges",
}
"""Dense maps, by their names in tables."""

DISTANCE = 5
"""What counts as near an edge, px."""


@dataclass(frozen=True)
class EdgeErrors:
    """Mean errors of one dense map, within `DISTANCE` of true depth edges and elsewhere."""

    map: str  # a name of `MAPS`
    disparity_near: float  # disparity_near, disparity_elsewhere: px, of pixels whose truth is known
    disparity_elsewhere: float
    # colour_near, colour_elsewhere: ΔE*ab to the scene in air of the image restored with the map
    colour_near: float
    colour_elsewhere: float

    def row(self) -> dict[str, Any]:
        """Return the errors as a row of a table."""
        return {name.replace("_", "."): value for name, value in vars(self).items()}


def edge_errors(
    scene: Scene,
    left: Image8,
    right: Image8,
    result: FrameResult,
    rig: StereoRig,
    config: PipelineConfig,
    call: Callable[[str, Callable[[], Map]], Map] = lambda name, refine: refine(),
) -> list[EdgeErrors]:
    """Measure each map of `MAPS`.

    call: calls each matting, told its name, and returns what that does: to time it.
    """
    workers = Workers(1)
    step = SecondStep((left.shape[0], left.shape[1]), rig, config, workers)
    mesh = step.coarse_disparity(View.of(left), View.of(right))
    maps = {"mesh": inpaint(mesh), "final": result.stereo.filled}
    maps["truth"] = fill_from_background(scene.disparity_left)
    matting = Matting(config.enhancement, workers)
    for method, refine in (
        ("guided", lambda: matting.refine(mesh, left)),
        ("laplacian", lambda: refine_by_laplacian(mesh, left, config.enhancement)),
    ):
        maps[method] = call(method, refine)
    restorer = Restorer(config.enhancement, config.camera.transfer, workers)
    errors = []
    for name in MAPS:
        restored, _ = restorer.restore(left, rig.range_from_disparity(maps[name]), result.water)
        colour = np.where(scene.known, colour_difference(restored, scene.left), np.nan)
        colours = halo(colour, scene.disparity_left, DISTANCE)
        off = np.abs(maps[name] - scene.disparity_left)
        disparities = halo(off, scene.disparity_left, DISTANCE)
        errors.append(EdgeErrors(
            name, disparities.near, disparities.elsewhere, colours.near, colours.elsewhere))
    return errors
