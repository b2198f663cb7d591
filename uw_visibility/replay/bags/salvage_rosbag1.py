# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Salvage of ROS 1 bags without a usable index: their records in turn, over what is damaged.

The format is that of http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path

from uw_visibility.messages.stamps import SECOND
from uw_visibility.replay.bags.packing import unpack_part
from uw_visibility.replay.bags.source import LimitError, Source
from uw_visibility.replay.bags.storage import LOST, SKIPPED, Channel, Recorded, Salvage

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, CHUNK, CONNECTION = 2, 5, 7
# The field of a header that tells what the record is, and how far into it that may be.
OPERATION = re.compile(rb"\x04(?=\0{3}op=[\x02\x05\x07])")
LONGEST_BEFORE = 64
# Names of topics and definitions of messages have less.
LONGEST_HEADER = 1 << 20


class Rosbag1Salvage(Salvage):
    """Scans a bag of ROS 1 from its start."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, len(MAGIC))

    def _records(
        self, source: Source, at: int, messages: bool, chunks: bool
    ) -> Iterator[Recorded]:
        while at < source.size:
            record = _header(source, at)
            if record is None:
                after = _next(source, at + 1)
                if after is None:
                    return
                self._losses[SKIPPED] += 1
                at = after
                continue
            fields, begin, length = record
            kind = fields.get("op", b"\0")[0]
            end = begin + length
            if end > source.size or (end < source.size and _header(source, end) is None):
                # A wrong length, or the end of a file that is cut off.
                after = _next(source, begin)
                self._losses[SKIPPED] += after is not None
                end = source.size if after is None else after
            try:
                if kind in (MESSAGE, CHUNK, CONNECTION):
                    data = source.read(begin, end - begin)
                    yield from self._record(kind, fields, data, messages, chunks, length)
            except (struct.error, KeyError, LimitError):
                self._losses[SKIPPED] += 1
            at = end

    def _record(
        self, kind: int, fields: dict[str, bytes], data: bytes, messages: bool, chunks: bool,
        length: int,
    ) -> Iterator[Recorded]:
        if kind == CHUNK and chunks:
            # Of a chunk that is cut off, the records before the cut are whole.
            compression = fields.get("compression", b"none").decode(errors="replace")
            records, problem = unpack_part(data, compression)
            if problem:
                self._losses[LOST] += 1
            if records:
                yield from self._records(Source.of(records), 0, messages, chunks=False)
        elif kind == CONNECTION:
            self._describe(fields, _fields(data) or {})
        elif kind == MESSAGE and len(data) == length:
            (number,) = struct.unpack("<I", fields["conn"])
            seconds, nanoseconds = struct.unpack("<II", fields["time"])
            yield from self._message(number, seconds * SECOND + nanoseconds, data)

    def _describe(self, fields: dict[str, bytes], about: dict[str, bytes]) -> None:
        (number,) = struct.unpack("<I", fields["conn"])
        kind = about.get("type", b"").decode(errors="replace")
        package, _, name = kind.rpartition("/")
        definition = about.get("message_definition", b"").decode(errors="replace")
        topic = fields.get("topic", b"").decode(errors="replace")
        channel = Channel(topic, f"{package}/msg/{name}", "msg", definition)
        self._by_id.setdefault(number, channel)


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
