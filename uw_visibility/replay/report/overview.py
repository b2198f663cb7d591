# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Texts of a report: its overview with numbers in large, derived quantities, captions."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.images.arrays import Array
from uw_visibility.messages.stamps import nanoseconds
from uw_visibility.replay.columns import CHANNELS, COLUMNS
from uw_visibility.replay.report.sentences import (
    Frames,
    amount,
    clock,
    definition,
    formula,
    number,
    rounded,
    verdict,
)
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.table import read_columns, read_rows
from uw_visibility.water.derived import QUANTITIES

MATCHED = ("matched_fraction", "matched_fraction_original")
OVERVIEW_COLUMNS = (
    "mean_attenuation", "mean_attenuation_stddev", "depth", "depth_stddev", *MATCHED)


def overview(
    columns: Mapping[str, Array], summary: Summary, shown: Collection[str]
) -> dict[str, Any]:
    """Return what a page opens with.

    Parameters
    ----------
    columns : mapping of str to ndarray, (n,) float64
        Those of `OVERVIEW_COLUMNS`.
    summary : Summary
    shown : collection of str
        Numbers of the frames with a picture on the page, which the sentences link to.

    Returns
    -------
    dict
        ``sentences``, each a list of parts with ``text`` and ``href`` (empty without a
        picture); ``definition``; ``formula``; ``numbers``, pairs of value and name.
    """
    contrast = contrast_of(summary)
    return {
        "sentences": [[_part(part, shown) for part in parts] for parts in verdict(summary)],
        "definition": definition(contrast),
        "formula": formula(contrast),
        "numbers": _numbers(columns, summary, formula(contrast)),
    }


def contrast_of(summary: Summary) -> float:
    """Return the contrast that a result's visibility distance is for."""
    return float(summary.provenance["parameters"]["assessment.contrast"])


def _part(part: str | Frames, shown: Collection[str]) -> dict[str, str]:
    frame = str(part.frame) if isinstance(part, Frames) else ""
    return {"text": str(part), "href": f"#frame-{frame}" if frame in shown else ""}


def _numbers(columns: Mapping[str, Array], summary: Summary, short: str) -> list[tuple[str, str]]:
    numbers: list[tuple[str, str]] = []
    synopsis = summary.synopsis
    if synopsis is not None and synopsis.frames:
        count = amount(synopsis.frames, "frame")
        numbers.append((percent(synopsis.share), f"of {count} show visibility by themselves"))
    if synopsis is not None and synopsis.told:
        numbers.append((
            f"{rounded(synopsis.median, synopsis.relative_stddev * synopsis.median)} m",
            f"visibility distance, {short} of the clearest channel; "
            f"{_extent(synopsis.told, synopsis.frames, synopsis.low, synopsis.high, 'm')}",
        ))
    for name, unit, title in (
        ("mean_attenuation", "1/m", "mean attenuation α, beyond that of clear water"),
        ("depth", "m", "depth by colour"),
    ):
        known = columns[name][np.isfinite(columns[name])]
        if known.size:
            low, middle, high = (float(v) for v in np.percentile(known, [5.0, 50.0, 95.0]))
            spread = float(np.nanmedian(columns[f"{name}_stddev"]))
            numbers.append((
                f"{rounded(middle, spread)} {unit}",
                f"{title}; {_extent(known.size, len(columns[name]), low, high, unit)}",
            ))
    enhanced, original = (columns[name][np.isfinite(columns[name])] for name in MATCHED)
    if original.size:
        numbers.append((
            percent(float(np.median(enhanced))),
            f"matched, median; {percent(float(np.median(original)))} of the pairs as recorded",
        ))
    return numbers


def _extent(known: int, frames: int, low: float, high: float, unit: str) -> str:
    """Say in how many frames a quantity is known, and within which limits in most of them."""
    if known == 1 < frames:
        return f"in 1 of {frames} frames"
    median = "median" if known == frames else f"median of {known} of {frames} frames"
    of_them = "the frames" if known == frames else "them"
    return f"{median}, {number(low)} to {number(high)} {unit} in 90 % of {of_them}"


def percent(share: float) -> str:
    """Return a share as a percentage; only all is 100 %, and only nothing 0 %."""
    if 0.0 < share < 1.0:
        share = min(max(share, 0.01), 0.99)
    return f"{100.0 * share:.0f} %"


def derived_quantities(table: Path) -> list[dict[str, str]]:
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
                "title": quantity.title, "median": f"{rounded(middle, spread)} {unit}",
                "span": f"{number(low)} to {number(high)} {unit}",
                "definition": quantity.definition, "caveat": quantity.caveat,
                "source": quantity.source,
            })
    return rows + _water_type(table)


def _water_type(table: Path) -> list[dict[str, str]]:
    """Return the Jerlov type that most frames are nearest to, with its likelihood in those."""
    likelihoods: dict[str, dict[str, list[float]]] = {"": {}, "filtered_": {}}
    for row in read_rows(table):
        for prefix, by_type in likelihoods.items():
            name, share = row[f"{prefix}water_type"], row[f"{prefix}water_type_likelihood"]
            if name:
                by_type.setdefault(name, []).append(float(share))
    by_type = likelihoods["filtered_"] or likelihoods[""]
    if not by_type:
        return []
    most = max(by_type, key=lambda name: len(by_type[name]))
    others = [f"{name} ({len(found)})" for name, found in sorted(by_type.items())]
    return [{
        "title": "nearest Jerlov type",
        "median": f"{most}, likelihood {np.median(by_type[most]):.2f}",
        "span": f"frames: {', '.join(others)}",
        "definition": "Water type whose beam attenuation, as this camera sees it, is the likeliest",
        "caveat": "Types are defined by Kd; particles shift them by a type or more.",
        "source": "Williamson and Hollins 2022, doi:10.1364/AO.470464; Solonenko and Mobley 2015, "
        "doi:10.1364/AO.54.005392",
    }]


def caption(row: Mapping[str, str], formula: str) -> str:
    """Say what a frame shows.

    Parameters
    ----------
    row : mapping of str to str
        Of the table.
    formula : str
        Visibility distance as a short formula.
    """
    parts = [
        f"Frame {row['frame']} at {clock(nanoseconds(row['stamp']))}",
        f"water: {_said(row, 'status')}"]
    for name, title, unit, column in (
        ("visibility_distance", "visibility", "m", "visibility_status"),
        ("mean_attenuation", "α", "1/m", "status"), ("depth", "depth", "m", "depth_status"),
    ):
        if row[name]:
            text = f"{title} {_value(row, name)} {unit}"
            if name == "visibility_distance":
                text += f" ({formula} of {_clearest(row)}"
                filtered = f"filtered_{name}"
                text += f"; filtered {_value(row, filtered)} m)" if row[filtered] else ")"
            parts.append(text)
        elif row[column] != row["status"]:
            parts.append(f"{title}: {_said(row, column)}")
    if row["sensor_depth"]:
        parts.append(f"sensor {float(row['sensor_depth']):.2f} m")
    matched = f"{percent(float(row['matched_fraction']))} matched"
    if row["matched_fraction_original"]:
        matched += f" ({percent(float(row['matched_fraction_original']))} of the pair as recorded)"
    parts.append(matched)
    return ", ".join(parts)


def _said(row: Mapping[str, str], column: str) -> str:
    return COLUMNS[column].meaning(row[column])


def _value(row: Mapping[str, str], name: str) -> str:
    spread = row[f"{name}_stddev"]
    return rounded(float(row[name]), float(spread)) if spread else number(float(row[name]))


def _clearest(row: Mapping[str, str]) -> str:
    """Name the channel that decides."""
    known = [(float(row[f"attenuation_{c}"]), c) for c in CHANNELS if row[f"attenuation_{c}"]]
    return min(known)[1]
