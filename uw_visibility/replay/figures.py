# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimates of a replay over time, as a picture that a page can hold."""

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
    figure = Figure(figsize=(10.0, 2.3 * rows + 0.3), layout="constrained")
    grid = figure.subplots(rows, 1, sharex=True)
    for axes, (name, label) in zip(grid, QUANTITIES, strict=False):
        _draw_quantity(axes, time, columns, name)
        axes.set_ylabel(label)
    _draw_sensor(grid[2], time, columns["sensor_depth"])
    grid[2].invert_yaxis()
    if with_nis:
        _draw_nis(grid[3], time, columns["nis"])
    for axes in grid:
        axes.grid(alpha=0.3)
    grid[-1].set_xlabel(f"time [{unit}]")
    return _svg(figure) if len(time) <= MOST_POINTS else _png(figure)


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
    axes.legend(loc="upper left", ncols=4, fontsize="small")
    if not np.isfinite(value).any():
        axes.text(0.5, 0.5, "not assessable", transform=axes.transAxes, ha="center", va="center")


def _draw_sensor(axes: Any, time: NDArray[np.float64], depth: NDArray[np.float64]) -> None:
    if np.isfinite(depth).any():
        axes.plot(time, depth, color=SENSOR, linewidth=1.4, label="depth sensor")
        axes.legend(loc="upper left", ncols=4, fontsize="small")


def _draw_nis(axes: Any, time: NDArray[np.float64], nis: NDArray[np.float64]) -> None:
    axes.semilogy(time, np.maximum(nis, 1e-3), ".", color=ESTIMATE, label="ν²/S")
    axes.axhline(3.841, color=SENSOR, linewidth=1.0, label="95 % of χ²")
    axes.set_ylabel("NIS of the sensor")
    axes.legend(loc="upper left", ncols=2, fontsize="small")


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
    known = value[np.isfinite(value)]
    if known.size == 0:
        known = np.array([0.0, 1.0])
    low, high = np.percentile(known, [2.0, 98.0])
    wide = float(np.nanmedian(stddev)) if np.isfinite(stddev).any() else 0.0
    margin = 0.15 * float(high - low) + 1.2 * wide + 1e-3
    low, high = float(low) - margin, float(high) + margin
    if other is not None and np.isfinite(other).any():
        low, high = min(low, float(np.nanmin(other))), max(high, float(np.nanmax(other)))
    return low, high


def _unit(duration: float) -> tuple[float, str]:
    if duration > 3 * 3600.0:
        return 3600.0, "h"
    return (60.0, "min") if duration > 300.0 else (1.0, "s")


def _svg(figure: Figure) -> str:
    # A fixed salt and no date: the same result has the same page.
    with matplotlib.rc_context({"svg.hashsalt": "uw_visibility"}):
        stream = BytesIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue().decode("utf-8")
    # What it says of itself is of no use inside a page.
    return re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg"):], flags=re.DOTALL)


def _png(figure: Figure) -> str:
    FigureCanvasAgg(figure)
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return f'<img alt="estimates over time" src="{data_uri(stream.getvalue())}">'


def data_uri(png: bytes) -> str:
    """Return a PNG as an address that holds it."""
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
