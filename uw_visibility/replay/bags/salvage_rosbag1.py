# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Salvage of ROS 1 bags without an index: their records in turn, up to where they end.

The format is that of http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from uw_visibility.replay.bags.packing import PackingError, unpack
from uw_visibility.replay.bags.storage import Channel, Recorded, wanted

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, CHUNK, CONNECTION = 2, 5, 7


class Rosbag1Salvage:
    """Scans a bag of ROS 1 from its start; a `Storage` without an index."""

    span = None

    def __init__(self, path: Path) -> None:
        self._path = path
        self._by_id: dict[int, Channel] = {}
        self.damage: list[str] = []
        self._lost = 0
        for _ in self._scan():
            pass
        self.channels = list(self._by_id.values())

    def messages(
        self, topics: Collection[str] | None, start: int | None, stop: int | None
    ) -> Iterator[Recorded]:
        """Yield messages in the order of the file."""
        self._lost = 0
        for message in self._scan():
            if wanted(message, topics, start, stop):
                yield message
        if self._lost:
            self.damage.append(
                f"{self._path.name}: {self._lost} chunks of messages could not be unpacked"
            )

    def close(self) -> None:
        """Nothing is open between two scans."""

    def _scan(self) -> Iterator[Recorded]:
        with self._path.open("rb") as file:
            if file.read(len(MAGIC)) == MAGIC:
                yield from self._records(file)

    def _records(self, file: BinaryIO) -> Iterator[Recorded]:
        while (header := _block(file)) is not None:
            fields = _fields(header)
            if not fields.get("op"):
                return
            kind = fields["op"][0]
            # Of a chunk that is cut off, the records before the cut are whole.
            data = _block(file, whole=kind != CHUNK)
            if data is None:
                return
            if kind == CHUNK:
                yield from self._chunk(fields.get("compression", b"none"), data)
            elif kind == CONNECTION:
                self._describe(fields, _fields(data))
            elif kind == MESSAGE:
                yield from self._message(fields, data)

    def _chunk(self, compression: bytes, data: bytes) -> Iterator[Recorded]:
        try:
            if compression == b"bz2":
                data = bz2.BZ2Decompressor().decompress(data)
            elif compression == b"lz4":
                data = unpack(data, "lz4")
        except (OSError, ValueError, PackingError):
            self._lost += 1
            return
        yield from self._records(BytesIO(data))

    def _describe(self, fields: dict[str, bytes], about: dict[str, bytes]) -> None:
        (number,) = struct.unpack("<I", fields["conn"])
        kind = about.get("type", b"").decode(errors="replace")
        package, _, name = kind.rpartition("/")
        definition = about.get("message_definition", b"").decode(errors="replace")
        topic = fields.get("topic", b"").decode(errors="replace")
        self._by_id[number] = Channel(topic, f"{package}/msg/{name}", "msg", definition)

    def _message(self, fields: dict[str, bytes], data: bytes) -> Iterator[Recorded]:
        (number,) = struct.unpack("<I", fields["conn"])
        seconds, nanoseconds = struct.unpack("<II", fields["time"])
        if number in self._by_id:
            about = self._by_id[number]
            time = seconds * 1_000_000_000 + nanoseconds
            yield Recorded(about.topic, about.type, time, data)


def _block(file: BinaryIO, whole: bool = True) -> bytes | None:
    """Read a length and so many bytes; None, or what there is, where the file ends before."""
    head = file.read(4)
    if len(head) < 4:
        return None
    (length,) = struct.unpack("<I", head)
    content = file.read(length)
    return content if len(content) == length or not whole else None


def _fields(header: bytes) -> dict[str, bytes]:
    fields = {}
    stream = BytesIO(header)
    while (field := _block(stream)) is not None:
        name, _, value = field.partition(b"=")
        fields[name.decode(errors="replace")] = value
    return fields
