# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Spectral tables: shipped ones, and CSV files of users."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.files import read_regular
from uw_visibility.errors import InputError, refusing

# Largest file, bytes: a spectrum in steps of 0.1 nm has about a megabyte.
MOST_BYTES = 4 << 20


# Column names, and rows of cells.
Table = tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]


@cache
def read_shipped(name: str) -> Table:
    """Read a table of `uw_visibility.data` by its file name: column names and rows."""
    text = resources.files("uw_visibility.data").joinpath(name).read_text(encoding="utf-8")
    return parse(text)


def read_file(path: Path) -> Table:
    """Read a CSV file: its column names and its rows, without ``#`` lines.

    Raises `InputError` if the file cannot be read as text.
    """
    with refusing(f"table {path} is not a CSV text file", UnicodeDecodeError, csv.Error):
        return parse(read_regular(path, MOST_BYTES, "table").decode("utf-8-sig"))


def parse(text: str) -> Table:
    """Split CSV text into column names and rows, without ``#`` lines and blank lines."""
    lines = (line for line in text.splitlines() if line.strip() and not line.startswith("#"))
    rows = tuple(tuple(cell.strip() for cell in row) for row in csv.reader(lines))
    return (rows[0], rows[1:]) if rows else ((), ())


def numbers(table: Table, columns: Sequence[str], name: str) -> NDArray[np.float64]:
    """Columns of a table of spectra as numbers, (N, len(columns)), N >= 2, all finite.

    The first column is the wavelength; `name` is that of the table, for messages.

    Raises `InputError` if a column is absent, a cell is not a number, there are fewer than two
    rows, or the wavelengths do not rise.
    """
    head, rows = table
    missing = [column for column in columns if column not in head]
    if missing:
        raise InputError(
            f"table {name} has no column {missing[0]!r}: its first line must name "
            f"{', '.join(columns)}")
    places = [head.index(column) for column in columns]
    try:
        values = np.array([[float(row[place]) for place in places] for row in rows])
    except (ValueError, IndexError) as error:
        raise InputError(
            f"table {name} has a row without a number for each of {', '.join(columns)}: "
            f"{error}"
        ) from error
    if len(values) < 2 or not np.isfinite(values).all():
        raise InputError(f"table {name} needs at least two rows of finite numbers")
    if np.any(np.diff(values[:, 0]) <= 0):
        raise InputError(f"table {name} has wavelengths out of order: sort its rows by them")
    return values
