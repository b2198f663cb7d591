# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table of a replay, frames.csv: one row per frame; its columns are in `columns`.

Its data dictionary is beside it, by CSV on the Web (W3C, tabular metadata).
"""

from __future__ import annotations

import csv
import json
import sys
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import cell, refusing, uncell
from uw_visibility.replay.columns import TRANSECT, Column

Columns = Mapping[str, NDArray]
"""Columns of a table by name, as `read_table` returns them."""

SUFFIX = "-metadata.json"
"""Suffix of the dictionary of a table, by CSV on the Web."""

_DATATYPES = {"integer": "integer", "number": "double", "datetime": "dateTime"}
# Type codes of `array`.
_CODES = {"integer": "d", "number": "d", "datetime": "q"}


class TableWriter:
    """Table writer that writes rows at once, so that an interruption loses none."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.DictWriter(
            self._file, columns, restval="", extrasaction="ignore", lineterminator="\n")
        self._writer.writeheader()

    def write(self, row: Mapping[str, Any]) -> None:
        """Write a row; missing columns stay empty, other values are left out."""
        self._writer.writerow({name: cell(value) for name, value in row.items()})
        self._file.flush()

    def close(self) -> None:
        self._file.close()


def read_rows(path: Path) -> Iterator[dict[str, str]]:
    """Yield the rows of a table as text, without a truncated last row.

    Raises `InputError` if the table is damaged.
    """
    with (
        path.open(encoding="utf-8", newline="") as file,
        refusing(f"table {path} is damaged", csv.Error, UnicodeDecodeError),
    ):
        for row in csv.DictReader(file):
            if None not in row.values():
                yield {name: uncell(text) for name, text in row.items() if name is not None}


def read_table(path: Path, columns: Mapping[str, Column]) -> dict[str, NDArray]:
    """Read columns of a table.

    Returns dict of str to (n,): float64 for numbers, NaN if unknown; int64, ns since 1970, for
    times of the kind "datetime"; object (str) for texts.
    """
    found: dict[str, Any] = {
        name: array(_CODES[column.kind]) if column.kind in _CODES else []
        for name, column in columns.items()
    }
    parsers = {name: _parser(column.kind) for name, column in columns.items()}
    for row in read_rows(path):
        for name, values in found.items():
            values.append(parsers[name](row[name]))
    return {
        name: np.array(values, object) if isinstance(values, list) else np.array(values)
        for name, values in found.items()
    }


def _parser(kind: str) -> Callable[[str], Any]:
    """Return the parser of cells for a kind of column."""
    if kind in ("integer", "number"):
        return lambda text: float(text or "nan")
    if kind == "datetime":
        return lambda text: int(np.datetime64(text.removesuffix("Z"), "ns").astype(np.int64))
    # Most columns of text have few different words.
    return sys.intern


def write_dictionary(table: Path, columns: Mapping[str, Column]) -> None:
    """Write the dictionary of a table: names, units, definitions, standard names of columns.

    Metadata Vocabulary for Tabular Data, W3C 2015, https://www.w3.org/TR/tabular-metadata/.
    """
    content = {
        "@context": ["http://www.w3.org/ns/csvw", {"@language": "en"}],
        "url": table.name,
        "dc:title": "Water attenuation, visibility and depth, one row per stereo frame",
        "dialect": {"header": True, "encoding": "utf-8"},
        "tableSchema": {
            "columns": [_described(name, column) for name, column in columns.items()],
            "primaryKey": [TRANSECT, "frame"] if TRANSECT in columns else "frame",
        },
    }
    text = json.dumps(content, indent=1, ensure_ascii=False)
    table.with_name(table.name + SUFFIX).write_text(text + "\n", encoding="utf-8")


def _described(name: str, column: Column) -> dict[str, Any]:
    datatype: Any = _DATATYPES.get(column.kind, "string")
    if column.choices:
        datatype = {"base": "string", "format": "|".join(column.choices)}
    described: dict[str, Any] = {
        "name": name, "titles": [name], "datatype": datatype, "dc:title": column.title,
        "dc:description": column.description, "schema:unitText": column.unit,
        "schema:propertyID": column.standard_name,
        "schema:measurementMethod":
            f"standard deviation of {column.stddev_of}" if column.stddev_of else "",
    }
    if column.choices:
        # Words of the table, with their sentences in reports and messages.
        described["schema:valueReference"] = [
            {"schema:value": choice, "schema:description": meaning}
            for choice, meaning in zip(column.choices, column.meanings, strict=True)]
    return {key: value for key, value in described.items() if value}
