# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scalars of any topic, joined to frames by time."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.inputs.positions import Track
from uw_visibility.replay.inputs.topics import check_topic

LONGEST_TOLERANCE = 3600.0
_DEEPEST = 6
# Fields that are no measurement.
_NO_VALUES = ("header", "layout", "variance")
# Messages whose numbers describe an image or a cloud.
_LARGE = ("Image", "CompressedImage", "CameraInfo", "DisparityImage", "PointCloud2", "LaserScan")


@dataclass(frozen=True)
class ScalarTopic:
    """A number in the messages of a topic.

    Attributes
    ----------
    topic : str
    field : str
        Path of the field, parts and indices with dots between; empty takes the only number.
    """

    topic: str
    field: str = ""

    @classmethod
    def parse(cls, text: str) -> ScalarTopic:
        """Read ``TOPIC`` or ``TOPIC.field.of.it``: names of topics have no dots.

        Raises
        ------
        InputError
            If there is no topic, or a part of the path is empty.
        """
        topic, _, field = text.partition(".")
        if not topic or text.endswith(".") or ".." in text:
            raise InputError(
                f"--join is {text!r}: give a topic, or a topic and a field as /ctd.temperature")
        return cls(topic, field)

    def __str__(self) -> str:
        return f"{self.topic}.{self.field}" if self.field else self.topic

    @property
    def column(self) -> str:
        """Name of the column in the table."""
        return "joined_" + re.sub(r"\W+", "_", str(self)).strip("_").lower()

    def read(self, message: Any, arrival: int) -> ScalarValue:
        """Read the value of a message.

        Parameters
        ----------
        message : object
            Of the topic.
        arrival : int
            When it was received, ns: its time where it has no header.

        Raises
        ------
        InputError
            If the field is absent, or no finite number.
        """
        value = self._value(message)
        if not math.isfinite(value):
            raise InputError(f"{self} is {value}: only finite numbers are joined")
        header = getattr(message, "header", None)
        stamp = 0 if header is None else stamp_to_nanoseconds(header.stamp)
        return ScalarValue(self, stamp or arrival, value)

    def check(self, message: Any) -> None:
        """Refuse a message without the field.

        Raises
        ------
        InputError
            Naming the numbers that there are.
        """
        self._value(message)

    def _value(self, message: Any) -> float:
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
    """A value of a joined topic.

    Attributes
    ----------
    source : ScalarTopic
    stamp : int
        ns.
    value : float
    """

    source: ScalarTopic
    stamp: int
    value: float


class ScalarTrack(Track[ScalarValue]):
    """Track of a topic's values."""

    def at(self, stamp: int) -> float:
        """Return the value at a stamp, linear between neighbours; NaN where there are none."""
        found = self.around(stamp)
        if found is None:
            return math.nan
        before, after, share = found
        return before.value + share * (after.value - before.value)


def numbers_of(reader: BagReader, topic: str) -> list[str]:
    """Return the paths of the numbers in a topic's messages; none of what holds no few.

    Parameters
    ----------
    reader : BagReader
    topic : str
        One of its topics.

    Returns
    -------
    list of str
        By its first message; empty where it cannot be read.
    """
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
    """Refuse a number that a recording does not have, by its first message.

    Raises
    ------
    InputError
        Naming the topic, and the numbers that there are.
    """
    check_topic(reader.channels, join.topic)
    first = next(reader.messages([join.topic]), None)
    if first is not None:
        join.check(reader.deserialize(first))


def _part(value: Any, part: str) -> Any:
    """Return a field, or an element of an array; None where there is none."""
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
