# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fig. 9 of the paper: histogram methods against ours, as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.evaluation.cases import IMAGES, CaseResult
from uw_visibility.evaluation.figures.style import save

SHOWN = ("degraded", "histogram", "clahe", "final", "oracle")
WIDTH = 2.9


def draw_pictures(path: Path, cases: Sequence[CaseResult]) -> None:
    """Draw the scenes under water, by each method, and in air, with their ΔE*ab.

    Pixels are shown as they are, without encoding, as the paper takes those of its
    scenes.

    Parameters
    ----------
    path : Path
        PNG file to write.
    cases : sequence of CaseResult
        With pictures; one row each.
    """
    columns = len(SHOWN) + 1
    shapes = [case.pictures.radiance.shape for case in cases if case.pictures is not None]
    heights = [WIDTH * shape[0] / shape[1] + 0.3 for shape in shapes]
    figure = Figure(figsize=(WIDTH * columns, sum(heights) + 0.7), layout="constrained")
    grid = figure.subplots(
        len(cases), columns, squeeze=False, gridspec_kw={"height_ratios": heights})
    for row, case in zip(grid, cases, strict=True):
        if case.pictures is None:
            continue
        for axes, name in zip(row, SHOWN, strict=False):
            difference = case.colour_difference[name]
            if np.isfinite(difference):
                axes.imshow(case.pictures.images[name])
                axes.set_title(f"{IMAGES[name]}\nΔE*ab = {difference:.1f}", fontsize=9)
            else:
                axes.set_title(f"{IMAGES[name]}\npair refused", fontsize=9)
        row[-1].imshow(case.pictures.radiance)
        row[-1].set_title(f"{case.scene} in air", fontsize=9)
    for axes in grid.flat:
        axes.set_axis_off()
    truth = cases[0].truth
    figure.suptitle(
        f"Enhancement at α = {truth.mean_attenuation:.3g} 1/m, z = {truth.depth:g} m "
        "(as Fig. 9 of the paper)"
    )
    save(figure, path)
