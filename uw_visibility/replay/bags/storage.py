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
    """Topic of a file: type, definition and number of messages.

    Attributes
    ----------
    format : str
        Of the definition: "msg", "idl", or "" where there is none.
    definition : str
        The type's definition as the recording holds it.
    count : int or None
        Messages, as the file's index says.
    """

    topic: str
    type: str
    format: str = ""
    definition: str = ""
    count: int | None = None


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

    Attributes
    ----------
    channels : list of Channel
        Its topics.
    span : tuple of int or None
        Times of the first and the last message, ns, where the file has an index.
    damage : list of str
        What could not be read so far, in sentences.
    """

    channels: list[Channel]
    damage: list[str]

    @property
    def span(self) -> tuple[int, int] | None: ...

    def messages(self, part: Part) -> Iterator[Recorded]:
        """Yield the messages that are asked for."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...
