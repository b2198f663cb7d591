# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pictures of the paper's figures: disparities (5), over depth (7), by method (9)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from uw_visibility.evaluation.cases import IMAGES, MATCHES, CaseResult, Pictures
from uw_visibility.evaluation.figures.style import save

SHOWN = ("degraded", "histogram", "clahe", "final", "oracle")
WIDTH = 2.9
COLOURS = colormaps["turbo"].with_extremes(bad="black")


def draw_pictures(path: Path, cases: Sequence[CaseResult]) -> None:
    """Draw the scenes under water, by each method, and in air, with their ΔE*ab.

    Pixels are shown as they are, without encoding, as the paper takes those of its
    scenes.
    """
    figure, rows = _grid(cases, len(SHOWN) + 1)
    for row, case, pictures in rows:
        for axes, name in zip(row, SHOWN, strict=False):
            difference = case.colour_difference[name]
            if np.isfinite(difference):
                axes.imshow(pictures.images[name])
                axes.set_title(f"{IMAGES[name]}\nΔE*ab = {difference:.1f}", fontsize=9)
            else:
                axes.set_title(f"{IMAGES[name]}\npair refused", fontsize=9)
        row[-1].imshow(pictures.radiance)
        row[-1].set_title(f"{case.scene} in air", fontsize=9)
    truth = cases[0].truth
    figure.suptitle(
        f"Enhancement at α = {truth.mean_attenuation:.3g} 1/m, z = {truth.depth:g} m "
        "(as Fig. 9 of the paper)"
    )
    save(figure, path)


def draw_disparities(path: Path, cases: Sequence[CaseResult]) -> None:
    """Draw Fig. 5: under water, disparities of that pair, improved ones, enhanced image."""
    figure, rows = _grid(cases, 4)
    for row, case, pictures in rows:
        row[0].imshow(pictures.images["degraded"])
        row[0].set_title(f"{case.scene} under water", fontsize=9)
        found = pictures.disparities
        known = found["ours"][np.isfinite(found["ours"])] if found else np.empty(0)
        limits = np.percentile(known, [1.0, 99.0]) if known.size else (0.0, 1.0)
        for axes, name in zip(row[1:3], ("ours_raw", "ours"), strict=True):
            if name in found:
                axes.imshow(found[name], cmap=COLOURS, vmin=limits[0], vmax=limits[1])
                axes.set_title(
                    f"{MATCHES[name]}\n{case.matched[name]:.0%} matched, "
                    f"{case.correct[name]:.0%} correct", fontsize=9)
            else:
                axes.set_title(f"{MATCHES[name]}\npair refused", fontsize=9)
        if "final" in pictures.images:
            row[3].imshow(pictures.images["final"])
        row[3].set_title(IMAGES["final"], fontsize=9)
    figure.suptitle("Disparities and enhancement (as Fig. 5 of the paper); black is not matched")
    save(figure, path)


def _grid(
    cases: Sequence[CaseResult], columns: int
) -> tuple[Figure, list[tuple[Any, CaseResult, Pictures]]]:
    """Make a figure with a row of axes for each case that has pictures."""
    shown = [(case, case.pictures) for case in cases if case.pictures is not None]
    shapes = [pictures.radiance.shape for _, pictures in shown]
    heights = [WIDTH * shape[0] / shape[1] + 0.3 for shape in shapes]
    figure = Figure(figsize=(WIDTH * columns, sum(heights) + 0.7), layout="constrained")
    grid = figure.subplots(
        len(shown), columns, squeeze=False, gridspec_kw={"height_ratios": heights})
    for axes in grid.flat:
        axes.set_axis_off()
    return figure, [(row, *each) for row, each in zip(grid, shown, strict=True)]


def draw_over_depth(path: Path, cases: Sequence[CaseResult]) -> None:
    """Draw the pictures of Fig. 7: under water and enhanced, over depth."""
    scenes: dict[str, list[CaseResult]] = {}
    for case in cases:
        scenes.setdefault(case.scene, []).append(case)
    columns = max(len(of_scene) for of_scene in scenes.values())
    figure = Figure(figsize=(2.5 * columns, 4.2 * len(scenes) + 0.6), layout="constrained")
    grid = figure.subplots(2 * len(scenes), columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for number, of_scene in enumerate(scenes.values()):
        for column, case in enumerate(of_scene):
            for line, name in enumerate(("degraded", "final")):
                axes = grid[2 * number + line, column]
                if name in case.thumbnails:
                    axes.imshow(case.thumbnails[name])
                where = f"{case.scene}, z = {case.truth.depth:g} m\n" if line == 0 else ""
                axes.set_title(
                    f"{where}{IMAGES[name]}\nΔE*ab = {case.colour_difference[name]:.1f}",
                    fontsize=8)
    figure.suptitle(
        f"Increasing depth at α = {cases[0].truth.mean_attenuation:.3g} 1/m "
        "(as the pictures of Fig. 7 of the paper)")
    save(figure, path)
