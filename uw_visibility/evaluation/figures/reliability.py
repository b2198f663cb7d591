# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reliability diagram of the matcher's confidence."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure

from uw_visibility.evaluation.figures.style import TRUTH_STYLE, save
from uw_visibility.evaluation.noise_axis import title_of
from uw_visibility.evaluation.reliability import Reliability

# Okabe and Ito's colours.
COLOURS = ("#000000", "#0072b2", "#009e73", "#e69f00", "#d55e00", "#cc79a7")


def draw_reliability(path: Path, by_noise: Mapping[str, Reliability]) -> None:
    """Draw the share of right disparities over confidence, and how many have which.

    Parameters
    ----------
    path : Path
        PNG file to write.
    by_noise : dict of str to Reliability
        By noise of the sensor, see `sensor_of`.
    """
    figure = Figure(figsize=(6.4, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot((0, 1), (0, 1), **{**TRUTH_STYLE, "label": "calibrated"})
    for k, (noise, reliability) in enumerate(by_noise.items()):
        rows = reliability.rows()
        x = [row["confidence"] for row in rows]
        label = f"{title_of(noise)}: off by {reliability.expected_error:.3f}"
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
