# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Report of a replay: one page of HTML without anything from elsewhere."""

from __future__ import annotations

import base64
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from uw_visibility.config.parameters import flatten
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.images.arrays import Image8
from uw_visibility.replay.report.figures import NEEDED, draw_series
from uw_visibility.replay.report.gallery import ColourScale, Gallery, gradient, preview
from uw_visibility.replay.report.meaning import meaning
from uw_visibility.replay.report.overview import (
    OVERVIEW_COLUMNS,
    caption,
    contrast_of,
    derived_quantities,
    overview,
)
from uw_visibility.replay.report.page import write_page
from uw_visibility.replay.report.sentences import Frames, formula, verdict
from uw_visibility.replay.report.track import TRACK_COLUMNS, draw_tracks
from uw_visibility.replay.results.refusals import OTHER_CHANNELS, STATUS_COLUMNS, WHOLE_FRAME
from uw_visibility.replay.table import read_columns, read_rows

if TYPE_CHECKING:
    from uw_visibility.replay.results.summary import Summary

EVENLY_SPACED = 5
# Of each of a frame's three images, px.
VIEW_WIDTH = 400
TOPIC_TITLES = {"depth": "depth sensor", "left_info": "left camera_info",
                "right_info": "right camera_info"}


def write_report(
    folder: Path, gallery: Gallery, summary: Summary, joins: Sequence[Mapping[str, Any]] = ()
) -> None:
    """Write ``report.html``.

    Parameters
    ----------
    folder : Path
        Of the result, with its table.
    gallery : Gallery
        Pictures of its frames.
    summary : Summary
        What the replay did.
    joins : sequence of mapping
        Sections of the joined topics, of `fit_joins`.
    """
    columns = read_columns(
        folder / "frames.csv", [*dict.fromkeys((*NEEDED, *TRACK_COLUMNS, *OVERVIEW_COLUMNS))]
    )
    contrast = contrast_of(summary)
    shown: list[dict[str, Any]] = [
        {
            "frame": picture.row["frame"],
            "views": [_view(what, image) for what, image in picture.parts().items()],
            "caption": caption(picture.row, formula(contrast)),
        }
        for picture in gallery.pictures(_representative(folder, summary))
    ]
    write_page(
        folder / "report.html", "report.html",
        **overview(columns, summary, [picture["frame"] for picture in shown]),
        title=f"Visibility: {Path(summary.bag).name}",
        summary=summary,
        problems=summary.lacks + summary.damage,
        series=draw_series(columns),
        maps=draw_tracks({"": columns}),
        derived=derived_quantities(folder / "frames.csv"),
        joins=joins,
        pictures=shown,
        colours=_colours(gallery.scale),
        refusals=_refusals(summary),
        other_channels=summary.refusals.has(OTHER_CHANNELS),
        plausibility=_plausibility(summary),
        timings=_timings(folder / "timings.csv"),
        threads=int(summary.provenance["threads"]),
        source=_source(summary),
        parameters=_parameters(summary),
    )


def _view(what: str, image: Image8) -> dict[str, Any]:
    """Return an image for the page."""
    png, (height, width) = preview(image, VIEW_WIDTH)
    source = Markup(f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}")
    return {"what": what, "source": source, "width": width, "height": height}


def _representative(folder: Path, summary: Summary) -> set[str]:
    """Choose frames: evenly spaced ones, the worst and the best, one of each refusal."""
    rows = [
        (row["frame"], [row[c] for c in STATUS_COLUMNS.values()])
        for row in read_rows(folder / "frames.csv") if not row["reason"]
    ]
    if not rows:
        return set()
    spaced = np.unique(np.linspace(0, len(rows) - 1, EVENLY_SPACED).round().astype(int))
    chosen = {rows[index][0] for index in spaced}
    for parts in verdict(summary):
        chosen |= {str(part.frame) for part in parts if isinstance(part, Frames)}
    refused = {
        (status, place): frame for frame, statuses in reversed(rows)
        for place, status in enumerate(statuses) if status != "ok"
    }
    return chosen | set(refused.values())


def _colours(scale: ColourScale | None) -> dict[str, str] | None:
    if scale is None:
        return None
    low, high = scale.describe(scale.low), scale.describe(scale.high)
    return {"low": low, "high": high, "gradient": gradient()}


def _refusals(summary: Summary) -> list[dict[str, Any]]:
    return [
        {
            "what": refusal.what, "why": refusal.why, "count": refusal.count,
            "frames": refusal.frames,
            "meaning": "No result." if refusal.what == WHOLE_FRAME else meaning(refusal.why),
        }
        for refusal in summary.refusals.together()
    ]


def _plausibility(summary: Summary) -> dict[str, Any] | None:
    report = summary.plausibility
    if report is None:
        return None
    judged = report.compared - report.inconclusive
    text = (
        f"{report.compared} estimates compared with {summary.topics['depth']}, {judged} of them "
        f"with a gate narrow enough to prove something, {report.failed} beyond it; "
        f"{report.unmatched} without a sensor value at their stamp."
    )
    return {"text": text, "verdicts": summary.verdicts.most_common()}


def _timings(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        stages = next(csv.reader(file))[1:]
    columns = read_columns(path, stages)
    return [
        {
            "stage": stage,
            "median": f"{np.nanmedian(values):.1f}",
            "high": f"{np.nanpercentile(values, 95.0):.1f}",
        }
        for stage, values in columns.items() if np.isfinite(values).any()
    ]


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
