# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Files that rosbags reads; where one turns out to be damaged, the rest is salvaged."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2

from uw_visibility.errors import InputError, printable, refusing
from uw_visibility.replay.bags.salvage_mcap import MAGIC, McapSalvage
from uw_visibility.replay.bags.salvage_rosbag1 import Rosbag1Salvage
from uw_visibility.replay.bags.source import RecordingPath, Source, open_regular
from uw_visibility.replay.bags.sqlite import SqliteFile
from uw_visibility.replay.bags.storage import Channel, Part, Recorded, Storage

FORMATS = {
    MessageDefinitionFormat.MSG: "msg",
    MessageDefinitionFormat.IDL: "idl",
    MessageDefinitionFormat.NONE: "",
}

SALVAGE: dict[str, Callable[[Path], Storage]] = {
    ".mcap": McapSalvage,
    ".db3": SqliteFile,
    ".bag": Rosbag1Salvage,
}
# The end of an MCAP file: a footer of three numbers, and the magic bytes.
FOOTER, FOOTER_SIZE = struct.Struct("<QQI8s"), 28


def open_file(path: Path) -> Storage:
    """Open one file of a recording, damaged or not.

    Parameters
    ----------
    path : Path
        A .mcap, .db3 or .bag file.

    Raises
    ------
    InputError
        If it is none of these, or nothing of it can be read.
    """
    if path.suffix not in SALVAGE:
        raise InputError(
            f"{path} is no recording: give a .mcap, .db3 or .bag file, or the folder of a bag"
        )
    with refusing(f"cannot read bag {path}"):
        open_regular(path).close()
        if path.suffix == ".db3":
            return _checked(SqliteFile(path), path, "it holds no topics")
    try:
        return IndexedFile(path)
    except Exception as error:
        # A damaged file fails in whatever way its bytes lead to.
        return _salvage(path, error)


class IndexedFile:
    """A file with an index, as rosbags reads it; a `Storage`."""

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
        """Yield messages; where the index leads astray, scan the rest."""
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
                raise ValueError("its index names messages that it does not lead to")
        except GeneratorExit:
            raise
        except Exception as error:
            # As above: nobody can list what damaged bytes raise.
            try:
                rest = _salvage(self._path, error)
            except InputError as hopeless:
                self.damage.append(str(hopeless))
                return
            yield from _after(read, rest, part)
            self.damage += [note for note in rest.damage if note not in self.damage]
            rest.close()

    def close(self) -> None:
        """Close the file."""
        self._reader.close()


def _after(read: Counter[str], rest: Storage, part: Part) -> Iterator[Recorded]:
    """Yield what a scan finds beyond the messages read already, counted by topic."""
    for message in rest.messages(part):
        if read[message.topic] > 0:
            read[message.topic] -= 1
        elif part.holds(message):
            yield message


def _check_index(path: Path) -> None:
    """Refuse an index that is not what its checksum says, where it has one.

    Raises
    ------
    ValueError
        If they differ, or there is no end to find it by.
    """
    with Source.of(path) as source:
        end = source.read(source.size - FOOTER_SIZE, FOOTER_SIZE)
        begin, _, checksum, magic = FOOTER.unpack(end)
        if magic != MAGIC:
            raise ValueError("its end is missing")
        if begin and checksum:
            # It is that of all from the index to itself.
            index = source.read(begin, source.size - begin - 12)
            if zlib.crc32(index) != checksum:
                raise ValueError("its index differs from its checksum")


def _salvage(path: Path, error: Exception) -> Storage:
    reason = printable(" ".join(str(error).split()) or type(error).__name__)
    storage = _checked(SALVAGE[path.suffix](path), path, reason)
    storage.damage.insert(0, f"{path.name} is damaged ({reason}): read as far as it goes")
    return storage


def _checked(storage: Storage, path: Path, reason: str) -> Storage:
    """Refuse a file of which no topic can be read.

    Raises
    ------
    InputError
        With the reason, or what is damaged.
    """
    if not storage.channels:
        storage.close()
        raise InputError(f"cannot read bag {path}: {'; '.join(storage.damage) or reason}")
    return storage
