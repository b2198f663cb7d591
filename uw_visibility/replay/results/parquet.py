# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table of a replay as Parquet, with units and definitions in its fields' metadata."""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import needing
from uw_visibility.replay.columns import Column
from uw_visibility.replay.table import slices


def write_parquet(
    path: Path, table: Path, columns: Mapping[str, Column], attributes: Mapping[str, Any]
) -> None:
    """Write a table as Parquet, a row group for each slice of it.

    Parameters
    ----------
    path : Path
        File to write.
    table : Path
        The table.
    columns : mapping of str to Column
        Its columns.
    attributes : mapping of str to object
        Provenance, for the file's metadata.

    Raises
    ------
    InputError
        If pyarrow is not installed.
    """
    arrow, parquet = check_parquet()
    schema = arrow.schema(
        [
            arrow.field(name, _type(arrow, column), metadata=_metadata(column))
            for name, column in columns.items()
        ],
        metadata={
            key: value if isinstance(value, str) else json.dumps(value)
            for key, value in attributes.items()
        },
    )
    with parquet.ParquetWriter(path, schema) as writer:
        for part in slices(table, columns):
            arrays = [
                _array(arrow, part[field.name], field.type, columns[field.name])
                for field in schema
            ]
            writer.write_table(arrow.Table.from_arrays(arrays, schema=schema))


def check_parquet() -> tuple[Any, Any]:
    """Return pyarrow and its part for Parquet, before the work rather than after it.

    Raises
    ------
    InputError
        Saying how to install what is missing.
    """
    with needing("parquet", "--parquet"):
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")


def _type(arrow: Any, column: Column) -> Any:
    types = {
        "integer": arrow.int64(), "number": arrow.float64(),
        "datetime": arrow.timestamp("ns", tz="UTC"),
    }
    return types.get(column.kind, arrow.string())


def _array(arrow: Any, values: NDArray, kind: Any, column: Column) -> Any:
    if column.kind in ("integer", "number"):
        known = np.isfinite(values)
        numbers = np.where(known, values, 0.0).astype(
            np.int64 if column.kind == "integer" else np.float64)
        return arrow.array(numbers, kind, mask=~known)
    texts = [text or None for text in values]
    if column.kind == "datetime":
        stamps = [None if text is None else np.datetime64(text[:-1], "ns") for text in texts]
        return arrow.array(stamps, arrow.timestamp("ns")).cast(kind)
    return arrow.array(texts, kind)


def _metadata(column: Column) -> dict[str, str]:
    found = {
        "title": column.title, "unit": column.unit, "description": column.description,
        "standard_name": column.standard_name,
        "values": json.dumps(dict(zip(column.choices, column.meanings, strict=True)))
        if column.choices else "",
    }
    return {key: value for key, value in found.items() if value}
