# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Map of a replay: track of the camera in the colour of visibility distance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.replay.report.figures import MOST_POINTS, Columns, draw

TRACK_COLUMNS = ("longitude", "latitude", "x", "y", "visibility_distance")
WIDTH, LARGEST_HEIGHT = 10.8, 7.0


def draw_track(columns: Columns) -> str:
    """Draw the positions of frames, in the colour of their visibility distance.

    Parameters
    ----------
    columns : mapping of str to ndarray, (n,) float64
        Those of `TRACK_COLUMNS`; NaN for what is not known.

    Returns
    -------
    str
        A piece of HTML; empty where no frame has a position.
    """
    x, y, labels = columns["longitude"], columns["latitude"], ("longitude [°]", "latitude [°]")
    stretch = 1.0
    if np.isfinite(x).any():
        stretch = 1.0 / math.cos(math.radians(float(np.nanmean(y))))
    else:
        x, y, labels = columns["x"], columns["y"], ("x [m]", "y [m]")
    known = np.isfinite(x) & np.isfinite(y)
    if not known.any():
        return ""
    figure = Figure(figsize=(WIDTH, _height(x[known], stretch * y[known])), layout="constrained")
    axes = figure.subplots()
    axes.plot(x[known], y[known], color="#8c959f", linewidth=0.8, zorder=1)
    _scatter(figure, axes, x[known], y[known], columns["visibility_distance"][known])
    axes.set_aspect(stretch, adjustable="datalim")
    axes.ticklabel_format(useOffset=False)
    axes.locator_params(axis="x", nbins=6)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.grid(alpha=0.3)
    return draw(figure, len(x) <= MOST_POINTS, "track")


def _scatter(figure: Figure, axes: Any, x: Any, y: Any, distance: Any) -> None:
    seen = np.isfinite(distance)
    axes.scatter(
        x[~seen], y[~seen], s=28, facecolors="none", edgecolors="#57606a", linewidths=0.9, zorder=2
    )
    if seen.any():
        points = axes.scatter(
            x[seen], y[seen], s=28, c=distance[seen], cmap="viridis", zorder=3
        )
        figure.colorbar(points, ax=axes, label="visibility distance [m]", pad=0.01)


def _height(x: Any, y: Any) -> float:
    """Return a height in inches for the track's shape."""
    wide, high = float(np.ptp(x)), float(np.ptp(y))
    shape = high / wide if wide > 0.0 else 1.0
    return min(max(WIDTH * shape + 1.0, 3.0), LARGEST_HEIGHT)
