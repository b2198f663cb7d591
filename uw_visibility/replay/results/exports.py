# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table of a replay in the formats that were asked for: GeoJSON, and Parquet with units."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import needing
from uw_visibility.replay.columns import CHANNELS, TRANSECT, Column
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.results.netcdf import import_netcdf, write_netcdf
from uw_visibility.replay.table import read_rows, slices
from uw_visibility.water.derived import DerivedModel

QUANTITIES = (
    *(f"attenuation_{channel}" for channel in CHANNELS), "mean_attenuation",
    "visibility_distance", "depth", "black_disc_visibility", "secchi_depth",
)
PROPERTIES = (
    "datetime", "status", "visibility_status", "depth_status", "reason",
    *(f"{prefix}{name}{end}" for name in QUANTITIES for prefix in ("", "filtered_")
      for end in ("", "_stddev")),
    "water_type", "filtered_water_type", "filtering", "sensor_depth", "plausibility",
)
"""Columns that points have: estimates of the frame alone and filtered, with their deviations."""


def check_exports(options: ReplayOptions) -> None:
    """Import what the formats need, before the work rather than after it.

    Raises
    ------
    InputError
        Saying how to install what is missing.
    """
    if options.netcdf:
        import_netcdf()
    if options.parquet:
        _import_parquet()


def write_exports(
    folder: Path, columns: Mapping[str, Column], attributes: Mapping[str, Any],
    options: ReplayOptions, transects: Sequence[str] = (),
) -> None:
    """Write the table that lies in a folder in the formats that were asked for.

    Parameters
    ----------
    folder : Path
        Holds ``frames.csv``.
    columns : mapping of str to Column
        Of the table.
    attributes : mapping of str to object
        Provenance, for the files' metadata.
    options : ReplayOptions
        Which formats, and what was joined.
    transects : sequence of str
        Names of the recordings, of a table of several.
    """
    table = folder / "frames.csv"
    if options.geo:
        more = [TRANSECT] * bool(transects) + [join.column for join in options.joins]
        write_geojson(folder / "frames.geojson", read_rows(table), more)
    if options.netcdf:
        wavelengths = DerivedModel.from_config(options.pipeline).effective_wavelengths
        write_netcdf(folder / "frames.nc", table, columns, attributes, wavelengths, transects)
    if options.parquet:
        _write_parquet(folder / "frames.parquet", table, columns, attributes)


def write_geojson(
    path: Path, rows: Iterator[Mapping[str, str]], more: Sequence[str] = ()
) -> int:
    """Write frames with a longitude and a latitude as points (RFC 7946).

    Parameters
    ----------
    path : Path
        File to write.
    rows : iterator of mapping
        Rows of the table, as text; empty for what is not known.
    more : sequence of str
        Columns to write beside `PROPERTIES`.

    Returns
    -------
    int
        Number of points.
    """
    count = 0
    with path.open("w", encoding="utf-8") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for row in rows:
            if not row["longitude"]:
                continue
            feature = {
                "type": "Feature",
                "geometry": {
                    "type": "Point",
                    "coordinates": [float(row["longitude"]), float(row["latitude"])],
                },
                "properties": {
                    "stamp": row["stamp"], "frame": int(row["frame"]),
                    **{name: _value(row[name]) for name in (*PROPERTIES, *more)},
                },
            }
            file.write(("," if count else "") + "\n" + json.dumps(feature, allow_nan=False))
            count += 1
        file.write("\n]}\n")
    return count


def _value(text: str) -> float | str | None:
    try:
        return float(text) if text else None
    except ValueError:
        return text


def _write_parquet(
    path: Path, table: Path, columns: Mapping[str, Column], attributes: Mapping[str, Any]
) -> None:
    """Write a table as Parquet, a row group for each slice, with what each column is."""
    arrow, parquet = _import_parquet()
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


def _import_parquet() -> tuple[Any, Any]:
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
