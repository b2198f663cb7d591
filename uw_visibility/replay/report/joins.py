# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Joined topics against the estimates: fit, scatter plot and residuals."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from uw_visibility.images.arrays import Array
from uw_visibility.replay.inputs.scalars import ScalarTopic
from uw_visibility.replay.line_fit import FEWEST, LineFit, fit_line
from uw_visibility.replay.report import figures
from uw_visibility.replay.report.figures import Columns
from uw_visibility.replay.report.svg import ESTIMATE, FILTERED, RULE, Spot, draw, fit_layout
from uw_visibility.replay.table import read_columns

AGAINST = "beam_attenuation"
"""Column that joined topics are held against."""


def fit_joins(folder: Path, joins: Sequence[ScalarTopic]) -> list[dict[str, Any]]:
    """Fit each joined topic over the beam attenuation; writes ``fit_TOPIC.json``.

    Returns
    -------
    list of dict
        For each: its title, a sentence, and a figure as HTML (empty without values).
    """
    sections = []
    for join in joins:
        columns = read_columns(
            folder / "frames.csv", ["stamp", AGAINST, f"{AGAINST}_stddev", join.column])
        x, x_stddev, y = columns[AGAINST], columns[f"{AGAINST}_stddev"], columns[join.column]
        fit = fit_line(x, x_stddev, y, str(join), AGAINST)
        both = int(np.count_nonzero(np.isfinite(x) & np.isfinite(y)))
        if fit is not None:
            fit.write(folder / f"fit_{join.column.removeprefix('joined_')}.json")
        sections.append({
            "title": str(join), "text": _sentence(fit, both, columns[join.column]),
            "figure": _draw(columns, join.column, fit, str(join)) if both else "",
        })
    return sections


def _sentence(fit: LineFit | None, both: int, values: Array) -> str:
    known = int(np.count_nonzero(np.isfinite(values)))
    if fit is None:
        return (
            f"{known} of {len(values)} frames have a value, {both} of them beside an estimate: "
            f"too few or too much alike for a fit, which needs {FEWEST} different ones."
        )
    return (
        f"{fit.source} = ({fit.intercept:.3g} ± {fit.intercept_stddev:.2g}) + "
        f"({fit.slope:.3g} ± {fit.slope_stddev:.2g}) m · beam attenuation, over {fit.frames} "
        f"frames from {fit.low:.3g} to {fit.high:.3g} 1/m; correlation {fit.correlation:.2f}. What "
        f"is left of the values is {_left(fit)}."
    )


def _left(fit: LineFit) -> str:
    if not fit.residual_stddev:
        return "within the standard deviations of the estimates"
    return f"{fit.residual_stddev:.2g} beyond the standard deviations of the estimates"


def _draw(columns: Columns, name: str, fit: LineFit | None, title: str) -> Markup:
    both = np.isfinite(columns[AGAINST]) & np.isfinite(columns[name])
    known = {key: values[both] for key, values in columns.items()}
    chosen = figures.thin(known, figures.MOST_POINTS)
    x, x_stddev, y = chosen[AGAINST], chosen[f"{AGAINST}_stddev"], chosen[name]

    def paint(figure: Figure, narrow: bool) -> list[Spot]:
        fit_layout(figure)
        scatter, residuals = figure.subplots(*((2, 1) if narrow else (1, 2)))
        scatter.errorbar(
            x, y, xerr=x_stddev, fmt=".", color=ESTIMATE, elinewidth=0.6, alpha=0.6,
            label="frames")
        scatter.set(xlabel="beam attenuation, green [1/m]", ylabel=title)
        residuals.set_ylabel(f"{title} less the fit")
        if fit is None:
            residuals.text(0.5, 0.5, "no fit", transform=residuals.transAxes, ha="center")
        else:
            _draw_fit(scatter, fit)
            residuals.errorbar(
                figures.clock_time(chosen["stamp"]), y - fit.intercept - fit.slope * x,
                abs(fit.slope) * x_stddev, fmt=".", color=ESTIMATE, elinewidth=0.6, alpha=0.6)
            residuals.axhline(0.0, color=FILTERED, linewidth=1.0)
        figures.clock_axis(residuals, narrow=True)
        scatter.legend(fontsize="small", frameon=False)
        for axes in (scatter, residuals):
            axes.yaxis.label.set_parse_math(False)
            axes.grid(color=RULE, linewidth=0.6)
        return []

    return draw(
        f"join-{re.sub('[^a-z0-9]+', '-', name.lower())}", f"{title} against beam attenuation",
        "No fit." if fit is None else f"Slope {fit.slope:.3g}, intercept {fit.intercept:.3g}.",
        3.4, paint, 6.0,
    )


def _draw_fit(axes: Any, fit: LineFit) -> None:
    line = np.linspace(fit.low, fit.high, 50)
    value, stddev = np.transpose([fit.predict(each, 0.0) for each in line])
    axes.plot(line, value, color=FILTERED, linewidth=1.4, label="fit")
    axes.fill_between(
        line, value - stddev, value + stddev, color=FILTERED, alpha=0.2, linewidth=0.0,
        label="± 1 σ")
