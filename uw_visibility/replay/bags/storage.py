# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Interface of one file of a recording, whatever its format."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol


class Recorded(NamedTuple):
    """Recorded message, serialised.

    Attributes
    ----------
    topic : str
        Topic.
    type : str
        Type of message, such as ``sensor_msgs/msg/Image``.
    time : int
        When it was received, in ns.
    data : bytes
        The serialised message.
    """

    topic: str
    type: str
    time: int
    data: bytes


@dataclass(frozen=True)
class Channel:
    """Topic of a file: type, definition and number of messages.

    Attributes
    ----------
    topic, type : str
        Name, and type of its messages.
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


class Storage(Protocol):
    """Protocol of one file of a recording.

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

    def messages(
        self, topics: Collection[str] | None, start: int | None, stop: int | None
    ) -> Iterator[Recorded]:
        """Yield messages from start up to, but without, stop (ns)."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


def wanted(
    message: Recorded, topics: Collection[str] | None, start: int | None, stop: int | None
) -> bool:
    """Tell whether a message is one of those asked for."""
    return (
        (topics is None or message.topic in topics)
        and (start is None or message.time >= start)
        and (stop is None or message.time < stop)
    )
