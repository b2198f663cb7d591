# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Curves: Fig. 6 and 7 of the paper, and the reliability of the matcher's confidence.

Fig. 6 and 7 show attenuation, matches and colour in different waters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from uw_visibility_lab.evaluation.cases import CaseResult
from uw_visibility_lab.evaluation.degrade import title_of
from uw_visibility_lab.evaluation.experiments import Evaluation
from uw_visibility_lab.evaluation.figures.style import (
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
from uw_visibility_lab.evaluation.metrics import expected_error

ROW_HEIGHT = 2.7
# Okabe and Ito's colours.
COLOURS = ("#000000", "#0072b2", "#009e73", "#e69f00", "#d55e00", "#cc79a7")


class Panel(NamedTuple):
    """A column of a figure: a line for each method, over attenuation or depth."""

    label: str
    cases: Sequence[CaseResult]
    styles: Mapping[str, Style]
    value: Callable[[CaseResult, str], float]
    top: float | None = None  # upper end of the axis, which begins at 0


def draw_over_attenuation(path: Path, evaluation: Evaluation) -> None:
    """Draw Fig. 6: α̂, unmatched and correct fraction over α, at one depth.

    The paper shows the unmatched fraction only, of a "conventional stereo matching
    framework" and of its own. Matches may be wrong, so the correct fraction is added,
    also for each noise of the sensor that was evaluated.
    """
    depth = evaluation.plan.shown[1]
    cases = [case for case in evaluation.quiet if case.truth.depth == depth]
    correct = [("correct fraction", cases)]
    correct += [
        (f"correct, {title_of(noise)}", [c for c in evaluation.cases if c.noise == noise])
        for noise in evaluation.plan.noises]
    _draw_panels(
        path, f"Decreasing visibility at z = {depth:g} m (as Fig. 6 of the paper)",
        ATTENUATION_LABEL, lambda case: case.truth.mean_attenuation, cases, [
            Panel("unmatched fraction", cases, MATCH_STYLES, lambda c, name: 1.0 - c.matched[name]),
            *(Panel(label, some, MATCH_STYLES, lambda c, name: c.correct[name], 1.0)
              for label, some in correct),
        ])


def draw_over_depth(path: Path, evaluation: Evaluation) -> None:
    """Draw Fig. 7: α̂ and ΔE*ab to the scene in air over z, at one α."""
    alpha = evaluation.plan.shown[0]
    cases = [
        case for case in evaluation.quiet if np.isclose(case.truth.mean_attenuation, alpha)]
    _draw_panels(
        path, f"Increasing depth at α = {alpha:.3g} 1/m (as Fig. 7 of the paper)",
        DEPTH_LABEL, lambda case: case.truth.depth, cases,
        [Panel("ΔE*ab", cases, IMAGE_STYLES, lambda c, name: c.colour_difference[name])])


def _draw_panels(
    path: Path, title: str, label: str, abscissa: Callable[[CaseResult], float],
    cases: Sequence[CaseResult], panels: Sequence[Panel],
) -> None:
    """Draw α̂ with the truth and ± 1 σ of the pipeline, and the panels; one row per scene."""
    scenes = list(dict.fromkeys(case.scene for case in cases))
    estimates = Panel(
        "estimate of α [1/m]", cases, READING_STYLES,
        lambda c, name: c.readings[name].mean_attenuation)
    figure = Figure(
        figsize=(4.4 * len(panels) + 5.0, ROW_HEIGHT * len(scenes) + 1.7), layout="constrained")
    grid = figure.subplots(
        len(scenes), 1 + len(panels), sharex=True, sharey="col", squeeze=False)
    figure.get_layout_engine().set(w_pad=0.12)  # type: ignore[union-attr]
    for row, scene in zip(grid, scenes, strict=True):
        for axes, panel in zip(row, (estimates, *panels), strict=True):
            shown = [case for case in panel.cases if case.scene == scene]
            x = [abscissa(case) for case in shown]
            if panel is estimates:
                axes.plot(x, [case.truth.mean_attenuation for case in shown], **TRUTH_STYLE)
                ours = [case.readings["pipeline"] for case in shown]
                value, sigma = (
                    np.array([getattr(reading, name) for reading in ours])
                    for name in ("mean_attenuation", "mean_attenuation_stddev"))
                axes.fill_between(
                    x, value - sigma, value + sigma, color=OURS, alpha=0.15, linewidth=0.0,
                    label="± 1 σ of ours")
            for name, style in panel.styles.items():
                axes.plot(x, [panel.value(case, name) for case in shown], **style)
            axes.set_ylabel(panel.label)
            axes.grid(alpha=0.25)
        row[0].set_ylabel(f"{scene}\n{estimates.label}")
    for axes, panel in zip(grid[0, 1:], panels, strict=True):
        axes.set_ylim(0.0, panel.top)
    for axes in grid[-1]:
        axes.set_xlabel(label)
    figure.suptitle(title)
    # Legends below the panels hide no data.
    for axes, place in ((grid[0, 0], "outside lower left"), (grid[0, 1], "outside lower right")):
        figure.legend(
            *axes.get_legend_handles_labels(), loc=place, ncols=2, frameon=False, fontsize=8)
    save(figure, path)


def draw_reliability(
    path: Path, by_noise: Mapping[str, Sequence[Mapping[str, float]]]
) -> None:
    """Draw the share of right disparities over confidence, and its histogram, by noise."""
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot((0, 1), (0, 1), **{**TRUTH_STYLE, "label": "calibrated"})
    for k, (noise, rows) in enumerate(by_noise.items()):
        x = [row["confidence"] for row in rows]
        label = f"{title_of(noise)}: mean error {expected_error(rows):.3f}"
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
