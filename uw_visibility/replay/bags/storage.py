# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Messages and topics of a recording, and what a reader of one of its files provides."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol


class Recorded(NamedTuple):
    """Recorded message, serialised: type such as ``sensor_msgs/msg/Image``, time received in ns."""

    topic: str
    type: str
    time: int
    data: bytes


@dataclass(frozen=True)
class Channel:
    """Topic of a file: type, definition and number of messages."""

    topic: str
    type: str
    format: str = ""  # of the definition: "msg", "idl", or "" where there is none
    definition: str = ""  # the type's definition as the recording holds it
    count: int | None = None  # messages, as the file's index says


class Part(NamedTuple):
    """Topics and times that are asked for: from `start` to before `stop`, ns; None is no limit."""

    topics: Collection[str] | None = None
    start: int | None = None
    stop: int | None = None

    def holds(self, message: Recorded) -> bool:
        """Tell whether a message is one of those asked for."""
        return (
            (self.topics is None or message.topic in self.topics)
            and (self.start is None or message.time >= self.start)
            and (self.stop is None or message.time < self.stop)
        )


class Storage(Protocol):
    """Reader of one file of a recording.

    span: times of the first and the last message, ns, where the file has an index.
    """

    channels: list[Channel]  # its topics
    damage: list[str]  # what could not be read so far, in sentences

    @property
    def span(self) -> tuple[int, int] | None: ...

    def messages(self, part: Part) -> Iterator[Recorded]:
        ...

    def close(self) -> None:
        """Close the file."""
        ...
