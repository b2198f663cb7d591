# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table of a replay, frames.csv: one row a frame; `columns` says what is in it."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.replay.columns import Column

ROWS = 1024
"""Rows of a slice."""


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
