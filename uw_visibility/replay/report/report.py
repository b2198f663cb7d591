# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Report of a replay: one self-contained HTML page."""

from __future__ import annotations

import base64
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import jinja2
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from uw_visibility.config.parameters import flatten
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.errors import LONGEST_MESSAGE, printable
from uw_visibility.images.arrays import Array, Image8
from uw_visibility.optics.visual_range import BEAM_OVER_SEEN, BEAM_OVER_SEEN_DEVIATION
from uw_visibility.replay.columns import COLUMNS
from uw_visibility.replay.inputs.sensors import ScalarTopic
from uw_visibility.replay.line_fit import FEWEST, LineFit, fit_line
from uw_visibility.replay.report import figures
from uw_visibility.replay.report.figures import draw_series
from uw_visibility.replay.report.gallery import Gallery, gradient
from uw_visibility.replay.report.meaning import meaning
from uw_visibility.replay.report.sentences import (
    Frame,
    definition,
    formula,
    headline,
    number,
    percentage,
    rounded,
    verdict,
)
from uw_visibility.replay.report.svg import ESTIMATE, FILTERED, RULE, Spot, draw, variables
from uw_visibility.replay.report.track import draw_tracks
from uw_visibility.replay.results.summary import (
    OTHER_CHANNELS,
    STATUS_COLUMNS,
    WHOLE_FRAME,
    Refusal,
    Summary,
)
from uw_visibility.replay.table import Columns
from uw_visibility.water.meaning.derived import QUANTITIES

EVENLY_SPACED = 5
# Width of each image, px.
VIEW_WIDTH = 400
TOPIC_TITLES = {"depth": "depth sensor", "left_info": "left camera_info",
                "right_info": "right camera_info"}


def write_report(
    folder: Path, columns: Columns, gallery: Gallery, summary: Summary,
    joins: Sequence[Mapping[str, Any]] = (),
) -> None:
    """Write ``report.html`` to the folder of a result.

    columns: table of the result, as `read_table` returns it.
    joins: sections from `fit_joins`.
    """
    contrast = float(summary.provenance["parameters"]["assessment.contrast"])
    shown: list[dict[str, Any]] = [
        {
            "frame": picture.frame,
            "views": [_view(what, image) for what, image in picture.parts().items()],
            "caption": picture.caption,
        }
        for picture in gallery.pictures(_representative(columns, summary))
    ]
    linked = [picture["frame"] for picture in shown]
    write_page(
        folder / "report.html", "report.html",
        sentences=[[_part(part, linked) for part in parts] for parts in verdict(summary)],
        definition=definition(contrast), formula=formula(contrast),
        title=f"Visibility: {Path(summary.bag).name}",
        summary=summary,
        problems=summary.lacks + summary.damage,
        series=draw_series(columns),
        maps=draw_tracks({"": columns}),
        quantities=quantities(columns, summary, formula(contrast)),
        joins=joins,
        pictures=shown,
        scale=gallery.scale, gradient=gradient(),
        refusals=summary.refusals, meaning=_meaning,
        other_channels=any(OTHER_CHANNELS in refusal.what for refusal in summary.refusals),
        verdicts=[
            (COLUMNS["plausibility"].meaning(name), count)
            for name, count in summary.counts["plausibility"].most_common()],
        source=_source(summary),
        parameters=_parameters(summary),
    )


def _view(what: str, image: Image8) -> dict[str, Any]:
    width = min(VIEW_WIDTH, image.shape[1])
    height = round(image.shape[0] * width / image.shape[1])
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    _, png = cv2.imencode(".png", cv2.cvtColor(small, cv2.COLOR_RGB2BGR))
    source = Markup(f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}")
    return {"what": what, "source": source, "width": width, "height": height}


def _representative(columns: Columns, summary: Summary) -> set[int]:
    """Choose frames: evenly spaced ones, the worst and the best, and one per refusal."""
    usable = columns["reason"] == ""
    frames = columns["frame"][usable].astype(int)
    if not frames.size:
        return set()
    spaced = np.linspace(0, len(frames) - 1, EVENLY_SPACED).round().astype(int)
    chosen = set(frames[spaced].tolist())
    for parts in verdict(summary):
        chosen |= {part.number for part in parts if isinstance(part, Frame)}
    for name in STATUS_COLUMNS.values():
        statuses, first = np.unique(columns[name][usable].astype(str), return_index=True)
        chosen |= set(frames[first[statuses != "ok"]].tolist())
    return chosen


def _meaning(refusal: Refusal) -> str:
    return "No result." if refusal.what == WHOLE_FRAME else meaning(refusal.why)


def _source(summary: Summary) -> list[tuple[str, str]]:
    provenance = summary.provenance
    rows = [("recording", summary.bag), ("SHA-256", provenance["input_sha256"])]
    rows += [(TOPIC_TITLES.get(name, name), topic) for name, topic in summary.topics.items()]
    rows += [("chosen", note) for note in summary.notes]
    rows.append(("uw_visibility", provenance["version"]))
    return rows


def _parameters(summary: Summary) -> list[dict[str, Any]]:
    defaults = {**PipelineConfig().to_parameters(), **flatten(NodeConfig())}
    plain = {k: list(v) if isinstance(v, tuple) else v for k, v in defaults.items()}
    return [
        {"name": name, "value": value, "changed": name in plain and plain[name] != value}
        for name, value in summary.provenance["parameters"].items()
    ]


MATCHED = ("matched_fraction", "matched_fraction_original")
MEASURED = {
    "mean_attenuation": ("mean attenuation α", "1/m", "beyond that of clear water"),
    "depth": ("depth", "m", "by the colour of daylight"),
}


def _part(part: str | Frame, linked: Collection[int]) -> str | dict[str, str]:
    """Return a part of a sentence, as link for a frame with a picture on the page."""
    if isinstance(part, Frame) and part.number in linked:
        return {"text": str(part), "href": f"#frame-{part.number}"}
    return str(part)


def quantities(columns: Columns, summary: Summary, short: str) -> list[dict[str, str]]:
    """Return the rows of the table of quantities: those of the verdict, then others.

    short: formula of visibility distance.
    """
    typical = {} if summary.synopsis is None else summary.synopsis.typical
    rows = [
        {"title": each.title, "value": each.value, "what": each.what}
        | (QUANTITIES[each.name]._asdict() if each.name in QUANTITIES else {})
        for each in headline(typical, f"{short} of the clearest channel")]
    for name, (title, unit, what) in MEASURED.items():
        known = columns[name][np.isfinite(columns[name])]
        if known.size:
            low, middle, high = (float(v) for v in np.percentile(known, [5.0, 50.0, 95.0]))
            spread = float(np.nanmedian(columns[f"{name}_stddev"]))
            extent = _extent(known.size, len(columns[name]), low, high, unit)
            rows.append({
                "title": title, "value": f"{rounded(middle, spread)} {unit}",
                "what": f"{what}; {extent}"})
    enhanced, original = (columns[name][np.isfinite(columns[name])] for name in MATCHED)
    if original.size:
        recorded = percentage(float(np.median(original)))
        rows.append({
            "title": "matched", "value": percentage(float(np.median(enhanced))),
            "what": f"part of the left image, median; {recorded} without restoration"})
    return rows + _water_type(summary)


def _extent(known: int, frames: int, low: float, high: float, unit: str) -> str:
    """Return as text in how many frames a quantity is known, and its 90 % range."""
    if known == 1 < frames:
        return f"in 1 of {frames} frames"
    median = "median" if known == frames else f"median of {known} of {frames} frames"
    of_them = "the frames" if known == frames else "them"
    return f"{median}, {number(low)} to {number(high)} {unit} in 90 % of {of_them}"


def _water_type(summary: Summary) -> list[dict[str, str]]:
    """Return the nearest Jerlov type of most frames, as rows of the table."""
    types = summary.counts["filtered_water_type"] or summary.counts["water_type"]
    frames = ", ".join(f"{name} ({count})" for name, count in sorted(types.items()))
    return [{
        "title": "nearest Jerlov type", "value": name,
        "what": "most likely water type by beam attenuation as seen by this camera; "
        f"frames: {frames}",
        "caveat": "Types are defined by Kd; particles shift them by a type or more.",
        "source": "Williamson and Hollins 2022, doi:10.1364/AO.470464; Solonenko and Mobley 2015, "
        "doi:10.1364/AO.54.005392",
    } for name, _ in types.most_common(1)]


def write_page(path: Path, template: str, **values: Any) -> None:
    """Write a page by its template; text is escaped, without control characters."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uw_visibility.replay.report"), autoescape=True,
        trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined, finalize=_shown,
    )
    text = environment.get_template(template).render(
        **values, colours_light=Markup(variables(dark=False)),
        colours_dark=Markup(variables(dark=True)),
    )
    path.write_text(text, encoding="utf-8")


def _shown(value: Any) -> Any:
    """Value for the page: text from outside without control characters."""
    own = isinstance(value, Markup) or not isinstance(value, str)
    return value if own else printable(value, LONGEST_MESSAGE)


AGAINST = "beam_attenuation"
"""Column to which joined topics are compared."""


def fit_joins(
    folder: Path, table: Columns, joins: Sequence[ScalarTopic]
) -> list[dict[str, Any]]:
    """Fit each joined topic over the beam attenuation; writes ``fit_TOPIC.json``."""
    sections = []
    for join in joins:
        x, x_stddev, y = table[AGAINST], table[f"{AGAINST}_stddev"], table[join.column]
        fit = fit_line(x, x_stddev, y, str(join), AGAINST)
        both = int(np.count_nonzero(np.isfinite(x) & np.isfinite(y)))
        if fit is not None:
            fit.write(folder / f"fit_{join.column.removeprefix('joined_')}.json")
        sections.append({
            "title": str(join), "text": _sentence(fit, both, y, join.unit),
            "figure": _draw(table, join, fit) if both else "",
        })
    return sections


def _sentence(fit: LineFit | None, both: int, values: Array, unit: str) -> str:
    known = int(np.count_nonzero(np.isfinite(values)))
    if fit is None:
        return (
            f"{known} of {len(values)} frames have a value, {both} of them with an estimate: "
            f"too few or too similar for a fit, which needs {FEWEST} different ones."
        )
    left = f"{fit.residual_stddev:.2g} beyond" if fit.residual_stddev else "within"
    name = f"{fit.source} [{unit}]" if unit else fit.source
    return (
        f"{name} = ({fit.intercept:.3g} ± {fit.intercept_stddev:.2g}) + "
        f"({fit.slope:.3g} ± {fit.slope_stddev:.2g}) m · beam attenuation, over {fit.frames} "
        f"frames from {fit.low:.3g} to {fit.high:.3g} 1/m; correlation {fit.correlation:.2f}. The "
        f"residuals are {left} the standard deviations of the estimates. Beam attenuation is as "
        f"seen by the camera: a transmissometer reads {BEAM_OVER_SEEN:g} times "
        f"as much, within a factor of {np.exp(BEAM_OVER_SEEN_DEVIATION):.2g}."
    )


def _draw(columns: Columns, join: ScalarTopic, fit: LineFit | None) -> Markup:
    name, title = join.column, str(join)
    unit = f" [{join.unit}]" if join.unit else ""
    both = np.isfinite(columns[AGAINST]) & np.isfinite(columns[name])
    known = {key: values[both] for key, values in columns.items()}
    chosen = figures.thin(known)
    x, x_stddev, y = chosen[AGAINST], chosen[f"{AGAINST}_stddev"], chosen[name]

    def paint(figure: Figure, narrow: bool) -> list[Spot]:
        figure.set_layout_engine("constrained")
        scatter, residuals = figure.subplots(*((2, 1) if narrow else (1, 2)))
        scatter.errorbar(
            x, y, xerr=x_stddev, fmt=".", color=ESTIMATE, elinewidth=0.6, alpha=0.6,
            label="frames")
        scatter.set(xlabel="beam attenuation, green [1/m]", ylabel=f"{title}{unit}")
        residuals.set_ylabel(f"{title} minus fit{unit}")
        if fit is None:
            residuals.text(0.5, 0.5, "no fit", transform=residuals.transAxes, ha="center")
            residuals.set_axis_off()
        else:
            _draw_fit(scatter, fit)
            residuals.errorbar(
                chosen["stamp"] / figures.DAY, y - fit.intercept - fit.slope * x,
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
