# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reader of a file of a recording; a damaged MCAP file is read without its index."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2

from uw_visibility.errors import InputError, printable, refusing
from uw_visibility.replay.bags.salvage_mcap import MAGIC, McapSalvage
from uw_visibility.replay.bags.source import RecordingPath, Source, open_regular
from uw_visibility.replay.bags.sqlite import SqliteFile
from uw_visibility.replay.bags.storage import Channel, Part, Recorded, Storage

FORMATS = {
    MessageDefinitionFormat.MSG: "msg",
    MessageDefinitionFormat.IDL: "idl",
    MessageDefinitionFormat.NONE: "",
}

# Repair of damaged files that are not salvaged here.
MENDED_BY = {
    ".bag": "run rosbag reindex {name}, and replay the repaired bag",
    ".db3": "run sqlite3 {name} .recover | sqlite3 mended.db3, and replay mended.db3",
}
SUFFIXES = (".mcap", *MENDED_BY)
# End of an MCAP file: a footer of three numbers, and the magic bytes.
FOOTER, FOOTER_SIZE = struct.Struct("<QQI8s"), 28


def open_file(path: Path) -> Storage:
    """Open one file of a recording, .mcap, .db3 or .bag, damaged or not."""
    if path.suffix not in SUFFIXES:
        raise InputError(
            f"{path} is not a recording: give a .mcap, .db3 or .bag file, or the folder of a bag"
        )
    with refusing(f"cannot read bag {path}"):
        open_regular(path).close()
        if path.suffix == ".db3":
            try:
                return SqliteFile(path)
            except sqlite3.Error as error:
                raise _broken(path, error) from error
    if not path.stat().st_size:
        raise InputError(f"cannot read bag {path}: it is empty, nothing was recorded into it")
    try:
        return IndexedFile(path)
    except Exception as error:
        # rosbags checks little, so that damage may raise any error.
        if path.suffix == ".mcap":
            return _salvage(path, error)
        raise _broken(path, error) from error


class IndexedFile:
    """MCAP or ROS 1 file, read by rosbags through its index; a `Storage`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        if path.suffix == ".mcap":
            _check_index(path)
        kind = Reader1 if path.suffix == ".bag" else Reader2
        self._reader: Any = kind(RecordingPath(path))
        self._reader.open()
        self.damage: list[str] = []
        self.channels = [
            Channel(c.topic, c.msgtype, FORMATS[c.msgdef.format], c.msgdef.data, c.msgcount)
            for c in self._reader.connections
        ]
        if self._reader.message_count > sum(channel.count or 0 for channel in self.channels):
            self._reader.close()
            raise ValueError("its index counts messages of topics that it does not name")
        begin, end = self._reader.start_time, self._reader.end_time
        self.span = (begin, end - 1) if end > begin else None

    def messages(self, part: Part) -> Iterator[Recorded]:
        """Yield messages; after damage in an MCAP file, salvaged ones."""
        topics, start, stop = part
        chosen = [c for c in self._reader.connections if topics is None or c.topic in topics]
        if not chosen:
            return
        read: Counter[str] = Counter()
        try:
            for connection, time, data in self._reader.messages(chosen, start, stop):
                read[connection.topic] += 1
                yield Recorded(connection.topic, connection.msgtype, time, data)
            whole = start is None and stop is None
            if whole and any((c.msgcount or 0) > read[c.topic] for c in chosen):
                raise ValueError("its index counts more messages than it refers to")
        except Exception as error:
            if self._path.suffix != ".mcap":
                self.damage.append(f"{_broken(self._path, error)}; read up to the damage")
                return
            try:
                rest = _salvage(self._path, error)
            except InputError as hopeless:
                self.damage.append(str(hopeless))
                return
            for message in rest.messages(part):
                # The first messages of each topic are those that were read before the damage.
                if read[message.topic] > 0:
                    read[message.topic] -= 1
                else:
                    yield message
            self.damage += [note for note in rest.damage if note not in self.damage]
            rest.close()

    def close(self) -> None:
        self._reader.close()


def _check_index(path: Path) -> None:
    """Raise ValueError for an MCAP index that is missing or differs from its checksum."""
    with Source(path) as source:
        end = source.read(max(source.size - FOOTER_SIZE, 0), FOOTER_SIZE)
        if len(end) < FOOTER_SIZE or not end.endswith(MAGIC):
            raise ValueError("its end is missing")
        begin, _, checksum, _ = FOOTER.unpack(end)
        if begin and checksum:
            # The checksum covers everything from the index up to itself.
            index = source.read(begin, source.size - begin - 12)
            if zlib.crc32(index) != checksum:
                raise ValueError("its index differs from its checksum")


def _salvage(path: Path, error: Exception) -> Storage:
    storage = McapSalvage(path)
    reason = _reason(error)
    if not storage.channels:
        raise InputError(f"cannot read bag {path}: {'; '.join(storage.damage) or reason}")
    storage.damage.insert(0, f"{path.name} is damaged ({reason}): its intact parts are read")
    return storage


def _broken(path: Path, error: Exception) -> InputError:
    mend = MENDED_BY[path.suffix].format(name=path.name)
    return InputError(f"cannot read bag {path}: it is damaged ({_reason(error)}): {mend}")


def _reason(error: Exception) -> str:
    return printable(" ".join(str(error).split()) or type(error).__name__)
