# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table of a replay, frames.csv: one row a frame; `columns` says what is in it."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.replay.columns import CHANNELS, FAILED, Column, word
from uw_visibility.replay.line_fit import LineFit
from uw_visibility.replay.records import FrameEstimate, JoinedFrame
from uw_visibility.water.assessment import Visibility
from uw_visibility.water.derived import QUANTITIES, DerivedModel, DerivedQuantities
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.survey import SurveyEstimate

ROWS = 1024
"""Rows of a slice."""


def seconds(nanoseconds: int) -> str:
    """Return a time in s with all its digits."""
    # By its amount: -1.5 s are -2 s and 500,000,000 ns.
    whole, fraction = divmod(abs(nanoseconds), 1_000_000_000)
    return f"{'-' * (nanoseconds < 0)}{whole}.{fraction:09d}"


def nanoseconds(text: str) -> int:
    """Return a time in ns, of what `seconds` wrote."""
    whole, _, fraction = text.removeprefix("-").partition(".")
    amount = int(whole) * 1_000_000_000 + int(fraction)
    return -amount if text.startswith("-") else amount


def iso_time(nanoseconds: int) -> str:
    """Return a time in UTC as ISO 8601, with all its digits."""
    second = datetime.fromtimestamp(nanoseconds // 1_000_000_000, UTC)
    return f"{second:%Y-%m-%dT%H:%M:%S}.{nanoseconds % 1_000_000_000:09d}Z"


def number(value: float) -> str:
    """Return a number so that reading it gives the same one; empty where it is not finite."""
    return repr(float(value)) if math.isfinite(value) else ""


def row_of(
    joined: JoinedFrame,
    model: DerivedModel,
    joins: Sequence[str] = (),
    turbidity: LineFit | None = None,
) -> dict[str, str]:
    """Write a frame as a row of the table; what it lacks stays empty.

    Parameters
    ----------
    joined : JoinedFrame
    model : DerivedModel
        Derives the field's quantities.
    joins : sequence of str
        Columns of the joined topics.
    turbidity : LineFit or None
        Of turbidity over attenuation.

    Returns
    -------
    dict of str to str
        Text by column.
    """
    record = joined.record
    row = {
        "frame": str(record.frame), "datetime": iso_time(record.stamp),
        "stamp": seconds(record.stamp),
        "right_stamp": seconds(record.right_stamp), "time": seconds(record.time),
        "plausibility": "" if joined.verdict is None else word(joined.verdict),
        "plausibility_reason": joined.verdict_reason,
        "longitude": number(joined.longitude), "latitude": number(joined.latitude),
        "x": number(joined.x), "y": number(joined.y),
    }
    row |= {name: number(value) for name, value in zip(joins, joined.scalars, strict=True)}
    if joined.sensor is not None:
        row["sensor_depth"] = number(joined.sensor.depth)
        row["sensor_depth_stddev"] = number(joined.sensor.variance**0.5)
    if joined.comparison is not None:
        row |= {
            "innovation": number(joined.comparison.innovation),
            "nis": number(joined.comparison.nis),
        }
    if record.estimate is None:
        return row | {"status": FAILED, "reason": record.reason}
    row |= _estimate_columns(record.estimate)
    row |= _derived_columns("", model.derive(record.estimate.water), turbidity)
    if joined.filtered is not None:
        row |= _attenuation_columns("filtered_", joined.filtered.water)
        row |= _visibility_columns("filtered_", joined.filtered.visibility)
        row |= _derived_columns("filtered_", model.derive(joined.filtered.water), turbidity)
        row["filtering"] = word(joined.filtered.event)
        if joined.filtered.survey is not None:
            row |= _survey_columns(joined.filtered.survey)
    return row


def _estimate_columns(estimate: FrameEstimate) -> dict[str, str]:
    water, visibility = estimate.water, estimate.visibility
    original = estimate.matched_fraction_original
    columns = {
        "status": word(water.status),
        "visibility_status": word(visibility.status),
        "depth_status": word(visibility.depth_status),
        **_visibility_columns("", visibility),
        "depth_precision": number(visibility.depth_precision),
        "support_points": str(estimate.support_points),
        "coverage": number(estimate.coverage),
        "matched_fraction": number(estimate.matched_fraction),
        "matched_fraction_original": "" if original is None else number(original),
        "limited_fraction": number(estimate.limited_fraction),
    }
    columns |= _attenuation_columns("", water)
    for index, channel in enumerate(CHANNELS):
        columns[f"ambient_light_{channel}"] = number(water.ambient_light[index])
        columns[f"ambient_light_{channel}_stddev"] = number(water.ambient_light_stddev[index])
    return columns


def _attenuation_columns(prefix: str, water: WaterEstimate) -> dict[str, str]:
    columns = {}
    for index, channel in enumerate(CHANNELS):
        name = f"{prefix}attenuation_{channel}"
        columns[name] = number(water.attenuation[index])
        columns[f"{name}_stddev"] = number(water.attenuation_stddev[index])
    return columns


def _derived_columns(
    prefix: str, derived: DerivedQuantities, turbidity: LineFit | None
) -> dict[str, str]:
    names = [name for quantity in QUANTITIES for name in (quantity, f"{quantity}_stddev")]
    sensed = {}
    if turbidity is not None:
        value, stddev = turbidity.predict(
            derived.beam_attenuation, derived.beam_attenuation_stddev)
        sensed = {
            f"{prefix}turbidity": number(value), f"{prefix}turbidity_stddev": number(stddev)}
    return {
        **sensed,
        **{f"{prefix}{name}": number(getattr(derived, name)) for name in names},
        f"{prefix}water_type": derived.water_type,
        f"{prefix}water_type_likelihood": number(derived.water_type_likelihood),
        f"{prefix}water_type_status": word(derived.water_type_status),
    }


def _visibility_columns(prefix: str, visibility: Visibility) -> dict[str, str]:
    return {
        f"{prefix}mean_attenuation": number(visibility.mean_attenuation),
        f"{prefix}mean_attenuation_stddev": number(visibility.mean_attenuation_stddev),
        f"{prefix}visibility_distance": number(visibility.distance),
        f"{prefix}visibility_distance_stddev": number(visibility.distance_stddev),
        f"{prefix}depth": number(visibility.depth),
        f"{prefix}depth_stddev": number(visibility.depth_stddev),
    }


def _survey_columns(survey: SurveyEstimate) -> dict[str, str]:
    return {
        "survey_frames": str(survey.frames),
        "survey_range_min": number(survey.range_min),
        "survey_range_max": number(survey.range_max),
    }


class TableWriter:
    """Table writer: rows as they come, so that an interruption loses none."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.columns = tuple(columns)
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.DictWriter(self._file, columns, restval="", lineterminator="\n")
        self._writer.writeheader()

    def write(self, row: Mapping[str, Any]) -> None:
        """Write a row; columns that it lacks stay empty."""
        self._writer.writerow(row)
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_rows(path: Path) -> Iterator[dict[str, str]]:
    """Yield the rows of a table, as text; a last row that is cut off is left out.

    Raises
    ------
    InputError
        If the table is damaged.
    """
    with path.open(encoding="utf-8", newline="") as file:
        try:
            for row in csv.DictReader(file):
                if None not in row.values():
                    yield row
        except (csv.Error, UnicodeDecodeError) as error:
            raise InputError(f"table {path} is damaged: {error}") from error


def read_columns(path: Path, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Read columns of numbers.

    Returns
    -------
    dict of str to ndarray, (n,) float64
        NaN for what is not known.
    """
    rows = [[float(row[name] or "nan") for name in names] for row in read_rows(path)]
    values = np.array(rows, np.float64).reshape(-1, len(names))
    return {name: values[:, index] for index, name in enumerate(names)}


def slices(path: Path, columns: Mapping[str, Column]) -> Iterator[dict[str, NDArray]]:
    """Yield a table's columns in slices of `ROWS`; one without rows where there are none.

    Parameters
    ----------
    path : Path
        The table.
    columns : mapping of str to Column

    Yields
    ------
    dict of str to ndarray, (n,)
        float64 for numbers, NaN where they are not known; object (str) for texts.

    Raises
    ------
    InputError
        If the table is damaged.
    """
    found = read_rows(path)
    for number in itertools.count():
        part = list(itertools.islice(found, ROWS))
        if not part and number:
            return
        yield {
            name: np.array([float(row[name] or "nan") for row in part])
            if column.kind in ("integer", "number")
            else np.array([row[name] for row in part], dtype=object)
            for name, column in columns.items()
        }
