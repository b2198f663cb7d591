# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Salvage of MCAP files without a usable index: their records in turn, up to where they end.

The format is that of https://mcap.dev/spec: records of an opcode, a length and
a content; chunks hold records again.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from uw_visibility.replay.bags.packing import PackingError, unpack
from uw_visibility.replay.bags.storage import Channel, Recorded, wanted

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK = 3, 4, 5, 6
# What comes after the messages of a file.
DATA_END = 15
# No record of an image is as long as this: a length beyond it is damage.
LONGEST_RECORD = 1 << 32


class McapSalvage:
    """Scans an MCAP file from its start; a `Storage` without an index."""

    span = None

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._by_id: dict[int, Channel] = {}
        self.damage: list[str] = []
        self._lost = 0
        for _ in self._scan(messages=False):
            pass
        self.channels = list(self._by_id.values())

    def messages(
        self, topics: Collection[str] | None, start: int | None, stop: int | None
    ) -> Iterator[Recorded]:
        """Yield messages in the order of the file."""
        self._lost = 0
        for message in self._scan(messages=True):
            if wanted(message, topics, start, stop):
                yield message
        if self._lost:
            self.damage.append(
                f"{self._path.name}: {self._lost} chunks of messages could not be unpacked"
            )

    def close(self) -> None:
        """Nothing is open between two scans."""

    def _scan(self, messages: bool) -> Iterator[Recorded]:
        with self._path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                return
            yield from self._records(file, messages)

    def _records(self, file: BinaryIO, messages: bool) -> Iterator[Recorded]:
        while len(head := file.read(9)) == 9:
            kind, length = struct.unpack("<BQ", head)
            if kind == DATA_END or not 0 < kind < 0x80 or length > LONGEST_RECORD:
                return
            content = file.read(length)
            if len(content) < length and kind != CHUNK:
                return
            if kind == CHUNK:
                yield from self._chunk(content, messages)
            elif kind == MESSAGE and messages:
                yield from self._message(content)
            elif kind in (SCHEMA, CHANNEL):
                self._describe(kind, BytesIO(content))

    def _chunk(self, content: bytes, messages: bool) -> Iterator[Recorded]:
        try:
            records = _unpack(content)
        except (PackingError, struct.error):
            self._lost += 1
            return
        yield from self._records(BytesIO(records), messages)

    def _message(self, content: bytes) -> Iterator[Recorded]:
        channel, _, time, _ = struct.unpack_from("<HIQQ", content)
        if channel in self._by_id:
            about = self._by_id[channel]
            yield Recorded(about.topic, about.type, time, content[22:])

    def _describe(self, kind: int, content: BytesIO) -> None:
        (number,) = struct.unpack("<H", content.read(2))
        if kind == SCHEMA:
            name, encoding, definition = (_string(content) for _ in range(3))
            form = {"ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl"}.get(encoding, "")
            self._schemas[number] = (name, form, definition)
            return
        (schema,) = struct.unpack("<H", content.read(2))
        name, form, definition = self._schemas.get(schema, ("unknown", "", ""))
        self._by_id[number] = Channel(_string(content), name, form, definition)


def _unpack(content: bytes) -> bytes:
    """Return the records of a chunk; of one that is cut off, those that are there."""
    _, _, size, checksum = struct.unpack_from("<QQQI", content)
    stream = BytesIO(content[28:])
    compression = _string(stream)
    (length,) = struct.unpack("<Q", stream.read(8))
    records = unpack(stream.read(length), compression, size)
    if len(records) == size and checksum and zlib.crc32(records) != checksum:
        raise PackingError("the checksum differs")
    return records


def _string(stream: BytesIO) -> str:
    (length,) = struct.unpack("<I", stream.read(4))
    return stream.read(length).decode(errors="replace")
