# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Map of one or several replays: tracks of the camera, coloured by visibility or attenuation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from uw_visibility.errors import printable
from uw_visibility.images.arrays import Array
from uw_visibility.replay.inputs.sensors import EARTH_RADIUS, wrap_longitude
from uw_visibility.replay.report.figures import MOST_NAMES, thin
from uw_visibility.replay.report.sentences import amount, number
from uw_visibility.replay.report.svg import HOLLOW, INK, NARROW, RULE, WIDE, Spot, draw
from uw_visibility.replay.table import Columns

COLOURED = {
    "visibility_distance": "visibility distance [m]",
    "mean_attenuation": "mean attenuation α [1/m]",
}
LARGEST_HEIGHT = 6.0
# Cosine of 89.4 degrees of latitude.
LEAST_COSINE = 0.01
# Ends closer to the start than this share of the map have no marker and no label.
LABELLED = 0.08
# Length of the sides of the map of a single place, m.
PLACE = 10.0
# Most names in the label of tracks that start at the same place.
NAMED = 3
METRES_PER_DEGREE = math.radians(EARTH_RADIUS)


class _Track(NamedTuple):
    """Known positions of a recording, with the values there."""

    name: str
    x: Array
    y: Array
    seen: Array


class _LongitudeFormatter(ScalarFormatter):
    """Formatter of longitudes that are continued across the date line."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return super().__call__(wrap_longitude(x), pos)


def draw_tracks(recordings: Mapping[str, Columns]) -> list[Markup]:
    """Draw the positions of frames, coloured by visibility and by attenuation.

    recordings: columns of the tables, by name of the recording.
    Returns a map for each quantity that is known in a frame; one map without colours if none is
    known; nothing if no frame has a position. If only some recordings have longitude and latitude,
    only those are drawn.
    """
    geographic = any(np.isfinite(c["longitude"]).any() for c in recordings.values())
    names = ("longitude", "latitude") if geographic else ("x", "y")
    known = [
        name for name in COLOURED
        if any(np.isfinite(columns[name]).any() for columns in recordings.values())
    ]
    maps = []
    for quantity in known or ["visibility_distance"]:
        tracks = [
            track for name, columns in recordings.items()
            if (track := _track(name, columns, names, quantity)).x.size
        ]
        if tracks:
            maps.append(_draw(tracks, quantity, geographic))
    return maps


def _track(name: str, columns: Columns, names: tuple[str, str], quantity: str) -> _Track:
    columns = thin({each: columns[each] for each in ("stamp", *names, quantity)})
    x, y = (columns[axis] for axis in names)
    known = np.isfinite(x) & np.isfinite(y)
    return _Track(name, x[known], y[known], columns[quantity][known])


def _draw(tracks: list[_Track], quantity: str, geographic: bool) -> Markup:
    if geographic:
        # Longitudes are continued across the date line.
        first = float(tracks[0].x[0])
        tracks = [
            track._replace(x=first + (track.x - first + 180.0) % 360.0 - 180.0)
            for track in tracks]
    x, y = (np.concatenate([getattr(track, axis) for track in tracks]) for axis in "xy")
    # Avoids a zero length at the poles.
    along = max(math.cos(math.radians(float(np.mean(y)))), LEAST_COSINE)
    metres = (METRES_PER_DEGREE * along, METRES_PER_DEGREE) if geographic else (1.0, 1.0)
    extent = float(np.ptp(x)) * metres[0], float(np.ptp(y)) * metres[1]
    values = np.concatenate([track.seen for track in tracks])
    limits = (float(np.nanmin(values)), float(np.nanmax(values))) if np.isfinite(
        values).any() else (0.0, 1.0)
    label = COLOURED[quantity]

    def paint(figure: Figure, narrow: bool) -> list[Spot]:
        figure.set_layout_engine("constrained")
        axes: Any = figure.subplots()
        points = None
        starts, ends = _labels(tracks, metres, LABELLED * max(extent))
        for track, start, end in zip(tracks, starts, ends, strict=True):
            points = _paint_track(axes, track, limits, start, end) or points
        if points is not None:
            figure.colorbar(
                points, ax=axes, label=label, pad=0.02, shrink=0.9, aspect=30,
                location="bottom" if narrow else "right")
        axes.set_aspect(metres[1] / metres[0], adjustable="datalim")
        axes.margins(0.12)
        if max(extent) == 0.0:
            # By itself the axis would span degrees.
            axes.set_xlim(x[0] - PLACE / 2.0 / metres[0], x[0] + PLACE / 2.0 / metres[0])
            axes.set_ylim(y[0] - PLACE / 2.0 / metres[1], y[0] + PLACE / 2.0 / metres[1])
        if geographic:
            axes.xaxis.set_major_formatter(_LongitudeFormatter())
        axes.ticklabel_format(useOffset=False, style="plain")
        axes.locator_params(nbins=2 if narrow else 4)
        axes.set(xlabel="longitude [°]" if geographic else "x [m]",
                 ylabel="latitude [°]" if geographic else "y [m]")
        axes.grid(color=RULE, linewidth=0.6)
        axes.set_axisbelow(True)
        figure.draw_without_rendering()
        _scale_bar(axes, metres[0])
        return []

    what = label.partition(" [")[0]
    return draw(
        f"map-{quantity.replace('_', '-')}", f"Map of {what}",
        f"{amount(len(tracks), 'track')} over {number(extent[0], 2)} m by "
        f"{number(extent[1], 2)} m; {what} from {number(limits[0])} to {number(limits[1])}.",
        _height(*extent, WIDE), paint, _height(*extent, NARROW) + 0.8,
    )


def _labels(
    tracks: list[_Track], metres: tuple[float, float], near: float
) -> tuple[list[str], list[str | None]]:
    """Return labels of starts and ends; starts within `near`, m, of one another have one label.

    An end near its start has no label and no marker.
    """
    if len(tracks) > MOST_NAMES:
        return [""] * len(tracks), [""] * len(tracks)
    places = [np.column_stack([t.x[[0, -1]], t.y[[0, -1]]]) * metres for t in tracks]
    names: dict[int, list[str]] = {}
    for index, (track, place) in enumerate(zip(tracks, places, strict=True)):
        first = next(
            (k for k in names if math.dist(places[k][0], place[0]) <= near), index)
        names.setdefault(first, []).append(track.name)
    starts = [_start(names.get(index, [])) for index in range(len(tracks))]
    return starts, ["end" if math.dist(*place) > near else None for place in places]


def _start(names: list[str]) -> str:
    """Return the label of the start of tracks; empty without tracks."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{more} start".strip() if names else ""


def _paint_track(
    axes: Any, track: _Track, limits: tuple[float, float], start: str, end: str | None
) -> Any:
    """Draw a track with labels at its ends; returns its coloured points, if any."""
    axes.plot(track.x, track.y, color=HOLLOW, linewidth=0.8, zorder=1)
    seen = np.isfinite(track.seen)
    axes.scatter(track.x[~seen], track.y[~seen], s=22, facecolors="none", edgecolors=HOLLOW,
                 linewidths=0.9, zorder=2)
    points = None
    if seen.any():
        points = axes.scatter(
            track.x[seen], track.y[seen], s=22, c=track.seen[seen], cmap="viridis", zorder=3,
            edgecolors=HOLLOW, linewidths=0.3, vmin=limits[0], vmax=limits[1])
    for place, marker, label in ((0, "^", start), (-1, "s", end)):
        if label is None:
            continue
        axes.plot(track.x[place], track.y[place], marker=marker, markersize=12, zorder=4,
                  markerfacecolor="none", markeredgecolor=INK, markeredgewidth=1.4, linewidth=0.0)
        if label:
            # Folder names may contain a dollar sign.
            axes.annotate(
                printable(label), (track.x[place], track.y[place]), xytext=(7, 5),
                textcoords="offset points", fontsize="small", zorder=5, parse_math=False)
    return points


def _scale_bar(axes: Any, metres: float) -> None:
    """Draw a scale bar of a round length at the lower left; `metres` per unit of x."""
    low, high = axes.get_xlim()
    length = round_length(0.3 * (high - low) * metres)
    share = length / metres / (high - low)
    axes.plot((0.04, 0.04 + share), (0.05, 0.05), transform=axes.transAxes, color=INK,
              linewidth=2.5, solid_capstyle="butt", zorder=6)
    text = f"{length / 1000:g} km" if length >= 1000.0 else f"{length:g} m"
    axes.text(0.04, 0.07, text, transform=axes.transAxes, fontsize="small", zorder=6)


def round_length(longest: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten up to `longest`."""
    power = 10.0 ** math.floor(math.log10(longest))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= longest * (1.0 + 1e-9))


def _height(wide: float, high: float, width: float) -> float:
    """Return the height of a map in inches for its extent, m."""
    shape = high / wide if wide > 0.0 else 1.0
    return min(max(0.85 * width * shape + 0.8, 2.8), min(LARGEST_HEIGHT, 1.1 * width))
