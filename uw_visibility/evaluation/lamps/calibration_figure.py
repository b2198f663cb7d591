# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Figure of a calibration of lamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uw_visibility.evaluation.figures.style import INPUT, OURS, save
from uw_visibility.water.lamp_calibration import LampCalibration

ARROW = 0.3


def draw_calibration(path: Path, found: LampCalibration) -> None:
    """Draw where lamps are, from above and from behind, and what of the light is explained."""
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    behind, above, light = figure.subplots(1, 3)
    for axes, (i, j), label in ((behind, (0, 1), "down"), (above, (0, 2), "forward")):
        axes.plot(0, 0, "s", color="black")
        axes.annotate("left camera", (0, 0), (4, 6), textcoords="offset points", fontsize=8)
        for k, (lamp, stddev) in enumerate(zip(found.lamps, found.position_stddev, strict=True)):
            place, axis = np.array(lamp.position), np.array(lamp.direction)
            axes.errorbar(place[i], place[j], stddev[j], stddev[i], "o", color=OURS, capsize=3)
            axes.annotate(
                "", (place[i] + ARROW * axis[i], place[j] + ARROW * axis[j]), (place[i], place[j]),
                arrowprops={"arrowstyle": "->", "color": OURS})
            axes.annotate(f"lamp {k + 1}", place[[i, j]], (5, -12), textcoords="offset points")
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.3)
        axes.set_xlabel("right [m]")
        axes.set_ylabel(f"{label} [m]")
        axes.grid(alpha=0.25)
    behind.invert_yaxis()
    behind.set_title("as the camera looks, ± 1 σ")
    above.set_title("from above")
    for values, colour, label in (
        (found.before, INPUT, "lamps as guessed"), (found.after, OURS, "lamps as found"),
    ):
        departure = 100.0 * np.expm1(np.abs(values[:, 1]))
        edges = np.quantile(found.range, np.linspace(0.0, 1.0, 13))
        place = np.clip(np.searchsorted(edges, found.range) - 1, 0, 11)
        light.plot(
            0.5 * (edges[1:] + edges[:-1]),
            [np.median(departure[place == k]) if (place == k).any() else np.nan
             for k in range(12)],
            "o-", color=colour, label=label)
    light.set_xlabel("range [m]")
    light.set_ylabel("median departure [%]")
    light.set_title("light of a point, over the model's")
    light.set_ylim(bottom=0.0)
    light.grid(alpha=0.25)
    light.legend(frameon=False)
    save(figure, path)
