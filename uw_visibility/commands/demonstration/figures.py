# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of the demonstration: frames side by side, and estimates over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from uw_visibility.commands.demonstration.comparison import FrameComparison
from uw_visibility.images.arrays import Array, Image8, Map

TRUTH = {"color": "black", "linewidth": 1.5, "label": "truth"}
ESTIMATE = "#0072b2"

QUANTITIES = (
    ("mean_attenuation", "mean attenuation α [1/m]"),
    ("visibility_distance", "visibility distance [m]"),
    ("depth", "depth [m]"),
)


def draw_frame(
    path: Path,
    images: tuple[Image8, Image8],
    disparities: tuple[Map, Map, Map],
    row: FrameComparison,
) -> None:
    """Draw one frame's images and disparities side by side.

    Parameters
    ----------
    path : Path
        PNG file to write.
    images : tuple of two ndarrays, shape (H, W, 3), uint8
        Raw and enhanced left image.
    disparities : tuple of three ndarrays, shape (H, W), float32
        Before and after enhancement, and true, px; NaN = unknown.
    row : FrameComparison
        The frame's numbers.
    """
    height, width = images[0].shape[:2]
    figure = Figure(figsize=(15.0, 2.0 * 4.7 * height / width + 0.8), layout="constrained")
    grid = figure.subplots(2, 3)
    for axes, image, name in zip(grid[0], images, ("raw", "enhanced"), strict=False):
        axes.imshow(image)
        axes.set_title(name)
    grid[0, 2].text(
        0.02, 0.95, _numbers(row), va="top", family="monospace", fontsize=11,
        transform=grid[0, 2].transAxes,
    )
    colours = matplotlib.colormaps["turbo"].copy()
    colours.set_bad("black")
    largest = float(np.nanmax(disparities[2], initial=1.0))
    titles = (
        f"disparity before: {row.matched_before:.0%} matched, {row.correct_before:.0%} correct",
        f"disparity after: {row.matched_after:.0%} matched, {row.correct_after:.0%} correct",
        "true disparity (black: open water)",
    )
    for axes, disparity, name in zip(grid[1], disparities, titles, strict=True):
        drawn = axes.imshow(disparity, cmap=colours, vmin=0.0, vmax=largest)
        axes.set_title(name)
    figure.colorbar(drawn, ax=list(grid[1]), label="px", fraction=0.015, pad=0.01)
    for axes in grid.flat:
        axes.set_axis_off()
    _save(figure, path)


def draw_series(path: Path, rows: Sequence[FrameComparison]) -> None:
    """Draw the estimates over time with bands of one σ, over the truth.

    Parameters
    ----------
    path : Path
        PNG file to write.
    rows : sequence of FrameComparison
        The frames in the order of time.
    """
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    time = np.array([row.time for row in rows])
    all_axes = figure.subplots(len(QUANTITIES), 1, sharex=True)
    for axes, (name, label) in zip(all_axes, QUANTITIES, strict=True):
        value, stddev, truth = (
            np.array([getattr(row, field) for row in rows])
            for field in (name, f"{name}_stddev", f"true_{name}")
        )
        axes.fill_between(
            time, value - stddev, value + stddev, color=ESTIMATE, alpha=0.25, linewidth=0.0,
            label="± 1 σ",
        )
        axes.plot(time, value, ".-", color=ESTIMATE, label="estimate")
        axes.plot(time, truth, **TRUTH)
        axes.set_ylabel(label)
        axes.set_ylim(*_limits(value, truth))
        axes.grid(alpha=0.3)
    all_axes[0].legend(loc="upper left", ncols=3)
    all_axes[-1].set_xlabel("time [s]")
    figure.suptitle("Estimates of the node over the transect")
    _save(figure, path)


def _limits(value: Array, truth: Array) -> tuple[float, float]:
    """Return limits for an axis that a single wild estimate does not set."""
    known = value[np.isfinite(value)]
    low, high = np.percentile(known, [5, 95]) if known.size else (0.0, 0.0)
    return min(0.0, 1.25 * float(low)), 1.25 * max(float(truth.max()), float(high))


def _numbers(row: FrameComparison) -> str:
    def line(name: str, unit: str, value: float, stddev: float, truth: float) -> str:
        estimate = f"{value:7.3f} ± {stddev:5.3f}" if np.isfinite(value) else "   not assessed"
        return f"{name:22s}{estimate}   {truth:7.3f}  {unit}"

    def of(name: str) -> tuple[Any, Any, Any]:
        fields = (name, f"{name}_stddev", f"true_{name}")
        return tuple(getattr(row, field) for field in fields)  # type: ignore[return-value]

    return "\n".join([
        f"time {row.time:.1f} s",
        "",
        f"{'':22s}{'estimate':>15s}   {'truth':>7s}",
        line("mean attenuation", "1/m", *of("mean_attenuation")),
        line("visibility distance", "m", *of("visibility_distance")),
        line("depth", "m", *of("depth")),
        "",
        f"latency {row.latency:.0f} ms",
    ])


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=80)
