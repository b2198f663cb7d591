# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table of a replay, frames.csv: one row a frame, and the columns' meaning."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.pipeline.result import FrameResult
from uw_visibility.plausibility.samples import DepthSample
from uw_visibility.status import Status

FAILED = "unusable"
"""Status of frames that gave no result; the column ``reason`` says why."""

CHANNELS = ("red", "green", "blue")


def _with_stddev(name: str) -> tuple[str, str]:
    return name, f"{name}_stddev"


COLUMNS: tuple[str, ...] = (
    "frame", "stamp", "right_stamp", "time", "status", "visibility_status", "depth_status",
    "reason",
    *(c for channel in CHANNELS for c in _with_stddev(f"attenuation_{channel}")),
    *(c for channel in CHANNELS for c in _with_stddev(f"ambient_light_{channel}")),
    *_with_stddev("mean_attenuation"), *_with_stddev("visibility_distance"),
    *_with_stddev("depth"), "depth_precision",
    *_with_stddev("filtered_mean_attenuation"), *_with_stddev("filtered_visibility_distance"),
    *_with_stddev("filtered_depth"), "filtering",
    "survey_frames", "survey_range_min", "survey_range_max",
    "support_points", "coverage", "matched_fraction", "matched_fraction_original",
    "limited_fraction",
    *_with_stddev("sensor_depth"), "innovation", "nis", "plausibility",
    "plausibility_reason",
    "longitude", "latitude", "x", "y",
)
"""Columns of ``frames.csv``: m, 1/m, degrees; stamps and time in s; empty = not known."""


def seconds(nanoseconds: int) -> str:
    """Return a time in s with all its digits."""
    return f"{nanoseconds // 1_000_000_000}.{nanoseconds % 1_000_000_000:09d}"


def nanoseconds(text: str) -> int:
    """Return a time in ns, of what `seconds` wrote."""
    whole, _, fraction = text.partition(".")
    return int(whole) * 1_000_000_000 + int(fraction)


def number(value: float) -> str:
    """Return a number so that reading it gives the same one; empty where it is not finite."""
    return repr(float(value)) if math.isfinite(value) else ""


def result_columns(result: FrameResult) -> dict[str, str]:
    """Return the columns that a frame's result fills.

    Parameters
    ----------
    result : FrameResult

    Returns
    -------
    dict of str to str
        Text by column.
    """
    water, visibility, limited = result.water, result.visibility, result.images.limited
    columns = {
        "status": str(result.status),
        "visibility_status": str(visibility.status),
        "depth_status": str(visibility.depth_status),
        "mean_attenuation": number(visibility.mean_attenuation),
        "mean_attenuation_stddev": number(visibility.mean_attenuation_stddev),
        "visibility_distance": number(visibility.distance),
        "visibility_distance_stddev": number(visibility.distance_stddev),
        "depth": number(visibility.depth),
        "depth_stddev": number(visibility.depth_stddev),
        "depth_precision": number(visibility.depth_precision),
        "support_points": str(int(result.stereo.support_points)),
        "coverage": number(result.stereo.coverage),
        "matched_fraction": number(result.stereo.matched_fraction),
        "matched_fraction_original": number(
            math.nan if result.stereo.matched_fraction_original is None
            else result.stereo.matched_fraction_original
        ),
        "limited_fraction": number(float(limited.mean()) if limited.size else 0.0),
    }
    for index, channel in enumerate(CHANNELS):
        columns[f"attenuation_{channel}"] = number(water.attenuation[index])
        columns[f"attenuation_{channel}_stddev"] = number(water.attenuation_stddev[index])
        columns[f"ambient_light_{channel}"] = number(water.ambient_light[index])
        columns[f"ambient_light_{channel}_stddev"] = number(water.ambient_light_stddev[index])
    return columns


def depth_sample(row: Mapping[str, str]) -> tuple[DepthSample, Status]:
    """Return the estimated depth of a row with a result, and its status, to be judged."""
    status = Status(row["depth_status"])
    known = bool(row["depth"] and row["depth_precision"])
    depth = float(row["depth"]) if known else math.nan
    variance = float(row["depth_precision"]) ** 2 if known else math.nan
    return DepthSample(nanoseconds(row["stamp"]), depth, variance), status


class TableWriter:
    """Table writer: rows as they come, so that an interruption loses none.

    Parameters
    ----------
    path : Path
        CSV file to write.
    columns : sequence of str
        Its columns.

    Attributes
    ----------
    columns : tuple of str
    """

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
    """Yield the rows of a table, as text; a last row that is cut off is left out."""
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            if None not in row.values():
                yield row


def read_columns(path: Path, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Read columns of numbers.

    Parameters
    ----------
    path : Path
        A table.
    names : sequence of str
        Columns.

    Returns
    -------
    dict of str to ndarray, (n,) float64
        NaN for what is not known.
    """
    rows = [[float(row[name] or "nan") for name in names] for row in read_rows(path)]
    values = np.array(rows, np.float64).reshape(-1, len(names))
    return {name: values[:, index] for index, name in enumerate(names)}
