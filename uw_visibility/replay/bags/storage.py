# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Messages and topics of a recording, and the protocol of readers of its files."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

# Times are signed 64 bit, ns.
LATEST = 1 << 63


class Recorded(NamedTuple):
    """Serialised message: type such as ``sensor_msgs/msg/Image``, time of reception in ns."""

    topic: str
    type: str
    time: int
    data: bytes


@dataclass(frozen=True)
class Channel:
    """Topic of a file: type, definition and number of messages."""

    topic: str
    type: str
    format: str = ""  # of the definition: "msg", "idl", or "" for none
    definition: str = ""  # definition of the type in the recording
    count: int | None = None  # number of messages by the index of the file


class Part(NamedTuple):
    """Requested topics and times: from `start` to before `stop`, ns; None is no limit."""

    topics: Collection[str] | None = None
    start: int | None = None
    stop: int | None = None

    def holds(self, message: Recorded) -> bool:
        """Return whether a message is requested."""
        return (
            (self.topics is None or message.topic in self.topics)
            and (self.start is None or message.time >= self.start)
            and (self.stop is None or message.time < self.stop)
        )


class Storage(Protocol):
    """Reader of one file of a recording."""

    channels: list[Channel]  # topics of the file
    damage: list[str]  # damage found so far, in sentences
    span: tuple[int, int] | None  # times of first and last message, ns; None if unknown or empty

    def messages(self, part: Part) -> Iterator[Recorded]:
        ...

    def close(self) -> None:
        ...
