# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Salvage of damaged MCAP files: all records are read in turn, without the index.

Format: https://mcap.dev/spec. A record has an opcode, a length and a content; a chunk contains
records.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from uw_visibility.replay.bags.packing import unpack_part
from uw_visibility.replay.bags.source import MOST_AT_ONCE, LimitError, Source
from uw_visibility.replay.bags.storage import LATEST, Channel, Part, Recorded

LOST = "chunks of messages could not be unpacked to their end"
DIFFER = "chunks differ from their checksums, but were used"
SKIPPED = "damaged records were skipped"

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK = 3, 4, 5, 6
# Record after all messages of a file.
DATA_END = 15
HEAD = 9
# Bytes of fields: of a chunk before its compression, and of a message before its data.
CHUNK_FIELDS, MESSAGE_FIELDS = 28, 22
# Beginning of a chunk or a message, with a length below 2^32.
RECORD = re.compile(
    rb"\x06(?=....\0{4}.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd))|\x05(?=....\0{4})", re.DOTALL
)


class McapSalvage:
    """Reader of an MCAP file with any damage, record by record; a `Storage`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.span: tuple[int, int] | None = None
        self._schemas: dict[int, tuple[str, str, str]] = {}
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
            f"{self._path.name}: {what} ({self._losses[what]})"
            for what in (LOST, DIFFER, SKIPPED) if self._losses[what]
        ]

    def close(self) -> None:
        """Do nothing: no file is open between scans."""

    def _scan(self, messages: bool) -> Iterator[Recorded]:
        with Source(self._path) as source:
            # The first bytes may be damaged, too.
            yield from self._records(source, len(MAGIC), messages, chunks=True)

    def _records(
        self, source: Source, at: int, messages: bool, chunks: bool
    ) -> Iterator[Recorded]:
        while at + HEAD <= source.size:
            kind, length = struct.unpack("<BQ", source.read(at, HEAD))
            if chunks and kind == DATA_END:
                if messages:
                    return
                # The summary section repeats the channels.
                chunks = False
            end = self._end(source, at, kind, length, chunks)
            if end is None:
                # The readable part of a truncated last chunk is used.
                after = self._next(source, at + 1, chunks)
                end = source.size if after is None else after
                if kind != CHUNK or not chunks:
                    self._losses[SKIPPED] += after is not None
                    at = end
                    continue
            try:
                content = source.read(at + HEAD, end - at - HEAD)
                if kind == CHUNK:
                    yield from self._chunk(content, messages)
                elif kind == MESSAGE:
                    channel, _, time, _ = struct.unpack_from("<HIQQ", content)
                    if not messages:
                        self._extend_span(time)
                    elif channel in self._by_id:
                        about = self._by_id[channel]
                        yield Recorded(about.topic, about.type, time, content[MESSAGE_FIELDS:])
                    else:
                        self._losses[SKIPPED] += 1
                elif kind in (SCHEMA, CHANNEL):
                    self._describe(kind, BytesIO(content))
            except (struct.error, LimitError):
                self._losses[SKIPPED] += 1
            at = end

    def _extend_span(self, time: int) -> None:
        if time < LATEST:
            begin, end = self.span or (time, time)
            self.span = min(begin, time), max(end, time)

    def _end(
        self, source: Source, at: int, kind: int, length: int, chunks: bool
    ) -> int | None:
        """Return the end of a record; None if its length is implausible."""
        if kind == CHUNK and not chunks:
            return None
        for candidate in (length, _chunk_length(source, at) if kind == CHUNK else None):
            end = None if candidate is None else at + HEAD + candidate
            if kind != 0 and end is not None and self._begins(source, end):
                return end
        return None

    def _begins(self, source: Source, at: int) -> bool:
        """Return whether a record may begin at an offset, or the data end there."""
        if at >= source.size:
            return at == source.size
        head = source.read(at, HEAD)
        if len(head) < HEAD:
            # End of a truncated file.
            return True
        kind, length = struct.unpack("<BQ", head)
        if length > max(source.size - at - HEAD, MOST_AT_ONCE):
            # If only the length is damaged, the record before is intact.
            if kind == CHUNK:
                content = _chunk_length(source, at)
                return content is not None and at + HEAD + content <= source.size
            return kind == MESSAGE and self._is_known(source, at)
        # Applications may add other kinds of records.
        return kind != 0

    def _is_known(self, source: Source, at: int) -> bool:
        """Return whether the channel of a message is known."""
        number = source.read(at + HEAD, 2)
        return len(number) == 2 and struct.unpack("<H", number)[0] in self._by_id

    def _next(self, source: Source, at: int, chunks: bool) -> int | None:
        """Return the offset of the next plausible record."""
        for place in source.find(RECORD, at):
            kind, length = struct.unpack("<BQ", source.read(place, HEAD))
            if kind == CHUNK and chunks:
                if length == _chunk_length(source, place):
                    return place
            elif (
                kind == MESSAGE and length >= MESSAGE_FIELDS and self._is_known(source, place)
                and self._begins(source, place + HEAD + length)
            ):
                return place
        return None

    def _chunk(self, content: bytes, messages: bool) -> Iterator[Recorded]:
        _, _, size, checksum = struct.unpack_from("<QQQI", content)
        stream = BytesIO(content[CHUNK_FIELDS:])
        compression = _string(stream)
        (length,) = struct.unpack("<Q", stream.read(8))
        records, problem = unpack_part(stream.read(min(length, len(content))), compression)
        if problem or len(records) < size:
            self._losses[LOST] += 1
        elif checksum and zlib.crc32(records[:size]) != checksum:
            self._losses[DIFFER] += 1
        if records:
            yield from self._records(Source(records), 0, messages, chunks=False)

    def _describe(self, kind: int, content: BytesIO) -> None:
        (number,) = struct.unpack("<H", content.read(2))
        if kind == SCHEMA:
            name, encoding, definition = (_string(content) for _ in range(3))
            form = {"ros2msg": "msg", "ros2idl": "idl", "omgidl": "idl"}.get(encoding, "")
            self._schemas.setdefault(number, (name, form, definition))
            return
        (schema,) = struct.unpack("<H", content.read(2))
        name, form, definition = self._schemas.get(schema, ("unknown", "", ""))
        self._by_id.setdefault(number, Channel(_string(content), name, form, definition))


def _chunk_length(source: Source, at: int) -> int | None:
    """Return the length of the content of a chunk by its fields; None if truncated."""
    head = source.read(at + HEAD, CHUNK_FIELDS + 16)
    try:
        (name,) = struct.unpack_from("<I", head, CHUNK_FIELDS)
        (packed,) = struct.unpack_from("<Q", head, CHUNK_FIELDS + 4 + name)
    except struct.error:
        return None
    return int(CHUNK_FIELDS + 12 + name + packed)


def _string(stream: BytesIO) -> str:
    (length,) = struct.unpack("<I", stream.read(4))
    return stream.read(length).decode(errors="replace")
