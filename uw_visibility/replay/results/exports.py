# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Table of a replay as GeoJSON, Parquet with units, and NetCDF (Climate and Forecast, CF)."""

from __future__ import annotations

import importlib
import json
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import cell, needing
from uw_visibility.images.arrays import Array
from uw_visibility.messages.stamps import iso_time, seconds
from uw_visibility.optics.spectra import load_response
from uw_visibility.optics.water_type import DIFFUSE_WAVELENGTH, effective_wavelengths
from uw_visibility.replay.columns import CHANNELS, TRANSECT, Column
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.results.provenance import texts_of
from uw_visibility.replay.table import Columns

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
"""Properties of points: single and filtered estimates with standard deviations."""


def check_exports(options: ReplayOptions) -> None:
    """Import the libraries of the formats before the work begins."""
    if options.netcdf:
        _import_netcdf()
    if options.parquet:
        _import_parquet()


def write_exports(
    folder: Path, table: Columns, columns: Mapping[str, Column],
    attributes: Mapping[str, Any], options: ReplayOptions, transects: Sequence[str] = (),
) -> None:
    """Write a table of `read_table` in the requested formats; parameters as of `write_netcdf`."""
    if options.geo:
        more = [TRANSECT] * bool(transects) + [join.column for join in options.joins]
        write_geojson(folder / "frames.geojson", table, more)
    if options.netcdf:
        wavelengths = effective_wavelengths(load_response(options.pipeline.camera.response))
        write_netcdf(
            folder / "frames.nc", table, columns, attributes, wavelengths, transects,
            options.attributes)
    if options.parquet:
        _write_parquet(folder / "frames.parquet", table, columns, attributes)


def write_geojson(
    path: Path, table: Columns, more: Sequence[str] = ()
) -> None:
    """Write frames with a position as points, with `PROPERTIES` and `more` (RFC 7946)."""
    before = "\n"
    with path.open("w", encoding="utf-8") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for place in np.flatnonzero(np.isfinite(table["longitude"])):
            feature = {
                "type": "Feature",
                "geometry": {
                    "type": "Point",
                    "coordinates": [
                        float(table[axis][place]) for axis in ("longitude", "latitude")],
                },
                "properties": {
                    "stamp": seconds(int(table["datetime"][place])),
                    "frame": int(table["frame"][place]),
                    **{name: _value(table[name][place]) for name in (*PROPERTIES, *more)},
                },
            }
            file.write(before + json.dumps(feature, allow_nan=False))
            before = ",\n"
        file.write("\n]}\n")


def _value(value: Any) -> float | str | None:
    if isinstance(value, np.integer):
        return iso_time(int(value))
    if isinstance(value, str):
        return value or None
    return float(value) if np.isfinite(value) else None


def _write_parquet(
    path: Path, table: Columns, columns: Mapping[str, Column],
    attributes: Mapping[str, Any],
) -> None:
    """Write a table as Parquet, with metadata of columns; texts are as in ``frames.csv``."""
    arrow, parquet = _import_parquet()
    types = {
        "integer": arrow.int64(), "number": arrow.float64(),
        "datetime": arrow.timestamp("ns", tz="UTC"),
    }
    schema = arrow.schema(
        [
            arrow.field(name, types.get(column.kind, arrow.string()), metadata=_metadata(column))
            for name, column in columns.items()
        ],
        metadata=texts_of(attributes),
    )
    parquet.write_table(arrow.table([
        arrow.array(
            [cell(text) or None for text in values] if values.dtype == object else values,
            field.type, from_pandas=True)
        for field, values in ((field, table[field.name]) for field in schema)
    ], schema=schema), path)


def _import_parquet() -> list[Any]:
    with needing("parquet", "--parquet"):
        return list(map(importlib.import_module, ("pyarrow", "pyarrow.parquet")))


def _metadata(column: Column) -> dict[str, str]:
    found = {
        "title": column.title, "unit": column.unit, "description": column.description,
        "standard_name": column.standard_name,
        "values": json.dumps(dict(zip(column.choices, column.meanings, strict=True)))
        if column.choices else "",
    }
    return {key: value for key, value in found.items() if value}


CONVENTIONS = "CF-1.11, ACDD-1.3"
DIMENSION = "obs"
# Differs from the variable's name: CF coordinate variables must be numeric.
INSTANCES = "transects"
WAVELENGTH_OF_DIFFUSE = "wavelength_diffuse"
COORDINATES = ("datetime", "longitude", "latitude", "sensor_depth", "frame", "x", "y")
"""Columns of time, position and number of the frame."""
# Rows per compressed chunk.
ROWS = 1024
_UNKNOWN = np.int8(-1)

_EPOCH = "seconds since 1970-01-01 00:00:00"
_NAMES = {"datetime": "time", "longitude": "lon", "latitude": "lat", "time": "time_received"}
"""Names in NetCDF of columns that have another name there."""


def write_netcdf(
    path: Path,
    table: Columns,
    columns: Mapping[str, Column],
    attributes: Mapping[str, Any],
    wavelengths: Array,
    transects: Sequence[str] = (),
    given: Mapping[str, str] | None = None,
) -> None:
    """Write a table as a CF trajectory, with the attributes of the ACDD.

    CF 1.11, chapter 9 (https://cfconventions.org); ACDD 1.3
    (https://wiki.esipfed.org/Attribute_Convention_for_Data_Discovery_1-3).

    attributes: provenance; values other than text are written as JSON.
    wavelengths: (3,) float64, effective wavelengths of the channels, nm.
    transects: names of several recordings, in the column `TRANSECT`: an indexed ragged array
        (chapter H.4.4).
    given: global attributes of the user, which override those of this package.
    """
    xarray = _import_netcdf()
    values = {_name(name): _values(table[name], column) for name, column in columns.items()}
    if transects:
        place = {name: number for number, name in enumerate(transects)}
        values[TRANSECT] = np.array([place[name] for name in table[TRANSECT]], np.int32)
    xarray.Dataset(
        {
            _name(name): (DIMENSION, values[_name(name)], _attributes(name, columns))
            for name in columns
        } | _scalars(wavelengths, transects or str(attributes["bag"])),
        attrs=_global(attributes) | _bounds(values) | dict(given or {}),
    ).to_netcdf(
        path, engine="netcdf4", format="NETCDF4", unlimited_dims=[DIMENSION],
        encoding={
            _name(name): _encoding(column) for name, column in columns.items()
            if name != TRANSECT
        }
        | {name: {"_FillValue": None} for name in (
            *(f"wavelength_{channel}" for channel in CHANNELS), WAVELENGTH_OF_DIFFUSE)},
    )


def _bounds(values: Mapping[str, NDArray]) -> dict[str, str | float]:
    """Return the attributes of the extent in time and space, from known values."""
    known = {}
    for name in map(_name, COORDINATES):
        finite = values[name][np.isfinite(values[name])]
        if finite.size:
            known[name] = float(finite.min()), float(finite.max())
    if not known:
        return {}
    start, end = known["time"]
    # Median, so that pauses and other recordings do not count.
    steps = np.abs(np.diff(values["time"])) if len(values["time"]) > 1 else np.zeros(1)
    found: dict[str, str | float] = {
        "time_coverage_start": iso_time(round(start * 1e9)),
        "time_coverage_end": iso_time(round(end * 1e9)),
        "time_coverage_duration": f"PT{end - start:.3f}S",
        "time_coverage_resolution": f"PT{np.median(steps):.3f}S",
    }
    if "lon" in known and known["lon"][1] - known["lon"][0] > 180.0:
        # Across the date line west is the larger longitude (ACDD 1.3, geospatial_lon_max).
        behind = values["lon"] < 0.0
        known["lon"] = float(np.nanmin(values["lon"][~behind])), float(values["lon"][behind].max())
    for name, kind, unit in (
        ("lat", "lat", "degrees_north"), ("lon", "lon", "degrees_east"),
        ("sensor_depth", "vertical", "m"),
    ):
        if name in known:
            found |= dict(zip(
                (f"geospatial_{kind}_{end}" for end in ("min", "max", "units")),
                (*known[name], unit), strict=True))
    if "lat" in known and "lon" in known:
        (south, north), (west, east) = known["lat"], known["lon"]
        parts = [(west, east)] if west <= east else [(west, 180.0), (-180.0, east)]
        boxes = ", ".join(_box(south, north, *part) for part in parts)
        found["geospatial_bounds"] = (
            f"POLYGON {boxes}" if len(parts) == 1 else f"MULTIPOLYGON ({boxes})")
        found["geospatial_bounds_crs"] = "EPSG:4326"
    if "sensor_depth" in known:
        # Depth below the water's surface at the time.
        found |= {"geospatial_vertical_positive": "down",
                  "geospatial_bounds_vertical_crs": "EPSG:5831"}
    return found


def _box(south: float, north: float, west: float, east: float) -> str:
    corners = ((south, west), (south, east), (north, east), (north, west), (south, west))
    return f"(({', '.join(f'{a!r} {b!r}' for a, b in corners)}))"


def _import_netcdf() -> Any:
    """Return xarray; InputError if it or netCDF4 is missing."""
    with needing("netcdf", "--netcdf"):
        importlib.import_module("netCDF4")
        return importlib.import_module("xarray")


def _name(column: str) -> str:
    return _NAMES.get(column, column)


def _values(values: NDArray, column: Column) -> NDArray:
    if column.kind == "datetime":
        return values / 1e9
    if column.kind == "choice":
        place = {text: number for number, text in enumerate(column.choices)}
        return np.array([place.get(text, _UNKNOWN) for text in values], np.int8)
    # Text columns of an empty table stay text.
    return values if len(values) or values.dtype != object else values.astype(str)


def _attributes(name: str, columns: Mapping[str, Column]) -> dict[str, Any]:
    column = columns[name]
    found: dict[str, Any] = {"long_name": column.title}
    if name == TRANSECT:
        return found | {"instance_dimension": INSTANCES}
    if column.standard_name:
        found["standard_name"] = column.standard_name
    if column.description:
        found["comment"] = column.description
    if column.kind == "datetime" or column.standard_name == "time":
        return found | {
            "standard_name": "time", "units": _EPOCH, "calendar": "standard",
            # Computer clocks have no leap seconds.
            "units_metadata": "leap_seconds: none",
        } | ({"axis": "T"} if column.kind == "datetime" else {})
    # As ISO 19115-1 names it.
    found["coverage_content_type"] = (
        "coordinate" if name in COORDINATES
        else "qualityInformation" if name.endswith(("_stddev", "_low", "_high", "status"))
        else "auxiliaryInformation" if column.unit in ("", "1") else "physicalMeasurement")
    if name not in COORDINATES:
        places = [_name(place) for place in COORDINATES if place in columns]
        found["coordinates"] = " ".join(places + _wavelength(name))
    if column.kind == "choice":
        told = [
            f"{choice}: {meaning}"
            for choice, meaning in zip(column.choices, column.meanings, strict=True)
            if meaning != choice.replace("_", " ")]
        if told:
            found["comment"] = ". ".join([column.description] * bool(column.description) + told)
        return found | {
            "flag_values": np.arange(len(column.choices), dtype=np.int8),
            "flag_meanings": " ".join(column.choices),
        }
    if column.unit:
        found["units"] = column.unit
    if column.standard_name == "depth":
        found["positive"] = "down"
    if name in ("longitude", "latitude"):
        found["axis"] = "X" if name == "longitude" else "Y"
    beside = [
        *(f"{name}_{end}" for end in ("stddev", "low", "high") if f"{name}_{end}" in columns),
        *[column.status] * bool(column.status)]
    if beside:
        found["ancillary_variables"] = " ".join(beside)
    return found


def _wavelength(column: str) -> list[str]:
    """Name the variable of a column's wavelength, without which CF takes a sum over all."""
    if "diffuse_attenuation_490" in column:
        return [WAVELENGTH_OF_DIFFUSE]
    if "beam_attenuation" in column:
        return ["wavelength_green"]
    return [f"wavelength_{c}" for c in CHANNELS if f"attenuation_{c}" in column]


def _encoding(column: Column) -> dict[str, Any]:
    found: dict[str, Any] = {"chunksizes": (ROWS,)}
    if column.kind == "datetime":
        return found | {"_FillValue": None}
    if column.kind == "choice":
        return found | {"_FillValue": _UNKNOWN, "dtype": np.int8, "zlib": True}
    if column.kind in ("integer", "number"):
        return found | {"_FillValue": np.nan, "zlib": True}
    return found | {"dtype": str}


def _scalars(wavelengths: Array, identity: str | Sequence[str]) -> dict[str, Any]:
    """Variables in addition to observations: names of trajectories, wavelengths of channels."""
    several = not isinstance(identity, str)
    found: dict[str, Any] = {
        "trajectory": (
            INSTANCES if several else (), identity,
            {"cf_role": "trajectory_id", "long_name": "recording"}),
    }
    for channel, wavelength in zip(CHANNELS, wavelengths, strict=True):
        found[f"wavelength_{channel}"] = ((), float(wavelength), {
            "standard_name": "radiation_wavelength", "units": "nm",
            "long_name": f"effective wavelength of the {channel} channel in daylight",
        })
    found[WAVELENGTH_OF_DIFFUSE] = ((), DIFFUSE_WAVELENGTH, {
        "standard_name": "radiation_wavelength", "units": "nm",
        "long_name": "wavelength of the diffuse attenuation",
    })
    return found


def _global(attributes: Mapping[str, Any]) -> dict[str, str]:
    texts = texts_of(attributes)
    return {
        "Conventions": CONVENTIONS, "featureType": "trajectory",
        "title": "Water attenuation, visibility and depth from a stereo camera",
        "summary": "Attenuation of light by water in three colour channels, visibility, depth and "
        "derived quantities, with standard deviations: of single stereo pairs and filtered over "
        "pairs.",
        "keywords": "EARTH SCIENCE > OCEANS > OCEAN OPTICS > ATTENUATION/TRANSMISSION, EARTH "
        "SCIENCE > OCEANS > OCEAN OPTICS > SECCHI DEPTH",
        "keywords_vocabulary": "GCMD Science Keywords",
        "standard_name_vocabulary": "CF Standard Name Table v90",
        "processing_level": "geophysical quantities of single frames, and filtered over frames",
        # The same for the same recording and parameters.
        "id": str(uuid.uuid5(uuid.NAMESPACE_OID, texts["input_sha256"] + texts["parameters"])),
        "product_version": texts["version"],
        "source": "images of a stereo camera under water",
        "history": f"uw_visibility {texts['version']}, replay of {texts['bag']}",
        "references": "Roser, Dunbabin and Geiger, Simultaneous Underwater Visibility "
        "Assessment, Enhancement and Improved Stereo, ICRA 2014",
        "comment": "Values that could not be assessed are missing; their status has the reason. "
        "Positions are missing if none were recorded.",
        **{f"uw_visibility_{name}": text for name, text in texts.items()},
    }
