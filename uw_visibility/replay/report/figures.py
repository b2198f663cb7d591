# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of estimates over time, embedded in a page."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[np.float64]]

ESTIMATE, FILTERED, SENSOR = "#0072b2", "#1b1f24", "#d55e00"
# More points than this make a vector drawing larger than pixels.
MOST_POINTS = 4000
# What lies below is drawn here: how small a difference is says nothing.
LEAST_NIS = 1e-3

QUANTITIES = (
    ("mean_attenuation", "mean attenuation α [1/m]"),
    ("visibility_distance", "visibility distance [m]"),
    ("depth", "depth [m]"),
)
NEEDED = (
    "stamp", "mean_attenuation", "mean_attenuation_stddev", "visibility_distance",
    "visibility_distance_stddev", "depth", "depth_stddev", "sensor_depth", "nis",
    *(f"filtered_{name}" for name, _ in QUANTITIES),
)


def draw_series(columns: Columns) -> str:
    """Draw the estimates over time.

    Parameters
    ----------
    columns : mapping of str to ndarray, (n,) float64
        Those of `NEEDED`; NaN for what is not known.

    Returns
    -------
    str
        A piece of HTML: SVG, or for very long recordings an embedded PNG.
    """
    time = columns["stamp"] - np.nanmin(columns["stamp"]) if len(columns["stamp"]) else np.empty(0)
    scale, unit = _unit(float(time.max(initial=0.0)))
    time = time / scale
    with_nis = bool(np.isfinite(columns["nis"]).any())
    rows = len(QUANTITIES) + with_nis
    figure = Figure(figsize=(10.8, 2.4 * rows + 0.4), layout="constrained")
    grid = figure.subplots(rows, 1, sharex=True)
    for axes, (name, label) in zip(grid, QUANTITIES, strict=False):
        _draw_quantity(axes, time, columns, name)
        axes.set_ylabel(label)
    _legend(grid[0])
    if np.isfinite(columns["sensor_depth"]).any():
        (line,) = grid[2].plot(
            time, columns["sensor_depth"], color=SENSOR, linewidth=1.4, label="depth sensor"
        )
        _legend(grid[2], [line])
    grid[2].invert_yaxis()
    if with_nis:
        _draw_nis(grid[3], time, columns["nis"])
    for axes in grid:
        axes.grid(alpha=0.3)
    grid[-1].set_xlabel(f"time [{unit}]")
    return draw(figure, len(time) <= MOST_POINTS, "estimates over time")


def _draw_quantity(axes: Any, time: NDArray[np.float64], columns: Columns, name: str) -> None:
    value, stddev = columns[name], columns[f"{name}_stddev"]
    marker = "." if len(time) <= 400 else ""
    axes.fill_between(
        time, value - stddev, value + stddev, color=ESTIMATE, alpha=0.25, linewidth=0.0,
        label="± 1 σ",
    )
    # A value between two gaps has no line and no band to be seen by.
    alone = np.isfinite(value) & ~_has_neighbour(value)
    axes.plot(time, value, color=ESTIMATE, linewidth=1.2, marker=marker, label="estimate")
    axes.errorbar(
        time[alone], value[alone], stddev[alone], fmt=".", color=ESTIMATE, elinewidth=1.0,
    )
    filtered = columns[f"filtered_{name}"]
    if np.isfinite(filtered).any():
        axes.plot(time, filtered, color=FILTERED, linewidth=1.4, label="filtered over frames")
    axes.set_ylim(*_limits(value, stddev, columns["sensor_depth"] if name == "depth" else None))
    if not np.isfinite(value).any():
        axes.text(0.5, 0.5, "not assessable", transform=axes.transAxes, ha="center", va="center")


def _legend(axes: Any, lines: list[Any] | None = None) -> None:
    """Put a legend above the axes, where it covers nothing."""
    chosen = {} if lines is None else {"handles": lines}
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=4, fontsize="small", frameon=False,
        **chosen,
    )


def _draw_nis(axes: Any, time: NDArray[np.float64], nis: NDArray[np.float64]) -> None:
    axes.semilogy(time, np.maximum(nis, LEAST_NIS), ".", color=ESTIMATE, label="ν²/S")
    axes.axhline(3.841, color=SENSOR, linewidth=1.0, label="95 % of χ²")
    axes.set_ylim(LEAST_NIS / 2.0, max(20.0, 2.0 * float(np.nanmax(nis))))
    axes.set_ylabel("NIS of the sensor")
    _legend(axes)


def _has_neighbour(value: NDArray[np.float64]) -> NDArray[np.bool_]:
    known = np.isfinite(value)
    beside = np.zeros(len(value), bool)
    beside[1:] |= known[:-1]
    beside[:-1] |= known[1:]
    return beside


def _limits(
    value: NDArray[np.float64], stddev: NDArray[np.float64], other: NDArray[np.float64] | None
) -> tuple[float, float]:
    """Return limits for an axis that a few wild values do not set."""
    known = np.isfinite(value)
    if not known.any():
        return 0.0, 1.0
    spread = np.nan_to_num(stddev[known])
    # The band of a value that is hardly known at all is cut off.
    spread = np.minimum(spread, 3.0 * float(np.median(spread)))
    low = float(np.percentile(value[known] - spread, 2.0))
    high = float(np.percentile(value[known] + spread, 98.0))
    if other is not None and np.isfinite(other).any():
        low, high = min(low, float(np.nanmin(other))), max(high, float(np.nanmax(other)))
    margin = 0.08 * (high - low) + 1e-3
    low, high = low - margin, high + margin
    # No water is clearer than clear, and no camera above the surface: a band may reach there.
    return (max(low, 0.0) if np.min(value[known]) >= 0.0 else low), high


def _unit(duration: float) -> tuple[float, str]:
    if duration > 3 * 3600.0:
        return 3600.0, "h"
    return (60.0, "min") if duration > 300.0 else (1.0, "s")


def draw(figure: Figure, vector: bool, title: str) -> str:
    """Return a figure as a piece of HTML: as SVG, or else as an embedded PNG."""
    return _svg(figure) if vector else _png(figure, title)


def _svg(figure: Figure) -> str:
    # A fixed salt and no date: the same result has the same page.
    with matplotlib.rc_context({"svg.hashsalt": "uw_visibility"}):
        stream = BytesIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue().decode("utf-8")
    # What it says of itself is of no use inside a page.
    return re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg"):], flags=re.DOTALL)


def _png(figure: Figure, title: str) -> str:
    FigureCanvasAgg(figure)
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return f'<img alt="{title}" src="{data_uri(stream.getvalue())}">'


def data_uri(png: bytes) -> str:
    """Return a PNG as an address that holds it."""
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
