# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Captions of frames' pictures."""

from __future__ import annotations

from collections.abc import Mapping

from uw_visibility.messages.stamps import nanoseconds
from uw_visibility.replay.columns import CHANNELS, COLUMNS
from uw_visibility.replay.report.overview import percent
from uw_visibility.replay.report.sentences import clock, number, rounded


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
