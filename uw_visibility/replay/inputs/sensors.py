# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Positions, and numbers of any topic, interpolated at the stamps of frames."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.plausibility.comparison import Value, interpolate
from uw_visibility.plausibility.monitor import RESTART_NANOSECONDS
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.inputs.topics import check_topic
from uw_visibility.replay.line_fit import LARGEST

# Longest gap between positions for interpolation, s.
LONGEST_GAP = 10.0
# Mean radius of the earth, m (IUGG), accurate enough for the extent of a dive.
EARTH_RADIUS = 6371008.8


class Track(Generic[Value]):
    """Buffer of values of a sensor in the order of stamps, for interpolation at stamps of frames.

    Gaps longer than `longest_gap`, s, are not interpolated. A value that is not newer than the
    last one is dropped; after a jump back by more than a second the buffer is cleared.
    """

    def __init__(self, longest_gap: float) -> None:
        self._longest = longest_gap
        self._values: deque[Value] = deque()

    def add(self, value: Value) -> None:
        newest = self._values[-1].stamp if self._values else value.stamp - 1
        if value.stamp < newest - RESTART_NANOSECONDS:
            self._values.clear()
        elif value.stamp <= newest:
            return
        self._values.append(value)

    def settles(self, stamp: int, newest: int) -> bool:
        """Return whether no later value changes that at a stamp, ns.

        newest: stamp of the newest frame: values after it are too far from those before `stamp`, if
        it is later by more than the longest gap. If it is earlier by as much, the clock was set
        back, or `stamp` is wrong.
        """
        reached = bool(self._values) and self._values[-1].stamp >= stamp
        return reached or abs(newest - stamp) > self._longest * 1e9

    def at(self, stamp: int) -> Value | None:
        """Return the value at a stamp, linear between its neighbours; None without these."""
        return interpolate(self._values, stamp, self._longest)

    def forget_before(self, stamp: int) -> None:
        """Drop values that are not needed from this stamp on."""
        while len(self._values) > 1 and self._values[1].stamp <= stamp:
            self._values.popleft()


class Position(NamedTuple):
    """Position at a stamp (ns): longitude and latitude in degrees if `geographic`, or metres."""

    stamp: int
    geographic: bool
    x: float
    y: float

    def towards(self, after: Position, share: float, stamp: int) -> Position:
        """Return the position at a stamp, a share of the way to a later one."""
        # Unwrap longitudes across the date line.
        end = wrap_longitude(after.x - self.x) + self.x if after.geographic else after.x
        x, y = self.x + share * (end - self.x), self.y + share * (after.y - self.y)
        return Position(stamp, after.geographic, wrap_longitude(x) if after.geographic else x, y)


def read_position(message: Any) -> Position | None:
    """Read a NavSatFix or an Odometry; None without a fix.

    Raises `InputError` if a fix is not on Earth.
    """
    stamp = stamp_to_nanoseconds(message.header.stamp)
    is_fix = hasattr(message, "latitude")
    if is_fix and message.status.status < 0:
        return None
    place = message if is_fix else message.pose.pose.position
    x, y = map(float, (place.longitude, place.latitude) if is_fix else (place.x, place.y))
    if not (math.isfinite(x) and math.isfinite(y)):
        return None
    if is_fix and (abs(y) > 90.0 or abs(x) > 360.0):
        raise InputError(
            "a fix has a latitude beyond 90 or a longitude beyond 360 degrees: publish degrees, "
            "WGS 84")
    return Position(stamp, is_fix, wrap_longitude(x) if is_fix else x, y)


def wrap_longitude(degrees: float) -> float:
    """Wrap a longitude to -180 to 180 degrees."""
    return degrees if -180.0 <= degrees <= 180.0 else (degrees + 180.0) % 360.0 - 180.0


def geographic(x: float, y: float, origin: tuple[float, float]) -> tuple[float, float]:
    """Return longitude and latitude of a point east and north (m) of an origin (lat, lon)."""
    latitude, longitude = origin
    north = math.degrees(y / EARTH_RADIUS)
    east = math.degrees(x / (EARTH_RADIUS * math.cos(math.radians(latitude))))
    return wrap_longitude(longitude + east), latitude + north


LONGEST_TOLERANCE = 3600.0
_DEEPEST = 6
# Fields that are not measurements.
_NO_VALUES = ("header", "layout", "variance")
# Messages with numbers that describe an image or a cloud.
_LARGE = ("Image", "CompressedImage", "CameraInfo", "DisparityImage", "PointCloud2", "LaserScan")


@dataclass(frozen=True)
class ScalarTopic:
    """A number in the messages of a topic."""

    topic: str
    # path of the field: names and indices separated by dots; empty for the only number
    field: str = ""
    unit: str = ""  # in UDUNITS notation; empty if unknown

    @classmethod
    def parse(cls, text: str) -> ScalarTopic:
        """Parse ``TOPIC`` or ``TOPIC.path.of.field``, with ``=unit``; topic names have no dots."""
        name, told, unit = text.partition("=")
        topic, _, field = name.partition(".")
        if not topic or name.endswith(".") or ".." in name or (told and not unit.strip()):
            raise InputError(
                f"--join is {text!r}: give a topic, its field if it has several numbers, and the "
                "unit of UDUNITS if known, as in /ctd.temperature=degC")
        return cls(topic, field, unit)

    def __str__(self) -> str:
        return f"{self.topic}.{self.field}" if self.field else self.topic

    @property
    def column(self) -> str:
        """Name of the column in the table."""
        return "joined_" + re.sub(r"\W+", "_", str(self)).strip("_").lower()

    def read(self, message: Any, arrival: int) -> ScalarValue:
        """Read the value of a message; without a header, its stamp is the time of arrival, ns."""
        value = self.number(message)
        if not abs(value) <= LARGEST:
            raise InputError(f"{self} is {value:g}: only finite numbers are joined, of up to "
                             f"{LARGEST:.2g}")
        header = getattr(message, "header", None)
        stamp = 0 if header is None else stamp_to_nanoseconds(header.stamp)
        return ScalarValue(self, stamp or arrival, value)

    def number(self, message: Any) -> float:
        """Return the number in a message; `InputError` without the field."""
        if not self.field:
            found = list(_numbers(message, ""))
            if len(found) != 1:
                names = ", ".join(f"{self.topic}.{name}" for name, _ in found[:8]) or "none"
                raise InputError(
                    f"{self.topic} has {len(found) or 'no'} numbers: name one of them, {names}")
            return found[0][1]
        value = message
        for part in self.field.split("."):
            value = _part(value, part)
        if not _is_number(value):
            raise InputError(f"{self.topic} has no number {self.field}")
        return float(value)


class ScalarValue(NamedTuple):
    """A value of a joined topic at a stamp, ns."""

    source: ScalarTopic
    stamp: int
    value: float

    def towards(self, after: ScalarValue, share: float, stamp: int) -> ScalarValue:
        """Return the value at a stamp, a share of the way to a later one."""
        return ScalarValue(self.source, stamp, self.value + share * (after.value - self.value))


def numbers_of(reader: BagReader, topic: str) -> list[str]:
    """Return the paths of the numbers in messages of a topic; none for images and clouds."""
    if reader.channels[topic].type.rpartition("/")[2] in _LARGE:
        return []
    message = next(reader.messages([topic]), None)
    if message is None:
        return []
    try:
        return [name for name, _ in _numbers(reader.deserialize(message), "")]
    except InputError:
        return []


def check_join(reader: BagReader, join: ScalarTopic) -> None:
    """Refuse a number that is missing in the first message of its topic."""
    check_topic(reader.channels, join.topic)
    first = next(reader.messages([join.topic]), None)
    if first is not None:
        join.number(reader.deserialize(first))


def _part(value: Any, part: str) -> Any:
    """Return a field, or an element of an array; None if missing."""
    if part.isdigit():
        try:
            return value[int(part)]
        except (TypeError, IndexError, KeyError):
            return None
    return None if part.startswith("_") else getattr(value, part, None)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool)


def _numbers(value: Any, path: str, depth: int = 0) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message by their paths, without headers, variances, constants."""
    for name in getattr(type(value), "__dataclass_fields__", {}):
        if name in _NO_VALUES or name.startswith("_") or name.isupper():
            continue
        inner = getattr(value, name)
        where = f"{path}.{name}" if path else name
        if _is_number(inner):
            yield where, float(inner)
        elif depth < _DEEPEST:
            yield from _numbers(inner, where, depth + 1)
