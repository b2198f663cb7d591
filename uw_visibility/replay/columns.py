# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Columns of frames.csv: one dictionary for the table, NetCDF, Parquet and the report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Literal

from uw_visibility.messages.stamps import iso_time, seconds
from uw_visibility.optics.water_type import TYPES
from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.status import Status
from uw_visibility.water.meaning.derived import QUANTITIES
from uw_visibility.water.series.tracking import TrackingEvent

FAILED = "unusable"
"""Status of frames that gave no result; the column ``reason`` says why."""

CHANNELS = ("red", "green", "blue")
DIFFUSE = "volume_attenuation_coefficient_of_downwelling_radiative_flux_in_sea_water"

Kind = Literal["integer", "number", "text", "choice", "datetime"]


@dataclass(frozen=True)
class Column:
    kind: Kind  # ``"choice"`` is a text that is one of `choices`
    title: str  # short description
    unit: str = ""  # in UDUNITS notation; ``"1"`` for a number without one, empty for texts
    description: str = ""  # definition, caveat and source, beyond the title
    standard_name: str = ""  # of the CF conventions, if there is one
    choices: tuple[str, ...] = ()  # possible words; empty if unknown
    meanings: tuple[str, ...] = ()  # sentences for `choices` in reports and messages
    stddev_of: str = ""  # column of which this is the standard deviation
    status: str = ""  # column with the reason for a missing value
    # path of the value, as in ``"estimate.water.attenuation.0"``: from an attribute of a
    # `JoinedFrame`, or from values that the recorder adds
    source: str = ""

    def meaning(self, choice: str) -> str:
        """Return the sentence for a choice in reports and messages."""
        return dict(zip(self.choices, self.meanings, strict=True)).get(choice, choice)

    def text(self, sources: Mapping[str, Any]) -> str:
        """Return the text in the table for a frame; empty if unknown.

        Reading a number back gives the same bits.
        """
        first, *path = self.source.split(".")
        value = sources[first]
        for name in path:
            if value is None:
                return ""
            value = value[int(name)] if name.isdigit() else getattr(value, name)
        if self.kind == "datetime":
            return iso_time(value)
        if self.standard_name == "time":  # in ns, unlike a duration that is joined
            return seconds(value)
        if self.kind == "number":
            return repr(float(value)) if value is not None and math.isfinite(value) else ""
        return word(value) if isinstance(value, Enum) else str(value if value is not None else "")


def word(value: Enum) -> str:
    """Return the stable word of a status, verdict or event in tables.

    Sentences of statuses may change, and the CF conventions allow only words.
    """
    return value.name.lower() if isinstance(value, Status) else str(value).replace(" ", "_")


def _integer(source: str, title: str, standard_name: str = "") -> Column:
    return Column("integer", title, "1", "", standard_name, source=source)


def _number(
    source: str, title: str, unit: str, description: str = "", standard_name: str = "",
    status: str = "",
) -> Column:
    return Column(
        "number", title, unit, description, standard_name, status=status, source=source)


def _choice(source: str, title: str, choices: type[Enum], **more: str) -> Column:
    return Column(
        "choice", title, choices=(*map(word, choices), *more),
        meanings=(*map(str, choices), *more.values()), source=source)


def _with_stddev(name: str, column: Column) -> dict[str, Column]:
    """Return a column of numbers and that of their standard deviations."""
    error = f"{column.standard_name} standard_error" if column.standard_name else ""
    return {
        name: column,
        f"{name}_stddev": Column(
            "number", f"standard deviation of {column.title}", column.unit, "", error,
            stddev_of=name, source=f"{column.source}_stddev"),
    }


def _interval(name: str, source: str, title: str) -> dict[str, Column]:
    """Return the columns of a distance's 16 and 84 % quantiles."""
    return {
        f"{name}_{end}": _number(
            f"{source}_{end}", f"{title}, {quantile} % quantile", "m",
            "Attenuation is uncertain by a factor, so that the distance is farther above its "
            "median than below")
        for end, quantile in (("low", 16), ("high", 84))
    }


def _by_channel(name: str, array: Column, of: str = "") -> dict[str, Column]:
    """Return the columns of an array and its standard deviations, for each channel."""
    found: dict[str, Column] = {}
    for index, channel in enumerate(CHANNELS):
        column = replace(array, title=f"{array.title}, {channel} channel{of}")
        for each, described in _with_stddev(f"{name}_{channel}", column).items():
            found[each] = replace(described, source=f"{described.source}.{index}")
    return found


def _attenuation(prefix: str, source: str, of: str) -> dict[str, Column]:
    return _by_channel(f"{prefix}attenuation", _number(
        f"{source}.water.attenuation", "attenuation β", "m-1",
        "Attenuation of the light of surfaces, as seen by the channel of the camera (Roser et al. "
        "2014, eq. 1); beam attenuation c is larger, see beam_attenuation",
        status="" if prefix else "status"), of)


def _visibility(prefix: str, source: str, of: str) -> dict[str, Column]:
    return {
        **_with_stddev(f"{prefix}mean_attenuation", _number(
            f"{source}.visibility.mean_attenuation", f"mean attenuation α{of}", "m-1",
            "Attenuation beyond that of clear sea water, mean over the channels that have light "
            "(Roser et al. 2014, eq. 9)", status="" if prefix else "status")),
        **_with_stddev(f"{prefix}visibility_distance", _number(
            f"{source}.visibility.distance", f"visibility distance{of}", "m",
            "Distance at which a white and a black patch side by side have a Michelson contrast C "
            "of parameter assessment.contrast, by default 5 %, in the clearest channel, if the "
            "veil is as bright as the light: ln((1 - C)/(2 C) + 1)/min β, 2.35/min β "
            "(Roser et al. 2014, eq. 11-12)",
            status="" if prefix else "visibility_status")),
        **_interval(
            f"{prefix}visibility_distance", f"{source}.visibility.distance",
            f"visibility distance{of}"),
        **_with_stddev(f"{prefix}depth", _number(
            f"{source}.visibility.depth", f"depth of the camera by the colour of daylight{of}",
            "m", "Positive down (Roser et al. 2014, eq. 13-14)", "depth",
            "" if prefix else "depth_status")),
    }


# None for attenuation as a camera sees it: CF's beam attenuation is the sum of absorption and
# scattering, about twice as much.
_STANDARD_NAMES = {
    "diffuse_attenuation_490": DIFFUSE, "secchi_depth": "secchi_depth_of_sea_water",
}


def _derived(prefix: str, of: str) -> dict[str, Column]:
    source = f"{prefix}derived"
    found: dict[str, Column] = {}
    for name, quantity in QUANTITIES.items():
        found |= _with_stddev(f"{prefix}{name}", _number(
            f"{source}.{name}", f"{quantity.title}{of}", quantity.unit,
            f"{quantity.definition}. {quantity.caveat} Source: {quantity.source}.",
            _STANDARD_NAMES.get(name, ""), f"{prefix}water_type_status"))
    disc = "black_disc_visibility"
    return {
        **found,
        **_interval(f"{prefix}{disc}", f"{source}.{disc}", f"{QUANTITIES[disc].title}{of}"),
        f"{prefix}water_type": Column(
            "choice", f"nearest Jerlov water type{of}", choices=TYPES, meanings=TYPES,
            description="By the likelihood of the attenuation in the three channels",
            source=f"{source}.water_type"),
        f"{prefix}water_type_likelihood": _number(
            f"{source}.water_type_likelihood", f"likelihood of that type{of}", "1",
            "Its share of the likelihood of all ten types"),
        f"{prefix}water_type_status": _choice(
            f"{source}.water_type_status", f"whether the water type was assessed{of}, or why not",
            Status),
    }


FILTERED = ", filtered over frames"

COLUMNS: dict[str, Column] = {
    "frame": _integer("record.frame", "number of the frame in the recording"),
    "datetime": Column(
        "datetime", "stamp of the left image", description="UTC, ISO 8601",
        source="record.stamp"),
    "stamp": _number(
        "record.stamp", "stamp of the left image", "s", "Since 1970, UTC, to the nanosecond",
        "time"),
    "right_stamp": _number(
        "record.right_stamp", "stamp of the right image", "s", "As stamp", "time"),
    "time": _number(
        "record.time", "time at which the left image was received", "s", "As stamp", "time"),
    "status": _choice(
        "estimate.water.status", "whether attenuation was assessed, or why not", Status,
        **{FAILED: "the frame has no result; the column reason says why"}),
    "visibility_status": _choice(
        "estimate.visibility.status", "whether visibility was assessed, or why not", Status),
    "depth_status": _choice(
        "estimate.visibility.depth_status", "whether depth was assessed, or why not", Status),
    "reason": Column("text", "why the frame has no result", source="record.reason"),
    **_attenuation("", "estimate", ""),
    **_by_channel("ambient_light", _number(
        "estimate.water.ambient_light", "ambient light I∞", "1",
        "Irradiance of open water, 1 is the largest value of a pixel", status="status")),
    **_visibility("", "estimate", ""),
    "depth_precision": _number(
        "estimate.visibility.depth_precision",
        "part of depth's standard deviation that differs between frames", "m",
        "Without the errors of water type and white balance, which are the same in all frames"),
    **_derived("", ""),
    **_attenuation("filtered_", "filtered", FILTERED),
    **_visibility("filtered_", "filtered", FILTERED),
    **_derived("filtered_", FILTERED),
    "filtered_visibility_status": _choice(
        "filtered.visibility.status", f"whether visibility was assessed{FILTERED}, or why not",
        Status),
    "filtering": _choice(
        "filtered.event", "effect of the frame on the state of the filter", TrackingEvent),
    "survey_frames": _integer(
        "filtered.survey.frames", "frames of the survey that gives the filtered state",
        "number_of_observations"),
    "survey_range_min": _number(
        "filtered.survey.range_min", "least range of the survey", "m"),
    "survey_range_max": _number(
        "filtered.survey.range_max", "largest range of the survey", "m"),
    "range_min": _number("estimate.ranges.0", "least range used for attenuation", "m"),
    "range_max": _number("estimate.ranges.1", "largest range used for attenuation", "m"),
    "support_points": _integer(
        "estimate.support_points", "support points of step 1", "number_of_observations"),
    "coverage": _number(
        "estimate.coverage", "part of the left image covered by their mesh", "1"),
    "matched_fraction": _number(
        "estimate.matched_fraction", "matched part of the left image", "1"),
    "matched_fraction_original": _number(
        "estimate.matched_fraction_original", "matched part without restoration", "1"),
    "limited_fraction": _number(
        "estimate.limited_fraction", "part of the pixels whose gain was limited", "1"),
    **_with_stddev("sensor_depth", _number(
        "sensor.depth", "depth by the depth sensor", "m", "Positive down", "depth")),
    "innovation": _number(
        "comparison.innovation",
        "sensor minus estimate, minus the difference predicted from earlier frames", "m",
        "Of depth: positive where the sensor says deeper"),
    "nis": _number("comparison.nis", "squared innovation over its variance", "1"),
    "plausibility": _choice("verdict", "verdict on the depth sensor", Verdict),
    "plausibility_reason": Column("text", "why the verdict is not ok", source="verdict_reason"),
    "longitude": _number("longitude", "longitude", "degrees_east", "WGS 84", "longitude"),
    "latitude": _number("latitude", "latitude", "degrees_north", "WGS 84", "latitude"),
    "x": _number("x", "position x of the recorded Odometry", "m"),
    "y": _number("y", "position y of the recorded Odometry", "m"),
}
"""Columns of ``frames.csv`` by name, in order; empty cells are unknown."""

TURBIDITY = {
    name: column for prefix, of in (("", ""), ("filtered_", FILTERED))
    for name, column in _with_stddev(f"{prefix}turbidity", _number(
        f"{prefix}turbidity", f"turbidity{of}", "1",
        "FNU of the user's own sensor, by a line fitted to it over the beam attenuation of the "
        "green channel (replay --turbidity)", "sea_water_turbidity",
    )).items()
}
"""Columns added by a fit to a turbidity sensor."""

TRANSECT = "transect"
TRANSECT_COLUMN = Column("text", "recording of the frame", description="Name of its folder")
"""First column of tables of several recordings."""


def joined_column(title: str, index: int, unit: str = "") -> Column:
    """Return the column of the joined topic at an index."""
    return _number(
        f"scalars.{index}", f"{title}, at the stamp of the frame", unit,
        "" if unit else "In the unit of the recording")
