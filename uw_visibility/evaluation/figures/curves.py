# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Curves: Fig. 6, 7 and 10 of the paper, and the reliability of the matcher's confidence.

Fig. 6 and 7 are attenuation, matches and colour as the water changes, Fig. 10 is attenuation,
visibility distance and depth along a transect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.evaluation.cases import CaseResult
from uw_visibility.evaluation.degrade import title_of
from uw_visibility.evaluation.experiments import Evaluation
from uw_visibility.evaluation.figures.style import (
    ATTENUATION_LABEL,
    DEPTH_LABEL,
    IMAGE_STYLES,
    MATCH_STYLES,
    OURS,
    READING_STYLES,
    TRUTH_STYLE,
    Style,
    save,
)
from uw_visibility.evaluation.reliability import Reliability
from uw_visibility.evaluation.transects import TransectRow
from uw_visibility.images.arrays import Array

ROW_HEIGHT = 2.7
Abscissa = Callable[[CaseResult], float]
FILTERED = "#d55e00"
QUANTITIES = (
    ("mean_attenuation", ATTENUATION_LABEL),
    ("distance", "visibility distance [m]"),
    ("depth", DEPTH_LABEL),
)
# Okabe and Ito's colours.
COLOURS = ("#000000", "#0072b2", "#009e73", "#e69f00", "#d55e00", "#cc79a7")


def draw_over_attenuation(path: Path, evaluation: Evaluation) -> None:
    """Draw Fig. 6: α̂, unmatched and correct fraction over α, at one depth.

    The paper shows the unmatched fraction alone, of a "conventional stereo matching
    framework" against its own. What is matched may be wrong, so the correct fraction
    stands beside it, once more for each noise of the sensor that was evaluated.
    """
    depth = evaluation.plan.shown[1]
    scenes = _by_scene(evaluation, lambda case: case.truth.depth == depth)
    noises = evaluation.plan.noises
    figure, grid = _panels(len(scenes), 3 + len(noises))
    for row, (scene, cases) in zip(grid, scenes.items(), strict=True):
        _draw_readings(row[0], cases, _attenuation, list(READING_STYLES))
        _draw_lines(
            row[1], cases, _attenuation, MATCH_STYLES, lambda c, name: 1.0 - c.matched[name])
        _draw_lines(row[2], cases, _attenuation, MATCH_STYLES, lambda c, name: c.correct[name])
        row[0].set_ylabel(f"{scene}\nestimate of α [1/m]")
        row[1].set_ylabel("unmatched fraction")
        row[2].set_ylabel(f"correct fraction (≤ {cases[0].tolerance:g} px)")
        for axes, noise in zip(row[3:], noises, strict=True):
            noisy = [c for c in evaluation.noisy if (c.scene, c.noise) == (scene, noise)]
            _draw_lines(axes, noisy, _attenuation, MATCH_STYLES, lambda c, name: c.correct[name])
            axes.set_ylabel(f"the same, {title_of(noise)}")
    grid[0, 1].set_ylim(bottom=0.0)
    for axes in grid[0, 2:]:
        axes.set_ylim(0.0, 1.0)
    for axes in grid[-1]:
        axes.set_xlabel(ATTENUATION_LABEL)
    figure.suptitle(f"Decreasing visibility at z = {depth:g} m (as Fig. 6 of the paper)")
    _legends(figure, grid, (0, 2))
    save(figure, path)


def draw_over_depth(path: Path, evaluation: Evaluation) -> None:
    """Draw Fig. 7: α̂ and ΔE*ab to the scene in air over z, at one α."""
    attenuation = evaluation.plan.shown[0]
    scenes = _by_scene(
        evaluation, lambda case: bool(np.isclose(case.truth.mean_attenuation, attenuation)))
    figure, grid = _panels(len(scenes), 2)
    for row, (scene, cases) in zip(grid, scenes.items(), strict=True):
        _draw_readings(row[0], cases, _depth, list(READING_STYLES))
        _draw_lines(
            row[1], cases, _depth, IMAGE_STYLES, lambda c, name: c.colour_difference[name])
        row[0].set_ylabel(f"{scene}\nestimate of α [1/m]")
        row[1].set_ylabel("ΔE*ab")
    grid[0, 1].set_ylim(bottom=0.0)
    for axes in grid[-1]:
        axes.set_xlabel(DEPTH_LABEL)
    figure.suptitle(
        f"Increasing depth at α = {attenuation:.3g} 1/m (as Fig. 7 of the paper)")
    _legends(figure, grid, (0, 1))
    save(figure, path)


def _by_scene(
    evaluation: Evaluation, wanted: Callable[[CaseResult], bool]
) -> dict[str, list[CaseResult]]:
    scenes: dict[str, list[CaseResult]] = {}
    for case in filter(wanted, evaluation.cases):
        scenes.setdefault(case.scene, []).append(case)
    return scenes


def _attenuation(case: CaseResult) -> float:
    return case.truth.mean_attenuation


def _depth(case: CaseResult) -> float:
    return case.truth.depth


def _panels(rows: int, columns: int) -> tuple[Figure, Any]:
    figure = Figure(figsize=(4.4 * columns + 0.6, ROW_HEIGHT * rows + 1.7), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey="col", squeeze=False)
    figure.get_layout_engine().set(w_pad=0.12)  # type: ignore[union-attr]
    for axes in grid.flat:
        axes.grid(alpha=0.25)
    return figure, grid


def _draw_readings(
    axes: Any, cases: Sequence[CaseResult], abscissa: Abscissa, names: Sequence[str]
) -> None:
    """Draw α̂ by each way to it, that of the pipeline with its band of one σ."""
    x = np.array([abscissa(case) for case in cases])
    axes.plot(x, [case.truth.mean_attenuation for case in cases], **TRUTH_STYLE)
    for name in names:
        values = np.array([case.readings[name].mean_attenuation for case in cases])
        axes.plot(x, values, **READING_STYLES[name])
        if name == "pipeline":
            sigma = np.array([case.readings[name].mean_attenuation_stddev for case in cases])
            axes.fill_between(
                x, values - sigma, values + sigma, color=OURS, alpha=0.15, linewidth=0.0,
                label="± 1 σ of ours",
            )


def _draw_lines(
    axes: Any,
    cases: Sequence[CaseResult],
    abscissa: Abscissa,
    styles: Mapping[str, Style],
    value: Callable[[CaseResult, str], float],
) -> None:
    x = [abscissa(case) for case in cases]
    for name, style in styles.items():
        axes.plot(x, [value(case, name) for case in cases], **style)


def _legends(figure: Figure, grid: Any, columns: Sequence[int]) -> None:
    """Name the lines below the panels, where the names hide no data."""
    for column, place in zip(columns, ("outside lower left", "outside lower right"), strict=True):
        figure.legend(
            *grid[0, column].get_legend_handles_labels(), loc=place, ncols=2, frameon=False,
            fontsize=8,
        )


def draw_transect(path: Path, rows: Sequence[TransectRow]) -> None:
    """Draw the estimates frame by frame, with bands of 1 and 2 σ, over the truth."""
    figure = Figure(figsize=(9.0, 8.2), layout="constrained")
    panels = figure.subplots(len(QUANTITIES), 1, sharex=True)
    time = np.array([row.time for row in rows])
    for axes, (name, label) in zip(panels, QUANTITIES, strict=True):
        value = np.array([getattr(row.reading, name) for row in rows])
        sigma = np.array([getattr(row.reading, f"{name}_stddev") for row in rows])
        truth = np.array([getattr(row.truth, name) for row in rows])
        for factor, opacity in ((2, 0.13), (1, 0.25)):
            axes.fill_between(
                time, value - factor * sigma, value + factor * sigma, color=OURS, alpha=opacity,
                linewidth=0.0, label=f"± {factor} σ",
            )
        axes.plot(
            time, value, "o-", color=OURS, markersize=3.5, linewidth=1.2, label="each frame alone"
        )
        axes.plot(
            time, [getattr(row.tracked, name) for row in rows], "-", color=FILTERED,
            linewidth=1.6, label="filtered over frames",
        )
        axes.plot(
            time, [getattr(row.exact, name) for row in rows], "x:", color=OURS, markersize=4.0,
            linewidth=1.0, label="with exact ranges",
        )
        axes.plot(time, truth, color="black", linewidth=1.5, linestyle="--", label="truth")
        axes.set_ylabel(label)
        axes.set_ylim(*_limits(value, truth))
        axes.grid(alpha=0.25)
        missing = time[~np.isfinite(value)]
        if missing.size:
            axes.plot(
                missing, np.zeros(missing.size), "|", color="#cc2020", markersize=9.0,
                transform=axes.get_xaxis_transform(), clip_on=False, label="not assessed",
            )
    panels[-1].set_xlabel("time [s]")
    handles: dict[str, object] = {}
    for axes in panels:
        handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=6, frameon=False)
    figure.suptitle("Transect (as Fig. 10 of the paper)")
    save(figure, path)


def _limits(value: Array, truth: Array) -> tuple[float, float]:
    """Return limits that hold the truth and nearly all estimates; a wild one does not set them."""
    known = value[np.isfinite(value)]
    low, high = np.percentile(known, [3, 97]) if known.size else (0.0, 0.0)
    top = max(float(truth.max()), float(high))
    return min(0.0, 1.15 * float(low)), 1.2 * top


def draw_reliability(path: Path, by_noise: Mapping[str, Reliability]) -> None:
    """Draw the share of right disparities over confidence, and how many have which.

    Parameters
    ----------
    path : Path
        PNG file to write.
    by_noise : dict of str to Reliability
        By noise of the sensor, see `sensor_of`.
    """
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot((0, 1), (0, 1), **{**TRUTH_STYLE, "label": "calibrated"})
    for k, (noise, reliability) in enumerate(by_noise.items()):
        rows = reliability.rows()
        x = [row["confidence"] for row in rows]
        label = f"{title_of(noise)}: off by {reliability.expected_error:.3f}"
        colour = COLOURS[k % len(COLOURS)]
        above.plot(x, [row["right"] for row in rows], color=colour, marker="o", label=label)
        below.plot(x, [row["part"] for row in rows], color=colour, marker="o")
    above.set_ylabel("right share of disparities")
    above.set_ylim(0.0, 1.0)
    above.legend(frameon=False)
    below.set_ylabel("part of the matches")
    below.set_ylim(bottom=0.0)
    below.set_xlabel("confidence")
    below.set_xlim(0.0, 1.0)
    for axes in (above, below):
        axes.grid(alpha=0.25)
    figure.suptitle("Reliability of confidence")
    save(figure, path)
