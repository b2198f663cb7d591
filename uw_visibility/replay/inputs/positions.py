# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Positions of the camera from NavSatFix or Odometry, and tracks of what sensors say."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, Generic, NamedTuple

from uw_visibility.errors import InputError
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.plausibility.comparison import Value, neighbours

# Positions further apart than this are not neighbours, s.
LONGEST_GAP = 10.0
# Mean radius of the earth, m (IUGG), enough for the extent of a dive.
EARTH_RADIUS = 6371008.8


class Track(Generic[Value]):
    """Buffer of values by rising stamp, between which frames are placed.

    Parameters
    ----------
    longest_gap : float
        Values further apart than this are not neighbours, s.
    """

    def __init__(self, longest_gap: float) -> None:
        self._longest = longest_gap
        self._values: deque[Value] = deque()

    def add(self, value: Value) -> None:
        """Take a value; a stamp that goes back begins anew."""
        if self._values and value.stamp < self._values[-1].stamp:
            self._values.clear()
        self._values.append(value)

    def reaches(self, stamp: int) -> bool:
        """Tell whether values go as far as a stamp."""
        return bool(self._values) and self._values[-1].stamp >= stamp

    def follows(self, stamp: int) -> bool:
        """Tell whether values begin after a stamp, or there are none."""
        return not self._values or self._values[0].stamp > stamp

    def forget_before(self, stamp: int) -> None:
        """Drop what is not needed for stamps from this one on."""
        while len(self._values) > 1 and self._values[1].stamp <= stamp:
            self._values.popleft()

    def around(self, stamp: int) -> tuple[Value, Value, float] | None:
        """Return the neighbours of a stamp, and which part of the way it is; None without any."""
        return neighbours(self._values, stamp, self._longest)


class Position(NamedTuple):
    """Position at a stamp (ns).

    Attributes
    ----------
    stamp : int
    geographic : bool
        Whether the coordinates are longitude and latitude in degrees, or metres.
    x, y, z : float
        Longitude or x, latitude or y, and height.
    """

    stamp: int
    geographic: bool
    x: float
    y: float
    z: float


def read_position(message: Any) -> Position | None:
    """Read a NavSatFix or an Odometry; None where it has no fix.

    Raises
    ------
    InputError
        If a fix is nowhere on Earth.
    """
    stamp = stamp_to_nanoseconds(message.header.stamp)
    if hasattr(message, "latitude"):
        if message.status.status < 0:
            return None
        values = (message.longitude, message.latitude, message.altitude)
    else:
        point = message.pose.pose.position
        values = (point.x, point.y, point.z)
    x, y, z = (float(v) for v in values)
    if not (math.isfinite(x) and math.isfinite(y)):
        return None
    if not hasattr(message, "latitude"):
        return Position(stamp, False, x, y, z)
    if abs(y) > 90.0 or abs(x) > 360.0:
        raise InputError(
            "a fix has a latitude beyond 90 or a longitude beyond 360 degrees: publish degrees, "
            "WGS 84")
    return Position(stamp, True, wrap_longitude(x), y, z)


def wrap_longitude(degrees: float) -> float:
    """Return a longitude as one from -180 up to 180 degrees."""
    return degrees if -180.0 <= degrees <= 180.0 else (degrees + 180.0) % 360.0 - 180.0


class PositionTrack(Track[Position]):
    """Track of positions."""

    def __init__(self) -> None:
        super().__init__(LONGEST_GAP)

    def lack(self, stamp: int) -> str:
        """Say why there is no position at a stamp."""
        if self.follows(stamp):
            return "before the first fix"
        if not self.reaches(stamp):
            return "beyond the last fix"
        return f"between fixes more than {LONGEST_GAP:g} s apart"

    def at(self, stamp: int) -> Position | None:
        """Return the position at a stamp, linear between its neighbours."""
        found = self.around(stamp)
        if found is None:
            return None
        before, after, share = found
        # Across the date line longitudes differ by 360 degrees more than they are apart.
        end = wrap_longitude(after.x - before.x) + before.x if after.geographic else after.x
        x, y, z = (
            a + share * (b - a)
            for a, b in zip(before[2:], (end, after.y, after.z), strict=True)
        )
        return Position(
            stamp, after.geographic, wrap_longitude(x) if after.geographic else x, y, z)


def geographic(x: float, y: float, origin: tuple[float, float]) -> tuple[float, float]:
    """Return longitude and latitude of a point east and north (m) of an origin (lat, lon)."""
    latitude, longitude = origin
    north = math.degrees(y / EARTH_RADIUS)
    east = math.degrees(x / (EARTH_RADIUS * math.cos(math.radians(latitude))))
    return wrap_longitude(longitude + east), latitude + north
