# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Data dictionary beside a table: CSV on the Web (W3C, tabular metadata)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uw_visibility.replay.columns import TRANSECT, Column

SUFFIX = "-metadata.json"
"""Where CSV on the Web looks for the dictionary of a table: behind its name."""

_DATATYPES = {"integer": "integer", "number": "double", "datetime": "dateTime"}


def write_dictionary(table: Path, columns: Mapping[str, Column]) -> None:
    """Write what the columns of a table are: names, units, definitions, standard names.

    Parameters
    ----------
    table : Path
        The table; the dictionary comes beside it.
    columns : mapping of str to Column
        Its columns, in order.

    References
    ----------
    Metadata Vocabulary for Tabular Data, W3C Recommendation, 2015,
    https://www.w3.org/TR/tabular-metadata/
    """
    content = {
        "@context": ["http://www.w3.org/ns/csvw", {"@language": "en"}],
        "url": table.name,
        "dc:title": "Water attenuation, visibility and depth, one row a stereo frame",
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
        datatype = {"base": "string", "format": "|".join(_literal(c) for c in column.choices)}
    described: dict[str, Any] = {
        "name": name, "titles": [name], "datatype": datatype, "dc:title": column.title,
        "dc:description": column.description, "schema:unitText": column.unit,
        "schema:propertyID": column.standard_name,
        "schema:measurementMethod":
            f"standard deviation of {column.stddev_of}" if column.stddev_of else "",
    }
    if column.choices:
        # What stands in the table, and what it says in reports and messages.
        described["schema:valueReference"] = [
            {"schema:value": choice, "schema:description": meaning}
            for choice, meaning in zip(column.choices, column.meanings, strict=True)]
    return {key: value for key, value in described.items() if value}


def _literal(text: str) -> str:
    """Return a regular expression for a text as it is, in the dialect of XML Schema."""
    return "".join(f"\\{c}" if c in r"\|.?*+(){}[]^$-" else c for c in text)
