# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of all studies: rows of named columns, written as CSV and JSON or printed."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import is_dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeVar

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import cell

CHANNELS = ("red", "green", "blue")
Row = Mapping[str, Any]
Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)

UNKNOWN = "–"


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Group items by key, in the order of each key's first item."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def flat(values: Row, prefix: str = "") -> dict[str, Any]:
    """Return nested values as one row, by dotted names: dataclasses by field, tuples by channel."""
    row: dict[str, Any] = {}
    for name, value in values.items():
        inside = value
        if is_dataclass(value):
            inside = vars(value)
        elif isinstance(value, tuple):
            inside = dict(zip(CHANNELS, value, strict=True))
        if isinstance(inside, Mapping):
            row |= flat(inside, f"{prefix}{name}.")
        else:
            row[f"{prefix}{name}"] = value
    return row


def write_report(folder: Path, tables: Mapping[str, Sequence[Row]], report: Row) -> None:
    """Write tables as CSV by their names (none without rows), and ``evaluation.json``.

    Numbers that are not finite are empty fields in CSV and null in JSON.
    """
    for name, rows in tables.items():
        if rows:
            (folder / f"{name}.csv").write_text(as_csv(rows), encoding="utf-8")
    text = json.dumps(_plain(report), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "evaluation.json").write_text(text + "\n", encoding="utf-8")


def as_csv(rows: Sequence[Row]) -> str:
    """Return rows as CSV text with a header; numbers that are not finite are empty fields."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: cell(value) for name, value in _plain(row).items()} for row in rows)
    return stream.getvalue()


def as_text(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table for the terminal: first column aligned left, the others right."""
    lines = [head, *([f"  {row[0]}", *row[1:]] for row in rows)]
    widths = [max(map(len, column)) for column in zip_longest(*lines, fillvalue="")]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]).rstrip()
        for line in lines)


def number(value: float, digits: int) -> str:
    """Format a number with so many decimals; a dash if it is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else UNKNOWN


def told(config: PipelineConfig) -> dict[str, Any]:
    """Return the parameters of a study's pipeline except threads, which change no result."""
    return {name: value for name, value in config.to_parameters().items() if name != "threads"}


def _plain(value: Any) -> Any:
    """Return nested values in JSON's types: dataclasses as objects, not finite numbers as null."""
    if is_dataclass(value):
        value = vars(value)
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (bool, str)) or value is None:
        return value
    if float(value).is_integer() and not isinstance(value, float):
        return int(value)
    return float(value) if math.isfinite(value) else None
