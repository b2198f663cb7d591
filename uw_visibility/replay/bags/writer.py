# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bag writer: rosbag2 recordings in the mcap format."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from contextlib import ExitStack
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

from uw_visibility.config.files import aside_of, sole_writer
from uw_visibility.errors import InputError, refusing
from uw_visibility.replay.bags.decoder import jazzy_types


class BagWriter:
    """Bag writer; to be used in a ``with`` statement.

    A bag that an error or an interruption leaves incomplete is removed. It is written
    beside its place, and comes there when it is complete.

    Parameters
    ----------
    path : str or Path
        Folder to make.
    topics : mapping of str to str
        Type of message by topic, such as ``sensor_msgs/msg/Image``.
    overwrite : bool
        Whether a bag of that name may be replaced.
    in_place : bool
        Whether it is written in its place, where its part can be read after a crash.
    compress : bool
        Whether its chunks are compressed (Zstandard).

    Attributes
    ----------
    make : MessageFactory
        Makes messages that `write` takes.

    Raises
    ------
    InputError
        If the folder exists already, or cannot be made or written to.
    """

    def __init__(
        self, path: str | Path, topics: Mapping[str, str], *, overwrite: bool = False,
        in_place: bool = False, compress: bool = False,
    ) -> None:
        self._target = Path(path)
        _check_room(self._target, overwrite)
        self._types, self.make = jazzy_types()
        self._open = ExitStack()
        self._aside: Path | None = None
        if not in_place:
            self._open.enter_context(sole_writer(self._target))
            self._aside = aside_of(self._target)
        # Its files are named after its folder.
        self.path = self._target if self._aside is None else self._aside / self._target.name
        self._writer = Writer(
            self.path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP
        )
        if compress:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        try:
            self._writer.open()
        except (WriterError, OSError) as error:
            self._open.close()
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"cannot make bag {self._target}: {reason}") from error
        self._connections: dict[str, Connection] = {
            topic: self._writer.add_connection(topic, name, typestore=self._types)
            for topic, name in topics.items()
        }

    def write(self, topic: str, message: Any, time: int) -> None:
        """Write a message with the time in ns at which it was received."""
        data = self._types.serialize_cdr(message, self._connections[topic].msgtype)
        self.write_serialised(topic, bytes(data), time)

    def write_serialised(self, topic: str, data: bytes, time: int) -> None:
        """Write a message that is serialised already (CDR).

        Raises
        ------
        InputError
            If it cannot be written, as on a full disk.
        """
        with refusing(f"cannot write bag {self._target}"):
            self._writer.write(self._connections[topic], time, data)

    def annotate(self, key: str, value: str) -> None:
        """Add to the custom data in the bag's metadata; until it is closed."""
        self._writer.set_custom_data(key, value)

    def close(self) -> None:
        """Complete the bag.

        Raises
        ------
        InputError
            If it cannot be written, as on a full disk.
        """
        try:
            with refusing(f"cannot write bag {self._target}"):
                self._writer.close()
                if self._aside is not None:
                    if self._target.is_dir():
                        shutil.rmtree(self._target)
                    self.path.rename(self._target)
        finally:
            self._clean_up()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *details: object) -> None:
        if kind is None:
            self.close()
            return
        try:
            self._writer.abort()
        except OSError:
            # What could not be written is not needed any more.
            pass
        finally:
            shutil.rmtree(self.path, ignore_errors=True)
            self._clean_up()

    def _clean_up(self) -> None:
        if self._aside is not None:
            shutil.rmtree(self._aside, ignore_errors=True)
        self._open.close()


def _check_room(path: Path, overwrite: bool) -> None:
    """Refuse to replace an older bag, unless that is allowed and it is one."""
    if not path.exists() and not path.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{path} exists already: give another name, or --force to replace it")
    if not (path / "metadata.yaml").is_file() or path.is_symlink():
        raise InputError(f"{path} exists already and is not a bag: give another name")
