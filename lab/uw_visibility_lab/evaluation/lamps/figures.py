# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of the study under lamps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter

from uw_visibility.optics.transfer import from_linear
from uw_visibility_lab.evaluation.figures import style
from uw_visibility_lab.evaluation.lamps.cases import TOLD
from uw_visibility_lab.evaluation.lamps.survey import PICTURES, SurveyResult
from uw_visibility_lab.evaluation.studies import NEAR, StudyResult, Summary
from uw_visibility_lab.evaluation.tables import CHANNELS

COLOURS = {"known": style.OURS, "misplaced": style.HISTOGRAM, "daylight": style.PLAIN}
TICKS = (1, 2, 5, 10, 20, 50, 100, 200)


def draw_visibility(path: Path, results: Sequence[StudyResult], summary: Summary) -> None:
    """Draw visibility by night over its truth, and how many frames are right or refused."""
    figure = Figure(figsize=(11.0, 4.8), layout="constrained")
    scatter, bars = figure.subplots(1, 2, width_ratios=(3, 2))
    truth = np.array([result.truth.distance for result in results])
    ends = np.array([0.85 * truth.min(), 1.15 * truth.max()])
    scatter.fill_between(
        ends, (1 - NEAR) * ends, (1 + NEAR) * ends, color="black", alpha=0.07, linewidth=0.0)
    scatter.plot(ends, ends, **style.TRUTH_STYLE)
    for k, name in enumerate(TOLD):
        readings = [result.readings[name] for result in results]
        # Beside one another: frames of one water have the same truth.
        shift = truth * (1.0 + 0.02 * (k - 1))
        scatter.errorbar(
            shift, [r.distance for r in readings], [r.distance_stddev for r in readings],
            fmt="o", color=COLOURS[name], markersize=4.0, linewidth=0.8, label=TOLD[name],
        )
    scales = ((scatter.xaxis, scatter.set_xscale), (scatter.yaxis, scatter.set_yscale))
    for axis, set_scale in scales:
        set_scale("log")
        axis.set_major_locator(FixedLocator(TICKS))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    scatter.set_xlabel("true visibility distance [m]")
    scatter.set_ylabel("published visibility distance [m], ± 1 σ")
    scatter.grid(alpha=0.25, which="both")
    scatter.legend(frameon=False)
    names = [
        f"{title}\n> 3 σ: {100.0 * summary['told'][name]['beyond']['visibility']:.0f} %"
        for name, title in TOLD.items()
    ]
    right, refused = (
        np.array([100.0 * summary["told"][name][kind] for name in TOLD])
        for kind in ("right", "refused"))
    for left, share, label, colour in (
        (0.0, right, "within 20 %", style.OURS),
        (right, 100.0 - right - refused, "assessed, not within 20 %", style.HISTOGRAM),
        (100.0 - refused, refused, "refused", "#cccccc"),
    ):
        bars.barh(names, share, left=left, height=0.6, color=colour, label=label)
    bars.set_xlim(0.0, 100.0)
    bars.invert_yaxis()
    bars.set_xlabel("frames [%]")
    figure.legend(*bars.get_legend_handles_labels(), loc="outside lower right", ncols=3,
                  frameon=False)
    figure.suptitle("Visibility by night, lit by the vehicle's own lamps")
    style.save(figure, path)


def draw_survey(path: Path, survey: SurveyResult) -> None:
    """Draw frames of a survey by each method, and attenuation over its frames."""
    columns, rows = len(PICTURES), len(survey.shown)
    figure = Figure(figsize=(2.6 * columns, 2.1 * rows + 3.0), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(2.1 * rows + 0.6, 2.4))
    grid = upper.subplots(rows, columns, squeeze=False)
    for k, pictures in enumerate(survey.shown):
        for axes, (name, title) in zip(grid[k], PICTURES.items(), strict=True):
            axes.imshow(from_linear(np.clip(pictures[name], 0.0, 1.0), "srgb", np.uint8))
            axes.set_axis_off()
            if k == 0:
                variation = ", ".join(f"{100.0 * v:.0f}" for v in survey.variation[name])
                axes.set_title(
                    f"{title}\nσ/median {variation} %, ΔE*ab {survey.difference[name]:.1f}",
                    fontsize=9)
    axes = lower.subplots()
    frames = np.arange(len(survey.pooled))
    for c, name in enumerate(CHANNELS):
        value, sigma = (
            np.array([getattr(reading, field)[c] for reading in survey.pooled])
            for field in ("attenuation", "attenuation_stddev")
        )
        colour = style.CHANNEL_COLOURS[name]
        axes.fill_between(
            frames, value - sigma, value + sigma, color=colour, alpha=0.15, linewidth=0.0)
        axes.plot(frames, value, color=colour, label=f"{name}, with the frames before")
        axes.axhline(survey.truth.attenuation[c], color=colour, linestyle="--")
        axes.plot(
            frames, [reading.attenuation[c] for reading in survey.single], ".", color=colour,
            alpha=0.4)
    axes.set_ylim(0.0, 2.0 * max(survey.truth.attenuation))
    axes.set_xlabel("frame")
    axes.set_ylabel("β [1/m], ± 1 σ")
    axes.plot([], [], ".", color=style.INPUT, label="each frame alone")
    axes.plot([], [], "--", color=style.INPUT, label="truth")
    lower.legend(
        *axes.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False,
        fontsize=8)
    axes.grid(alpha=0.25)
    style.save(figure, path)
