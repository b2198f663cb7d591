# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Results of several recordings as one: merged table and its formats, and a page over all."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from uw_visibility.config.files import gathered, sole_writer
from uw_visibility.errors import InputError
from uw_visibility.replay.columns import TRANSECT, TRANSECT_COLUMN
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.report.figures import draw_series
from uw_visibility.replay.report.report import write_page
from uw_visibility.replay.report.sentences import (
    Frame,
    amount,
    course,
    definition,
    disagreement,
    formula,
    headline,
    number,
    percentage,
    rounded,
    share,
    time_span,
    verdict,
)
from uw_visibility.replay.report.track import draw_tracks
from uw_visibility.replay.results.exports import write_exports
from uw_visibility.replay.results.folder import DAY, DAY_MARK, MARK, TABLE, read_state
from uw_visibility.replay.results.recorder import columns_of
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.results.synopsis import Synopsis, apart
from uw_visibility.replay.stores import Place, child, exists, place, results_here
from uw_visibility.replay.table import (
    Columns,
    TableWriter,
    read_rows,
    read_table,
    write_dictionary,
)


def check_day(folder: Place, *, again: bool) -> None:
    """Refuse a folder where page and tables of all recordings would replace other files."""
    if exists(child(folder, MARK)):
        raise InputError(
            f"{folder} is the result of one recording: give another name for those of several")
    if exists(child(folder, DAY_MARK)):
        if not again:
            raise InputError(
                f"{folder} has the results of several recordings already: give another name, "
                "--resume to go on, or --force to replace")
        return
    for name in DAY.files:
        if exists(child(folder, name)):
            raise InputError(
                f"{child(folder, name)} exists already and is of no replay: give another name")


def write_day(
    output: Place, summaries: Sequence[Summary], options: ReplayOptions, *, again: bool = False
) -> None:
    """Write over all results of several recordings: page, table, NetCDF, Parquet, GeoJSON.

    output: that has the folders of the results; a path, or a URL that fsspec knows.
    summaries: of all recordings, those that failed too. Nothing is written without any result.
    again: whether what an earlier run wrote there may be replaced.
    """
    results = sorted(
        (s for s in summaries if not s.error and s.complete and s.synopsis is not None),
        key=lambda s: s.synopsis.start if s.synopsis is not None else 0)
    if not results:
        return
    # Checked again: files may have appeared during the replay.
    check_day(output, again=again)
    places = [place(summary.output) for summary in results]
    with (
        results_here(output, places, (MARK, TABLE)) as folder,
        sole_writer(folder), gathered(folder, DAY, force=True) as work,
    ):
        failed = [summary for summary in summaries if summary not in results]
        results = [replace(summary, output=str(folder / summary.name)) for summary in results]
        table = _write_table(work, results, options)
        write_index(work, folder.resolve().name, table, results, failed)
        _write_mark(work / DAY_MARK, summaries)


def _write_table(work: Path, results: Sequence[Summary], options: ReplayOptions) -> Columns:
    """Write the rows of all results as one table; returns it."""
    columns = {TRANSECT: TRANSECT_COLUMN, **columns_of(options)}
    table = work / TABLE
    writer = TableWriter(table, tuple(columns))
    for summary in results:
        for row in read_rows(Path(summary.output) / TABLE):
            writer.write({TRANSECT: summary.name, **row})
    writer.close()
    write_dictionary(table, columns)
    found = read_table(table, columns)
    write_exports(
        work, found, columns, _provenance(results), options,
        [summary.name for summary in results])
    return found


def _provenance(results: Sequence[Summary]) -> dict[str, Any]:
    """Return the provenance of all results, which have the same parameters."""
    states = {summary.name: read_state(Path(summary.output)) for summary in results}
    first = next(iter(states.values()))
    return {
        "version": first["version"], "parameters": first["parameters"],
        "bag": ", ".join(str(state["bag"]) for state in states.values()),
        "input_sha256": {name: state["input_sha256"] for name, state in states.items()},
        "complete": True,
    }


def _write_mark(path: Path, summaries: Sequence[Summary]) -> None:
    content: list[Mapping[str, Any]] = [
        {
            "transect": summary.name, "bag": summary.bag, "error": summary.error,
            "lacks": summary.lacks,
            "synopsis": None if summary.synopsis is None else summary.synopsis.state(),
        }
        for summary in summaries
    ]
    text = json.dumps({"transects": content}, indent=1, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def write_index(
    folder: Path, title: str, columns: Columns, results: Sequence[Summary],
    failed: Sequence[Summary],
) -> None:
    """Write the page of several results in time order, and of recordings without a result.

    columns: their table.
    """
    synopses = {summary.name: summary.synopsis for summary in results if summary.synopsis}
    contrast = next(iter(synopses.values())).contrast
    all_of_them = Summary(title, str(folder), provenance=results[0].provenance)
    all_of_them.read(
        columns, contrast, {base for each in synopses.values() for base in each.baselines})
    names = columns[TRANSECT]
    recordings = {}
    for each in synopses:
        rows = names == each
        recordings[each] = {name: values[rows] for name, values in columns.items()}
    places = np.array([list(synopses).index(name) for name in names], np.float64)
    write_page(
        folder / "index.html", "day.html", title=f"Visibility: {title}",
        sentences=[[_part(part) for part in parts] for parts in verdict(all_of_them)],
        definition=definition(contrast), formula=formula(contrast),
        rows=[
            _row(summary, synopses[summary.name], recordings[summary.name])
            for summary in results
        ],
        failed=failed, lacking=[summary for summary in results if summary.lacks],
        series=draw_series({**columns, "recording": places}, list(recordings)),
        maps=draw_tracks(recordings),
    )


def _row(summary: Summary, synopsis: Synopsis, columns: Columns) -> dict[str, Any]:
    """Return a recording's row of the index."""
    name = summary.name
    seen, trust = "not assessed", f"none of {amount(synopsis.frames, 'frame')}"
    if synopsis.told and synopsis.lowest and synopsis.highest:
        seen = "; ".join(
            f"{each.title} {each.value}" for each in headline(synopsis.typical, "")[:2])
        if not synopsis.constant:
            seen += f"; from {number(synopsis.low)} to {number(synopsis.high)} m in 90 % of the " \
                    f"frames.{course(synopsis)}"
        trust = f"{share(synopsis.assessed, synopsis.frames)}, " \
                f"± {percentage(synopsis.relative_stddev)}"
    when = time_span(synopsis.start, synopsis.end) if synopsis.frames else "no frames"
    return {
        "name": name, "href": f"{quote(name)}/report.html",
        "time": f"{when}, most of it without frames" if synopsis.gap else when,
        "start": synopsis.start / 1e9, "end": synopsis.end / 1e9,
        "place": _place(columns), "depth": _depth(columns), "sensor": disagreement(summary),
        "visibility": seen, "trust": trust,
        "worst": _part(Frame(name, synopsis.lowest.frame)) if synopsis.lowest else None,
        "why": "".join(map(str, verdict(summary)[-1])) if not synopsis.told else "",
        "damaged": bool(summary.damage),
    }


def _place(columns: Columns) -> str:
    """Return where a recording begins."""
    for x, y in (("longitude", "latitude"), ("x", "y")):
        known = np.flatnonzero(np.isfinite(columns[x]) & np.isfinite(columns[y]))
        if known.size:
            east, north = float(columns[x][known[0]]), float(columns[y][known[0]])
            if x == "x":
                return f"x {east:.1f} m, y {north:.1f} m"
            return (f"{abs(north):.5f}° {'N' if north >= 0.0 else 'S'}, "
                    f"{abs(east):.5f}° {'E' if east >= 0.0 else 'W'}")
    return "not known"


def _depth(columns: Columns) -> str:
    known = columns["sensor_depth"][np.isfinite(columns["sensor_depth"])]
    if known.size:
        ends = dict.fromkeys((f"{known.min():.1f}", f"{known.max():.1f}"))
        return f"{' to '.join(ends)} m (sensor)"
    for name in ("filtered_depth", "depth"):
        value, spread = columns[name], columns[f"{name}_stddev"]
        if np.isfinite(value).any():
            low, high = np.nanargmin(value), np.nanargmax(value)
            found = [(float(value[place]), float(spread[place])) for place in (low, high)]
            if not apart(*found[0], *found[1]):
                found = [(float(np.nanmedian(value)), float(np.nanmedian(spread)))]
            return f"{' to '.join(rounded(*end) for end in found)} m (by colour)"
    return "not known"


def _part(part: str | Frame) -> str | dict[str, str]:
    """Return a part of a sentence; a frame links to its picture in the report of its recording."""
    if not isinstance(part, Frame):
        return part
    return {"text": str(part), "href": f"{quote(part.transect)}/report.html#frame-{part.number}"}
