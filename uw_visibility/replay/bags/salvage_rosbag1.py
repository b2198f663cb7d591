# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Salvage of ROS 1 bags without a usable index: their records in turn, over what is damaged.

The format is that of http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator
from pathlib import Path

from uw_visibility.replay.bags.packing import unpack_part
from uw_visibility.replay.bags.source import LimitError, Source
from uw_visibility.replay.bags.storage import Channel, Recorded, wanted

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, CHUNK, CONNECTION = 2, 5, 7
# The field of a header that tells what the record is, and how far into it that may be.
OPERATION = re.compile(rb"\x04(?=\0{3}op=[\x02\x05\x07])")
LONGEST_BEFORE = 64
# Names of topics and definitions of messages have less.
LONGEST_HEADER = 1 << 20


class Rosbag1Salvage:
    """Scans a bag of ROS 1 from its start; a `Storage` without an index."""

    span = None

    def __init__(self, path: Path) -> None:
        self._path = path
        self._by_id: dict[int, Channel] = {}
        self.damage: list[str] = []
        self._lost = self._skipped = 0
        for _ in self._scan():
            pass
        self.channels = list(self._by_id.values())

    def messages(
        self, topics: Collection[str] | None, start: int | None, stop: int | None
    ) -> Iterator[Recorded]:
        """Yield messages in the order of the file."""
        self._lost = self._skipped = 0
        for message in self._scan():
            if wanted(message, topics, start, stop):
                yield message
        for count, what in (
            (self._lost, "chunks of messages could not be unpacked to their end"),
            (self._skipped, "damaged records were skipped"),
        ):
            if count:
                self.damage.append(f"{self._path.name}: {count} {what}")

    def close(self) -> None:
        """Nothing is open between two scans."""

    def _scan(self) -> Iterator[Recorded]:
        with Source.of(self._path) as source:
            # Its first bytes may be damaged like any others.
            yield from self._records(source, len(MAGIC), chunks=True)

    def _records(self, source: Source, at: int, chunks: bool) -> Iterator[Recorded]:
        while at < source.size:
            record = _header(source, at)
            if record is None:
                after = _next(source, at + 1)
                if after is None:
                    return
                self._skipped += 1
                at = after
                continue
            fields, begin, length = record
            kind = fields.get("op", b"\0")[0]
            end = begin + length
            if end > source.size or (end < source.size and _header(source, end) is None):
                # A wrong length, or the end of a file that is cut off.
                after = _next(source, begin)
                self._skipped += after is not None
                end = source.size if after is None else after
            try:
                yield from self._record(source, kind, fields, (begin, end), length, chunks)
            except (struct.error, KeyError, LimitError):
                self._skipped += 1
            at = end

    def _record(
        self, source: Source, kind: int, fields: dict[str, bytes], place: tuple[int, int],
        length: int, chunks: bool,
    ) -> Iterator[Recorded]:
        begin, end = place
        if kind not in (MESSAGE, CHUNK, CONNECTION):
            return
        data = source.read(begin, end - begin)
        if kind == CHUNK and chunks:
            # Of a chunk that is cut off, the records before the cut are whole.
            yield from self._chunk(fields.get("compression", b"none"), data)
        elif kind == CONNECTION:
            self._describe(fields, _fields(data) or {})
        elif kind == MESSAGE and len(data) == length:
            yield from self._message(fields, data)

    def _chunk(self, compression: bytes, data: bytes) -> Iterator[Recorded]:
        records, problem = unpack_part(data, compression.decode(errors="replace"))
        if problem:
            self._lost += 1
        if records:
            yield from self._records(Source.of(records), 0, chunks=False)

    def _describe(self, fields: dict[str, bytes], about: dict[str, bytes]) -> None:
        (number,) = struct.unpack("<I", fields["conn"])
        kind = about.get("type", b"").decode(errors="replace")
        package, _, name = kind.rpartition("/")
        definition = about.get("message_definition", b"").decode(errors="replace")
        topic = fields.get("topic", b"").decode(errors="replace")
        channel = Channel(topic, f"{package}/msg/{name}", "msg", definition)
        self._by_id.setdefault(number, channel)

    def _message(self, fields: dict[str, bytes], data: bytes) -> Iterator[Recorded]:
        (number,) = struct.unpack("<I", fields["conn"])
        seconds, nanoseconds = struct.unpack("<II", fields["time"])
        if number in self._by_id:
            about = self._by_id[number]
            time = seconds * 1_000_000_000 + nanoseconds
            yield Recorded(about.topic, about.type, time, data)
        else:
            self._skipped += 1


def _header(source: Source, at: int) -> tuple[dict[str, bytes], int, int] | None:
    """Return a record's fields, and place and length of its data; None if there is none."""
    size = source.read(at, 4)
    if len(size) < 4:
        return None
    (length,) = struct.unpack("<I", size)
    if not 0 < length <= LONGEST_HEADER:
        return None
    content = source.read(at + 4, length + 4)
    fields = _fields(content[:length])
    if len(content) < length + 4 or not fields or len(fields.get("op", b"")) != 1:
        return None
    (data,) = struct.unpack_from("<I", content, length)
    return fields, at + 8 + length, data


def _fields(header: bytes) -> dict[str, bytes] | None:
    """Return the fields of a header, or None if it is none."""
    fields = {}
    at = 0
    while at + 4 <= len(header):
        (length,) = struct.unpack_from("<I", header, at)
        field = header[at + 4 : at + 4 + length]
        name, sign, value = field.partition(b"=")
        if len(field) < length or not sign:
            return None
        fields[name.decode(errors="replace")] = value
        at += 4 + length
    return fields if at == len(header) else None


def _next(source: Source, at: int) -> int | None:
    """Find where a record begins that is one by all that it says."""
    for place in source.find(OPERATION, at):
        # The field may be anywhere in the header.
        for begin in range(max(at, place - LONGEST_BEFORE), place - 3):
            if _header(source, begin) is not None:
                return begin
    return None
