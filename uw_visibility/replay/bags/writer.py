# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bag writer: rosbag2 recordings in the mcap format."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

from uw_visibility.errors import InputError
from uw_visibility.replay.bags.types import jazzy_types


class BagWriter:
    """Bag writer; to be used in a ``with`` statement.

    A bag that an error or an interruption leaves incomplete is removed.

    Parameters
    ----------
    path : str or Path
        Folder to make.
    topics : mapping of str to str
        Type of message by topic, such as ``sensor_msgs/msg/Image``.
    overwrite : bool
        Whether a bag of that name may be replaced.

    Attributes
    ----------
    make : MessageFactory
        Makes messages that `write` takes.

    Raises
    ------
    InputError
        If the folder exists already, or cannot be made.
    """

    def __init__(
        self, path: str | Path, topics: Mapping[str, str], *, overwrite: bool = False
    ) -> None:
        self.path = Path(path)
        _make_room(self.path, overwrite)
        self._types, self.make = jazzy_types()
        self._writer = Writer(
            self.path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP
        )
        try:
            self._writer.open()
        except (WriterError, OSError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"cannot make bag {self.path}: {reason}") from error
        self._connections: dict[str, Connection] = {
            topic: self._writer.add_connection(topic, name, typestore=self._types)
            for topic, name in topics.items()
        }

    def write(self, topic: str, message: Any, time: int) -> None:
        """Write a message with the time in ns at which it was received."""
        data = self._types.serialize_cdr(message, self._connections[topic].msgtype)
        self.write_serialised(topic, bytes(data), time)

    def write_serialised(self, topic: str, data: bytes, time: int) -> None:
        """Write a message that is serialised already (CDR)."""
        self._writer.write(self._connections[topic], time, data)

    def annotate(self, key: str, value: str) -> None:
        """Add to the custom data in the bag's metadata; until it is closed."""
        self._writer.set_custom_data(key, value)

    def close(self) -> None:
        """Complete the bag."""
        self._writer.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *details: object) -> None:
        if kind is None:
            self.close()
        else:
            self._writer.abort()
            shutil.rmtree(self.path)


def _make_room(path: Path, overwrite: bool) -> None:
    """Remove an older bag, if that is allowed and if it is one."""
    if not path.exists() and not path.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{path} exists already: give another name, or --force to replace it")
    if not (path / "metadata.yaml").is_file() or path.is_symlink():
        raise InputError(f"{path} exists already and is not a bag: give another name")
    shutil.rmtree(path)
