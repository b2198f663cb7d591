# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Results of several recordings as one: merged table and its formats, and a page over all."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from uw_visibility.config.files import gathered
from uw_visibility.errors import InputError
from uw_visibility.replay.columns import TRANSECT, TRANSECT_COLUMN
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.results.exports import write_exports
from uw_visibility.replay.results.folder import MARK, read_state
from uw_visibility.replay.results.recorder import columns_of
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.stores import Place, child, exists, place, results_here
from uw_visibility.replay.table import SUFFIX, TableWriter, read_rows, write_dictionary

DAY_MARK = "transects.json"
"""Every folder of several results has this file."""

PRODUCTS = ("index.html", "frames.csv", f"frames.csv{SUFFIX}", "frames.geojson", "frames.nc",
            "frames.parquet")


def check_day(folder: Place) -> None:
    """Refuse a folder in which what is written over all would replace something else.

    Raises
    ------
    InputError
        Naming the file.
    """
    if exists(child(folder, MARK)):
        raise InputError(
            f"{folder} is the result of one recording: give another name for those of several")
    if exists(child(folder, DAY_MARK)):
        return
    for name in PRODUCTS:
        if exists(child(folder, name)):
            raise InputError(
                f"{child(folder, name)} exists already and is of no replay: give another name")


def write_day(output: Place, summaries: Sequence[Summary], options: ReplayOptions) -> int:
    """Write over all results of several recordings: page, table, NetCDF, Parquet, GeoJSON.

    Parameters
    ----------
    output : Path or str
        That has the folders of the results; a path, or a URL that fsspec knows.
    summaries : sequence of Summary
        Of all recordings, those that failed too.
    options : ReplayOptions
        What all were replayed with.

    Returns
    -------
    int
        Number of recordings in it; nothing is written for none.

    Raises
    ------
    InputError
        If a table is damaged, or the folder cannot be written.
    """
    results = _results(summaries)
    if not results:
        return 0
    places = [place(summary.output) for summary in results]
    with results_here(output, places, (MARK, "frames.csv")) as folder:
        _write(folder, [
            replace(summary, output=str(folder / summary.name)) for summary in summaries
        ], options)
    return len(results)


def _results(summaries: Sequence[Summary]) -> list[Summary]:
    """Return those with a result, by time."""
    return sorted(
        (s for s in summaries if not s.error and s.complete and s.synopsis is not None),
        key=lambda s: s.synopsis.start if s.synopsis is not None else 0,
    )


def _write(folder: Path, summaries: Sequence[Summary], options: ReplayOptions) -> None:
    from uw_visibility.replay.report.day import write_index

    results = _results(summaries)
    with gathered(folder, DAY_MARK) as work:
        _write_table(work, results, options)
        write_index(work / "index.html", folder.resolve().name, results, [
            summary for summary in summaries if summary not in results])
        _write_mark(work / DAY_MARK, summaries)


def _write_table(work: Path, results: Sequence[Summary], options: ReplayOptions) -> None:
    columns = {TRANSECT: TRANSECT_COLUMN, **columns_of(options)}
    table = work / "frames.csv"
    writer = TableWriter(table, tuple(columns))
    for summary in results:
        for row in read_rows(Path(summary.output) / "frames.csv"):
            writer.write({TRANSECT: summary.name, **row})
    writer.close()
    write_dictionary(table, columns)
    write_exports(
        work, columns, _provenance(results), options, [summary.name for summary in results])


def _provenance(results: Sequence[Summary]) -> dict[str, Any]:
    """Return that of all results, which were made alike."""
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
