# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of estimates over time: single frames, filtered over frames, and depth sensor."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib.dates
import matplotlib.ticker
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from uw_visibility.errors import printable
from uw_visibility.images.arrays import Array
from uw_visibility.replay.report.sentences import number, rounded
from uw_visibility.replay.report.svg import (
    ESTIMATE,
    FILTERED,
    HOLLOW,
    RULE,
    SENSOR,
    Spot,
    draw,
)
from uw_visibility.replay.results.synopsis import LONGEST_STEP
from uw_visibility.replay.table import Columns

HEIGHT = 2.3
# Most points; with more frames, neighbours are drawn as one point.
MOST_POINTS = 600
# Margins of the axes, in: left, right, below and above. The same for all figures, so that their
# time axes are aligned.
MARGINS = (0.68, 0.1, 0.5, 0.28)
# Width of a digit, relative to the size of its font.
LETTER = 0.6
# Most recordings with names.
MOST_NAMES = 12
# Least value drawn; smaller ones are drawn here.
LEAST_NIS = 1e-3
# Seconds per day, the unit of time of matplotlib.
DAY = 86400.0
# Formats for ticks by year, month, day, hour, minute, second.
CLOCK = ["%Y", "%Y-%m", "%m-%d", "%H:%M", "%H:%M", "%H:%M:%S.%f"]
DATES = ["", "", "%Y", "%Y-%m-%d", "%Y-%m-%d", "%Y-%m-%d"]


class Quantity(NamedTuple):
    """Quantity that is drawn over time."""

    name: str
    title: str
    short: str
    unit: str


QUANTITIES = (
    Quantity("visibility_distance", "Visibility distance", "visibility", "m"),
    Quantity("mean_attenuation", "Mean attenuation α, beyond that of clear sea water", "α", "1/m"),
    Quantity("depth", "Depth by the colour of daylight", "depth", "m"),
)


class Series(NamedTuple):
    """Figure of one quantity."""

    title: str
    drawing: Markup
    # start, end: ends of the time axis, s since 1970 (UTC); the same for all
    start: float
    end: float
    together: int  # frames per point, which is their median; the same for all


def draw_series(columns: Columns, recordings: Sequence[str] = ()) -> list[Series]:
    """Draw the estimates over time.

    columns: columns of the table; with `recordings` also ``recording``, the index of each frame's
        recording there.
    recordings: names, if the frames are of several recordings.
    Returns one figure per quantity; nothing without frames.
    """
    if not len(columns["stamp"]):
        return []
    together = neighbours(len(columns["stamp"]))
    thinned = thin(columns)
    time = thinned["stamp"] / DAY
    found = [
        (quantity.title, draw(
            f"series-{quantity.name.replace('_', '-')}", f"{quantity.title} over time",
            _described(columns, quantity), HEIGHT,
            _Panel(time, thinned, quantity, recordings, together).paint,
        ))
        for quantity in QUANTITIES
    ]
    if np.isfinite(columns["nis"]).any():
        beyond = int((columns["nis"] > 3.841).sum())
        found.append(("Depth sensor against the estimate, ν²/S", draw(
            "series-nis", "Normalised innovation squared of the depth sensor over time",
            f"{beyond} of {int(np.isfinite(columns['nis']).sum())} values beyond 95 % of χ².",
            HEIGHT, lambda figure, narrow: _paint_nis(figure, time, thinned["nis"]),
        )))
    start, end = (DAY * edge for edge in _edges(time))
    return [Series(title, drawing, start, end, together) for title, drawing in found]


def neighbours(count: int) -> int:
    """Return the number of neighbouring frames per point."""
    return max(-(-count // MOST_POINTS), 1)


def thin(columns: Columns) -> dict[str, Array]:
    """Reduce columns of numbers to at most `MOST_POINTS` rows: medians of neighbouring frames."""
    count = len(columns["stamp"])
    together = neighbours(count)
    if together == 1:
        return dict(columns)
    found = {}
    for name, values in columns.items():
        if values.dtype != np.float64:
            continue
        padded = np.full(-(-count // together) * together, np.nan)
        padded[:count] = values
        groups = np.sort(padded.reshape(-1, together), axis=1)
        known = np.isfinite(groups).sum(axis=1)
        middle = groups[np.arange(len(groups)), np.maximum(known - 1, 0) // 2]
        found[name] = np.where(known > 0, middle, np.nan)
    return found


def clock_axis(axes: Any, narrow: bool) -> None:
    """Format a time axis as time of day (UTC), with the date once."""
    locator = matplotlib.dates.AutoDateLocator(
        minticks=2, maxticks=5 if narrow else 9, tz="UTC")
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(_ClockFormatter(
        locator, tz="UTC", formats=CLOCK, zero_formats=CLOCK, offset_formats=DATES))
    axes.set_xlabel("time (UTC)")


class _ClockFormatter(matplotlib.dates.ConciseDateFormatter):
    """Times without a label where the edge of the drawing would cut it off, as in zoom.js.

    As there, the date is that of the first and of the last time.
    """

    first = ""

    def format_ticks(self, values: Sequence[float]) -> list[str]:
        axes: Any = self.axis.axes
        letter = axes.figure.dpi / 72.0 * LETTER * matplotlib.rcParams["font.size"]
        places = axes.get_xaxis_transform().transform([(value, 0.0) for value in values])[:, 0]
        self.first = ""
        if len(values):
            self.first = f"{matplotlib.dates.num2date(values[0], tz='UTC'):%Y-%m-%d}"
        return [
            label if place + letter * len(label) / 2.0 < axes.figure.bbox.width else ""
            for place, label in zip(places, super().format_ticks(values), strict=True)
        ]

    def get_offset(self) -> str:
        last: str = super().get_offset()
        if len(last) != len(self.first) or last == self.first:
            return last
        # Without the second year, so that narrow drawings have room for it.
        return f"{self.first} to {last[5:]}"


class _Panel(NamedTuple):
    """Drawing of a quantity over time, in days, from thinned columns; names of the recordings."""

    time: Array
    columns: Columns
    quantity: Quantity
    recordings: Sequence[str]
    together: int

    def paint(self, figure: Figure, narrow: bool) -> list[Spot]:
        """Draw the quantity; returns the texts of its points."""
        axes: Any = figure.subplots()
        time, columns, quantity = self.time, self.columns, self.quantity
        name = quantity.name
        value, stddev = columns[name], columns[f"{name}_stddev"]
        filtered, band = columns[f"filtered_{name}"], columns[f"filtered_{name}_stddev"]
        axes.errorbar(
            time, value, stddev, fmt="o", markersize=_marker(len(time)), color=ESTIMATE,
            elinewidth=0.7, alpha=0.75, linewidth=0.0, label="single frames, ± 1 σ", zorder=2,
        )
        if np.isfinite(filtered).any():
            x, middle, spread = _with_gaps(time, filtered, band)
            axes.fill_between(
                x, middle - spread, middle + spread, color=FILTERED, alpha=0.25, linewidth=0.0,
                zorder=1)
            axes.plot(x, middle, color=FILTERED, linewidth=1.6, label="filtered, ± 1 σ", zorder=3)
        sensor = columns["sensor_depth"] if name == "depth" else None
        if sensor is not None and np.isfinite(sensor).any():
            x, depth, _ = _with_gaps(time, sensor, sensor)
            axes.plot(x, depth, color=SENSOR, linewidth=1.6, linestyle="--", label="depth sensor",
                      zorder=4)
        axes.set_ylim(*_limits(((value, stddev), (filtered, band)), filtered, sensor))
        if name == "depth":
            axes.invert_yaxis()
        if not (np.isfinite(value).any() or np.isfinite(filtered).any()):
            axes.text(
                0.5, 0.5, "not assessable", transform=axes.transAxes, ha="center", va="center")
        _finish(axes, time, narrow, f"{quantity.short} [{quantity.unit}]")
        self._name_recordings(axes)
        return self._spots(axes)

    def _name_recordings(self, axes: Any) -> None:
        """Mark the beginning of each of several recordings, with its name above the points."""
        bottom, top = axes.get_ylim()
        if 0 < len(self.recordings) <= MOST_NAMES:
            axes.set_ylim(bottom, top + 0.2 * (top - bottom))
        for place, name in enumerate(self.recordings):
            frames = np.flatnonzero(self.columns["recording"] == place)
            if not frames.size:
                continue
            begin = float(self.time[frames[0]])
            axes.axvline(begin, color=HOLLOW, linewidth=0.8, linestyle=":", zorder=0)
            if len(self.recordings) <= MOST_NAMES:
                # Names alternate between two lines. Folder names may contain a dollar sign.
                axes.annotate(
                    printable(name), (begin, 1.0), xycoords=("data", "axes fraction"),
                    xytext=(3.0, -9.0 - 10.0 * (place % 2)), textcoords="offset points",
                    fontsize="small", zorder=5, parse_math=False)

    def _spots(self, axes: Any) -> list[Spot]:
        """Return a strip around each point."""
        time = self.time
        if np.any(np.diff(time) <= 0.0):
            return []
        low, high = axes.get_xlim()
        edges = np.concatenate(([low], (time[1:] + time[:-1]) / 2.0, [high]))
        return [
            Spot(axes, float(left), float(right), self._spot_text(index))
            for index, (left, right) in enumerate(itertools.pairwise(edges))
        ]

    def _spot_text(self, index: int) -> str:
        columns, quantity = self.columns, self.quantity
        moment = matplotlib.dates.num2date(columns["stamp"][index] / DAY)
        name = f"{self.recordings[int(columns['recording'][index])]}, " if self.recordings else ""
        what = "frame" if self.together == 1 else f"median of {self.together} frames about"
        parts = [f"{name}{what} {columns['frame'][index]:.0f}, {moment:%H:%M:%S} UTC"]
        for prefix, title in (("", "single frame"), ("filtered_", "filtered")):
            value = float(columns[f"{prefix}{quantity.name}"][index])
            spread = float(columns[f"{prefix}{quantity.name}_stddev"][index])
            if np.isfinite(value):
                parts.append(f"{title} {rounded(value, spread)} {quantity.unit}")
        if len(parts) == 1:
            parts.append("not assessable")
        sensor = float(columns["sensor_depth"][index])
        if quantity.name == "depth" and np.isfinite(sensor):
            parts.append(f"sensor {number(sensor)} m")
        return "; ".join(parts)


def _paint_nis(figure: Figure, time: Array, nis: Array) -> list[Spot]:
    axes: Any = figure.subplots()
    axes.semilogy(time, np.maximum(nis, LEAST_NIS), "o", markersize=_marker(len(time)),
                  color=ESTIMATE, label="ν²/S")
    axes.axhline(3.841, color=FILTERED, linewidth=1.2, linestyle="--", label="95 % of χ²")
    axes.set_ylim(LEAST_NIS / 2.0, max(20.0, 2.0 * float(np.nanmax(nis))))
    # Plain numbers: mathtext takes a fifth of the drawing time.
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_locator(matplotlib.ticker.NullLocator())
    _finish(axes, time, figure.get_figwidth() < 6.0, "ν²/S")
    return []


def _marker(points: int) -> float:
    """Return the size of markers, in 1/72 in: larger for few points."""
    return 4.5 if points <= 100 else 2.6


def _finish(axes: Any, time: Array, narrow: bool, label: str) -> None:
    width, height = axes.figure.get_size_inches()
    left, right, below, above = MARGINS
    axes.figure.subplots_adjust(
        left / width, below / height, 1.0 - right / width, 1.0 - above / height)
    axes.set_xlim(*_edges(time))
    axes.set_ylabel(label)
    axes.grid(color=RULE, linewidth=0.6)
    axes.set_axisbelow(True)
    clock_axis(axes, narrow)
    # Above the axes, where the legend covers no data.
    if axes.get_legend_handles_labels()[1]:
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, fontsize="small",
            frameon=False, columnspacing=1.0, handletextpad=0.4, borderaxespad=0.2,
        )


def _edges(time: Array) -> tuple[float, float]:
    """Return the ends of the time axis, days."""
    low, high = float(np.min(time)), float(np.max(time))
    margin = 0.02 * (high - low) or 1.0 / DAY
    return low - margin, high + margin


def _with_gaps(time: Array, value: Array, stddev: Array) -> tuple[Array, Array, Array]:
    """Break a line also where frames are missing, not only values."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if steps.size else 0.0
    holes = np.flatnonzero((steps > LONGEST_STEP * usual) | (steps < 0.0)) + 1
    return tuple(  # type: ignore[return-value]
        np.insert(column, holes, fill)
        for column, fill in ((time, time[holes - 1]), (value, np.nan), (stddev, np.nan))
    )


def _described(columns: Columns, quantity: Quantity) -> str:
    """Return the description of a figure for screen readers."""
    parts = []
    for prefix, title in (("", "single frames"), ("filtered_", "filtered over frames")):
        values = columns[f"{prefix}{quantity.name}"]
        known = values[np.isfinite(values)]
        if known.size:
            low, middle, high = (number(float(v)) for v in np.percentile(known, (0, 50, 100)))
            parts.append(
                f"{title}: {known.size} of {len(values)} known, from {low} to {high} "
                f"{quantity.unit}, median {middle}"
            )
    return "; ".join(parts) or "not assessable in any frame"


def _limits(bands: Sequence[tuple[Array, Array]], *lines: Array | None) -> tuple[float, float]:
    """Return axis limits for bands ± σ and lines, without outliers."""
    lows, highs, least = [], [], []
    for value, stddev in bands:
        known = np.isfinite(value)
        if known.any():
            spread = np.nan_to_num(stddev[known])
            # Limits the effect of very wide bands.
            spread = np.minimum(spread, 3.0 * float(np.median(spread)))
            lows.append(float(np.percentile(value[known] - spread, 2.0)))
            highs.append(float(np.percentile(value[known] + spread, 98.0)))
            least.append(float(np.min(value[known])))
    for line in lines:
        if line is not None and np.isfinite(line).any():
            lows.append(float(np.nanmin(line)))
            highs.append(float(np.nanmax(line)))
    if not lows:
        return 0.0, 1.0
    low, high = min(lows), max(highs)
    margin = 0.08 * (high - low) + 1e-3
    low, high = low - margin, high + margin
    # Bands of non-negative quantities may be negative.
    return (max(low, 0.0) if min(least, default=low) >= 0.0 else low), high
