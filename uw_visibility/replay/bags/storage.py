# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Interface of one file of a recording, whatever its format, and scan of a damaged one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from uw_visibility.replay.bags.source import Source

LOST = "chunks of messages could not be unpacked to their end"
DIFFER = "chunks are not what their checksums say, and used all the same"
SKIPPED = "damaged records were skipped"


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


class Part(NamedTuple):
    """Part of a recording that is asked for.

    Attributes
    ----------
    topics : collection of str or None
        None for all.
    start, stop : int or None
        Times that messages are from, and before, ns since 1970.
    """

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

    def messages(self, part: Part) -> Iterator[Recorded]:
        """Yield the messages that are asked for."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


class Salvage:
    """Scans a file from its start, record by record; a `Storage` without an index.

    Parameters
    ----------
    path : Path
        File, which may be damaged anywhere.
    start : int
        Where the first record begins.
    """

    span = None

    def __init__(self, path: Path, start: int) -> None:
        self._path, self._start = path, start
        self._by_id: dict[int, Channel] = {}
        self.damage: list[str] = []
        self._losses: Counter[str] = Counter()
        for _ in self._scan(messages=False):
            pass
        self.channels = list(self._by_id.values())

    def messages(self, part: Part) -> Iterator[Recorded]:
        """Yield messages in the order of the file."""
        self._losses.clear()
        yield from filter(part.holds, self._scan(messages=True))
        self.damage += [
            f"{self._path.name}: {self._losses[what]} {what}"
            for what in (LOST, DIFFER, SKIPPED) if self._losses[what]
        ]

    def close(self) -> None:
        """Nothing is open between two scans."""

    def _scan(self, messages: bool) -> Iterator[Recorded]:
        with Source.of(self._path) as source:
            # Its first bytes may be damaged like any others.
            yield from self._records(source, self._start, messages, chunks=True)

    def _records(
        self, source: Source, at: int, messages: bool, chunks: bool
    ) -> Iterator[Recorded]:
        """Yield the messages from a place on, and note the channels."""
        raise NotImplementedError

    def _message(self, number: int, time: int, data: bytes) -> Iterator[Recorded]:
        """Yield a message of a channel's number, if the file has told of it."""
        if number in self._by_id:
            about = self._by_id[number]
            yield Recorded(about.topic, about.type, time, data)
        else:
            self._losses[SKIPPED] += 1
