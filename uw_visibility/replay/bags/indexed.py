# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Files that rosbags reads; where one turns out to be damaged, the rest is salvaged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.salvage_mcap import McapSalvage
from uw_visibility.replay.bags.salvage_rosbag1 import Rosbag1Salvage
from uw_visibility.replay.bags.salvage_sqlite import SqliteSalvage
from uw_visibility.replay.bags.storage import Channel, Recorded, Storage, wanted

FORMATS = {
    MessageDefinitionFormat.MSG: "msg",
    MessageDefinitionFormat.IDL: "idl",
    MessageDefinitionFormat.NONE: "",
}

SALVAGE: dict[str, Callable[[Path], Storage]] = {
    ".mcap": McapSalvage,
    ".db3": SqliteSalvage,
    ".bag": Rosbag1Salvage,
}


def open_file(path: Path) -> Storage:
    """Open one file of a recording, damaged or not.

    Parameters
    ----------
    path : Path
        A .mcap, .db3 or .bag file.

    Returns
    -------
    Storage

    Raises
    ------
    InputError
        If it is none of these, or nothing of it can be read.
    """
    if path.suffix not in SALVAGE:
        raise InputError(
            f"{path} is no recording: give a .mcap, .db3 or .bag file, or the folder of a bag"
        )
    try:
        return IndexedFile(path)
    except OSError as error:
        raise InputError(f"cannot read bag {path}: {error.strerror or error}") from error
    except Exception as error:
        # A damaged file fails in whatever way its bytes lead to.
        return _salvage(path, error)


class IndexedFile:
    """A file with an index, as rosbags reads it; a `Storage`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reader: Any = Reader1(path) if path.suffix == ".bag" else Reader2(path)
        self._reader.open()
        self.damage: list[str] = []
        self.channels = [
            Channel(c.topic, c.msgtype, FORMATS[c.msgdef.format], c.msgdef.data, c.msgcount)
            for c in self._reader.connections
        ]
        begin, end = self._reader.start_time, self._reader.end_time
        self.span = (begin, end - 1) if end > begin else None

    def messages(
        self, topics: Collection[str] | None, start: int | None, stop: int | None
    ) -> Iterator[Recorded]:
        """Yield messages; where the index leads astray, scan the rest."""
        chosen = [c for c in self._reader.connections if topics is None or c.topic in topics]
        if not chosen:
            return
        read: Counter[str] = Counter()
        try:
            for connection, time, data in self._reader.messages(chosen, start, stop):
                read[connection.topic] += 1
                yield Recorded(connection.topic, connection.msgtype, time, data)
        except GeneratorExit:
            raise
        except Exception as error:
            # As above: nobody can list what damaged bytes raise.
            rest = _salvage(self._path, error)
            yield from _after(read, rest, topics, start, stop)
            self.damage += rest.damage
            rest.close()

    def close(self) -> None:
        """Close the file."""
        self._reader.close()


def _after(
    read: Counter[str],
    rest: Storage,
    topics: Collection[str] | None,
    start: int | None,
    stop: int | None,
) -> Iterator[Recorded]:
    """Yield what a scan finds beyond the messages read already, counted by topic."""
    for message in rest.messages(topics, start, stop):
        if read[message.topic] > 0:
            read[message.topic] -= 1
        elif wanted(message, topics, start, stop):
            yield message


def _salvage(path: Path, error: Exception) -> Storage:
    reason = " ".join(str(error).split()) or type(error).__name__
    storage = SALVAGE[path.suffix](path)
    if not storage.channels:
        storage.close()
        raise InputError(f"cannot read bag {path}: {reason}") from error
    storage.damage.insert(0, f"{path.name} is damaged ({reason}): read as far as it goes")
    return storage
