# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Report of a replay: one page of HTML without anything from elsewhere."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np
from markupsafe import Markup

from uw_visibility.config.parameters import flatten
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.errors import LONGEST_MESSAGE, printable
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.inputs.topics import Selection
from uw_visibility.replay.report.colours import ColourScale, gradient
from uw_visibility.replay.report.figures import NEEDED, data_uri, draw_series
from uw_visibility.replay.report.gallery import Picture, pictures, preview
from uw_visibility.replay.report.meaning import meaning
from uw_visibility.replay.report.track import TRACK_COLUMNS, draw_track
from uw_visibility.replay.results.refusals import OTHER_CHANNELS, STATUS_COLUMNS, WHOLE_FRAME
from uw_visibility.replay.table import read_columns, read_rows
from uw_visibility.water.derived import QUANTITIES

if TYPE_CHECKING:
    from uw_visibility.replay.results.summary import Summary

EVENLY_SPACED = 5
PICTURE_WIDTH = 1200
MATCHED = ("matched_fraction", "matched_fraction_original")
TOPIC_TITLES = {"depth": "depth sensor", "left_info": "left camera_info",
                "right_info": "right camera_info"}


def write_report(
    folder: Path,
    reader: BagReader,
    selection: Selection,
    scale: ColourScale | None,
    summary: Summary,
    joins: Sequence[Mapping[str, Any]] = (),
) -> None:
    """Write ``report.html``.

    Parameters
    ----------
    folder : Path
        Of the result, with its table and messages.
    reader : BagReader
        The recording, for the raw images.
    selection : Selection
        Topics used.
    scale : ColourScale or None
        Colours of the disparities.
    summary : Summary
        What the replay did.
    joins : sequence of mapping
        Sections of the joined topics, of `fit_joins`.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("uw_visibility.replay.report"), autoescape=True,
        trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined, finalize=_shown,
    )
    columns = read_columns(
        folder / "frames.csv", [*dict.fromkeys((*NEEDED, *TRACK_COLUMNS, *MATCHED))]
    )
    text = environment.get_template("report.html").render(
        title=f"Visibility: {Path(summary.bag).name}",
        subtitle=_subtitle(columns, summary),
        summary=summary,
        problems=summary.damage,
        numbers=_numbers(columns, summary),
        series=draw_series(columns) if summary.frames else "<p>There are no frames.</p>",
        track=draw_track(columns),
        derived=_derived(folder / "frames.csv"),
        joins=joins,
        pictures=[
            {
                "frame": picture.row["frame"],
                "source": Markup(data_uri(preview(picture.side_by_side(), PICTURE_WIDTH))),
                "caption": _caption(picture),
            }
            for picture in pictures(
                folder, reader, selection, scale, _representative(folder)
            )
        ],
        colours=_colours(scale),
        refusals=_refusals(summary),
        other_channels=summary.refusals.has(OTHER_CHANNELS),
        plausibility=_plausibility(summary),
        timings=_timings(folder / "timings.csv"),
        threads=_threads(summary),
        source=_source(summary),
        parameters=_parameters(summary),
    )
    (folder / "report.html").write_text(text, encoding="utf-8")


def _shown(value: Any) -> Any:
    """Value as it is shown: text from outside without control characters."""
    own = isinstance(value, Markup) or not isinstance(value, str)
    return value if own else printable(value, LONGEST_MESSAGE)


def _representative(folder: Path) -> set[str]:
    """Choose frames: evenly spaced ones, the clearest and the murkiest, one of each refusal."""
    rows = [
        (row["frame"], [row[c] for c in STATUS_COLUMNS.values()], row["visibility_distance"])
        for row in read_rows(folder / "frames.csv") if not row["reason"]
    ]
    if not rows:
        return set()
    spaced = np.unique(np.linspace(0, len(rows) - 1, EVENLY_SPACED).round().astype(int))
    chosen = {rows[index][0] for index in spaced}
    seen = sorted((float(distance), frame) for frame, _, distance in rows if distance)
    if seen:
        chosen |= {seen[0][1], seen[-1][1]}
    refused = {
        (status, place): frame for frame, statuses, _ in reversed(rows)
        for place, status in enumerate(statuses) if status != "ok"
    }
    return chosen | set(refused.values())


def _subtitle(columns: dict[str, Any], summary: Summary) -> str:
    stamps = columns["stamp"]
    if not len(stamps):
        return summary.bag
    first, last = (datetime.fromtimestamp(float(t), UTC) for t in (stamps.min(), stamps.max()))
    return f"{first:%Y-%m-%d %H:%M:%S} to {last:%Y-%m-%d %H:%M:%S} UTC, {summary.bag}"


def _numbers(columns: dict[str, Any], summary: Summary) -> list[tuple[str, str]]:
    numbers = [(str(summary.frames), "frames")]
    if summary.frames:
        share = summary.assessed / summary.frames
        numbers.append((_percent(share), "of them with the water assessed"))
    for name, unit, title in (
        ("visibility_distance", "m", "visibility distance"),
        ("mean_attenuation", "1/m", "mean attenuation α"),
        ("depth", "m", "depth by colour"),
    ):
        known = columns[name][np.isfinite(columns[name])]
        if known.size:
            low, middle, high = np.percentile(known, [5.0, 50.0, 95.0])
            numbers.append((
                f"{middle:.3g} {unit}", f"{title}, median; {low:.3g} to {high:.3g} in 90 % of them"
            ))
    enhanced, original = (columns[name][np.isfinite(columns[name])] for name in MATCHED)
    if original.size:
        numbers.append((
            _percent(float(np.median(enhanced))),
            f"matched, median; {_percent(float(np.median(original)))} of the pairs as recorded",
        ))
    return numbers


def _derived(table: Path) -> list[dict[str, str]]:
    """Return the field's quantities, derived from the filtered water where there is one."""
    columns = read_columns(
        table, [f"{prefix}{name}{end}" for prefix in ("", "filtered_") for name in QUANTITIES
                for end in ("", "_stddev")])
    rows = []
    for name, quantity in QUANTITIES.items():
        prefix = "filtered_" if np.isfinite(columns[f"filtered_{name}"]).any() else ""
        values, stddev = columns[f"{prefix}{name}"], columns[f"{prefix}{name}_stddev"]
        known = np.isfinite(values)
        if known.any():
            low, middle, high = np.percentile(values[known], [5.0, 50.0, 95.0])
            spread = float(np.median(stddev[known]))
            unit = quantity.unit.replace("m-1", "1/m")
            rows.append({
                "title": quantity.title, "median": f"{middle:.3g} ± {spread:.2g} {unit}",
                "span": f"{low:.3g} to {high:.3g} {unit}",
                "definition": quantity.definition, "caveat": quantity.caveat,
                "source": quantity.source,
            })
    return rows


def _caption(picture: Picture) -> str:
    row = picture.row
    parts = [f"Frame {row['frame']}", f"water: {row['status']}"]
    for name, title, unit, column in (
        ("visibility_distance", "visibility", "m", "visibility_status"),
        ("mean_attenuation", "α", "1/m", "status"), ("depth", "depth", "m", "depth_status"),
    ):
        if row[name]:
            band = f" ± {float(row[name + '_stddev']):.2g}" if row[name + "_stddev"] else ""
            parts.append(f"{title} {float(row[name]):.3g}{band} {unit}")
        elif row[column] != row["status"]:
            parts.append(f"{title}: {row[column]}")
    if row["sensor_depth"]:
        parts.append(f"sensor {float(row['sensor_depth']):.2f} m")
    matched = f"{_percent(float(row['matched_fraction']))} matched"
    if row["matched_fraction_original"]:
        matched += f" ({_percent(float(row['matched_fraction_original']))} of the pair as recorded)"
    parts.append(matched)
    return ", ".join(parts)


def _colours(scale: ColourScale | None) -> dict[str, str] | None:
    if scale is None:
        return None
    low, high = scale.describe(scale.low), scale.describe(scale.high)
    return {"low": low, "high": high, "gradient": gradient()}


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


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


def _threads(summary: Summary) -> int:
    return int(summary.provenance["threads"])


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
