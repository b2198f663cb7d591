# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Page over the results of several recordings: verdict, index, figures and maps."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from uw_visibility.replay.report.figures import NEEDED, Columns, draw_series
from uw_visibility.replay.report.page import write_page
from uw_visibility.replay.report.sentences import (
    CLOCK_NOT_SET,
    FIRST_DATE,
    amount,
    definition,
    formula,
    number,
    percentage,
    rounded,
    share,
    time_span,
    verdict,
)
from uw_visibility.replay.report.track import TRACK_COLUMNS, draw_tracks
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.results.synopsis import Synopsis
from uw_visibility.replay.table import read_columns

UNFINISHED = "not complete: --resume goes on from it"


def write_index(
    path: Path, title: str, results: Sequence[Summary], failed: Sequence[Summary]
) -> None:
    """Write the page over several results.

    Parameters
    ----------
    path : Path
        File to write; the folders of the results are beside where it will be.
    title : str
        Of the day.
    results : sequence of Summary
        In the order of their time, with their synopses.
    failed : sequence of Summary
        Recordings without a result.
    """
    recordings = {
        summary.name: read_columns(
            Path(summary.output) / "frames.csv", [*dict.fromkeys((*NEEDED, *TRACK_COLUMNS))])
        for summary in results
    }
    synopses = {summary.name: summary.synopsis for summary in results if summary.synopsis}
    contrast = next(iter(synopses.values())).contrast
    write_page(
        path, "day.html", title=f"Visibility: {title}",
        sentences=_verdict(synopses, len(results) + len(failed)),
        definition=definition(contrast), formula=formula(contrast),
        rows=[
            _row(summary, synopses[summary.name], recordings[summary.name])
            for summary in results
        ],
        failed=[{"name": summary.name, "error": summary.error or UNFINISHED} for summary in failed],
        lacking=[
            {"name": summary.name, "why": why} for summary in results for why in summary.lacks],
        series=draw_series(_together(recordings), list(recordings)),
        maps=draw_tracks(recordings),
    )


def _verdict(synopses: dict[str, Synopsis], recordings: int) -> list[list[dict[str, str]]]:
    """Say over all recordings what `verdict` says of one."""
    frames, assessed, told = (
        sum(getattr(synopsis, name) for synopsis in synopses.values())
        for name in ("frames", "assessed", "told")
    )
    when = time_span(
        min(synopsis.start for synopsis in synopses.values()),
        max(synopsis.end for synopsis in synopses.values()))
    of = amount(len(synopses), "recording")
    if len(synopses) < recordings:
        of = f"{len(synopses)} of {amount(recordings, 'recording')}"
    if not told:
        return [[_text(
            f"Visibility could not be assessed in any of {amount(frames, 'frame')} of {of}, from "
            f"{when}.")]]
    parts = [[_text(
        f"Visibility was assessed in {share(assessed, frames)} of {of}, from {when}.")]]
    low = min(
        (s.lowest.value + s.lowest.stddev, name) for name, s in synopses.items() if s.lowest)[1]
    high = max(
        (s.highest.value - s.highest.stddev, name) for name, s in synopses.items() if s.highest)[1]
    worst_of, best = synopses[low], synopses[high].highest
    worst = worst_of.lowest
    assert worst is not None and best is not None
    parts.append([
        _text(f"It was from {rounded(worst.value, worst.stddev)} m ("),
        _link(low, worst.frame), _text(f") to {rounded(best.value, best.stddev)} m ("),
        _link(high, best.frame),
        _text(f"), {formula(worst_of.contrast)} of the clearest channel."),
    ])
    spreads = [s.relative_stddev for s in synopses.values() if s.told]
    upto = f" to {percentage(max(spreads))}" if len(spreads) > 1 else ""
    parts.append([_text(
        f"How far to trust it: in the median frame of a recording to ± {percentage(min(spreads))}"
        f"{upto} (one standard deviation), which holds noise and what the scene leaves open, but "
        "no wrong calibration or camera setting; the reports of the recordings say why not more."
    )])
    if any(synopsis.start < FIRST_DATE for synopsis in synopses.values() if synopsis.frames):
        parts.append([_text(CLOCK_NOT_SET)])
    none = [name for name, s in synopses.items() if not s.told]
    if none:
        parts.append([_text(f"Without any visibility: {', '.join(none)}.")])
    return parts


def _row(summary: Summary, synopsis: Synopsis, columns: Columns) -> dict[str, Any]:
    """Return a recording's row of the index."""
    name = summary.name
    seen, trust = "not assessed", f"none of {amount(synopsis.frames, 'frame')}"
    if synopsis.told and synopsis.lowest and synopsis.highest:
        seen = f"{number(synopsis.low)} to {number(synopsis.high)} m, median " \
               f"{number(synopsis.median)} m"
        trust = f"{share(synopsis.assessed, synopsis.frames)}, " \
                f"± {percentage(synopsis.relative_stddev)}"
    return {
        "name": name, "href": f"{quote(name)}/report.html",
        "time": time_span(synopsis.start, synopsis.end) if synopsis.frames else "no frames",
        "start": synopsis.start / 1e9, "end": synopsis.end / 1e9,
        "place": _place(columns), "depth": _unbroken(_depth(columns)),
        "visibility": _unbroken(seen), "trust": _unbroken(trust),
        "worst": _link(name, synopsis.lowest.frame) if synopsis.lowest else None,
        "why": "".join(map(str, verdict(summary)[-1])) if not synopsis.told else "",
        "damaged": bool(summary.damage),
    }


def _unbroken(text: str) -> str:
    """Keep units on the line of their numbers."""
    return re.sub(r"(?<=\d) (?=(?:m|%)(?!\w))", "\N{NO-BREAK SPACE}", text)


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
    for name, source in (
        ("sensor_depth", "sensor"), ("filtered_depth", "by colour"), ("depth", "by colour")
    ):
        known = columns[name][np.isfinite(columns[name])]
        if known.size:
            return f"{known.min():.1f} to {known.max():.1f} m ({source})"
    return "not known"


def _together(recordings: Mapping[str, Columns]) -> Columns:
    """Return the columns of all recordings, and ``recording``, which one."""
    together = {
        name: np.concatenate([columns[name] for columns in recordings.values()]) for name in NEEDED
    }
    together["recording"] = np.concatenate([
        np.full(len(columns["stamp"]), float(place))
        for place, columns in enumerate(recordings.values())
    ])
    return together


def _text(text: str) -> dict[str, str]:
    return {"text": text, "href": ""}


def _link(name: str, frame: int) -> dict[str, str]:
    """Return a link to the picture of a frame in the report of a recording."""
    return {"text": f"{name}, frame {frame}", "href": f"{quote(name)}/report.html#frame-{frame}"}
