# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fig. 10 of the paper: attenuation, visibility distance and depth along a transect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uw_visibility.evaluation.figures.style import ATTENUATION_LABEL, DEPTH_LABEL, OURS, save
from uw_visibility.evaluation.transects import TransectRow

FILTERED = "#d55e00"
QUANTITIES = (
    ("mean_attenuation", ATTENUATION_LABEL),
    ("distance", "visibility distance [m]"),
    ("depth", DEPTH_LABEL),
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


def _limits(value: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float]:
    """Return limits that hold the truth and nearly all estimates; a wild one does not set them."""
    known = value[np.isfinite(value)]
    low, high = np.percentile(known, [3, 97]) if known.size else (0.0, 0.0)
    top = max(float(truth.max()), float(high))
    return min(0.0, 1.15 * float(low)), 1.2 * top
