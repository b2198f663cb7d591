# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bag writer: rosbag2 recordings in the mcap format."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    StoragePlugin,
    Writer,
    WriterError,
)

from uw_visibility.errors import refusing
from uw_visibility.replay.bags.decoder import jazzy_types

# Custom metadata in bags of this program; recordings of vehicles do not have it.
WRITER = "uw_visibility.bag_writer"


class BagWriter:
    """Bag writer. After a crash, what was written can be read.

    path: folder to make; its file is named after it.
    topics: type of message by topic, such as ``sensor_msgs/msg/Image``.
    compress: whether chunks are compressed (Zstandard).
    place: path that errors name, if the folder is moved there.
    Raises `InputError` if the folder exists already, or cannot be made.
    """

    def __init__(
        self, path: Path, topics: Mapping[str, str], *, compress: bool = False,
        place: Path | None = None,
    ) -> None:
        self.path = path
        self._place = place or path
        self._types, self.make = jazzy_types()
        with refusing(f"cannot make bag {self._place}", WriterError, OSError):
            self._writer = Writer(
                path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP
            )
            if compress:
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        self.annotate(WRITER, "")
        self._connections: dict[str, Connection] = {
            topic: self._writer.add_connection(topic, name, typestore=self._types)
            for topic, name in topics.items()
        }

    def write(self, topic: str, message: Any, time: int) -> None:
        """Write a message with its time of reception, ns."""
        data = self._types.serialize_cdr(message, self._connections[topic].msgtype)
        self.write_serialised(topic, bytes(data), time)

    def write_serialised(self, topic: str, data: bytes, time: int) -> None:
        """Write a serialised message (CDR).

        Raises `InputError` if it cannot be written, for instance on a full disk.
        """
        with refusing(f"cannot write bag {self._place}"):
            self._writer.write(self._connections[topic], time, data)

    def annotate(self, key: str, value: str) -> None:
        """Add to the custom metadata of the bag, before it is closed."""
        self._writer.set_custom_data(key, value)

    def close(self) -> None:
        """Complete the bag.

        Raises `InputError` if it cannot be written, for instance on a full disk.
        """
        with refusing(f"cannot write bag {self._place}"):
            self._writer.close()
