# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bag writer: rosbag2 recordings in the mcap format."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, suppress
from glob import escape
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

from uw_visibility.config.files import (
    Products,
    aside_of,
    check_replaced,
    identity,
    in_work,
    replace_folder,
    sole_writer,
    work_folder,
)
from uw_visibility.errors import InputError, refusing
from uw_visibility.replay.bags.decoder import jazzy_types

# Custom metadata in bags of this program; recordings of vehicles do not have it.
WRITER = "uw_visibility.bag_writer"
# Older simulated bags have this topic instead.
TRUTH = "/ground_truth/mean_attenuation"


def products_of(bag: Path) -> Products:
    """Return the files of a bag that this program wrote."""
    return Products(
        "metadata.yaml", (f"{escape(bag.name)}.mcap", "lighting.yaml"),
        "not a bag that this program wrote", keys=(WRITER, TRUTH))


def check_bag(path: Path, overwrite: bool) -> None:
    """Refuse to replace an existing bag, unless allowed and written by this program."""
    if not path.exists() and not path.is_symlink():
        return
    if not overwrite:
        raise InputError(f"{path} exists already: give another name, or --force to replace it")
    if identity(path) is None:
        raise InputError(f"{path} exists already and is not a bag: give another name")
    products_of(path).check(path)


class BagWriter:
    """Bag writer; use it in a ``with`` statement.

    The bag is written beside its target, and renamed when complete. After an error or an
    interruption the incomplete bag is removed.

    topics: type of message by topic, such as ``sensor_msgs/msg/Image``.
    in_place: whether it is written at its target, so that a part can be read after a crash.
    compress: whether chunks are compressed (Zstandard).
    Raises `InputError` if the folder exists already, cannot be made, or is not writable.
    """

    def __init__(
        self, path: str | Path, topics: Mapping[str, str], *, overwrite: bool = False,
        in_place: bool = False, compress: bool = False,
    ) -> None:
        self._target = Path(path)
        check_bag(self._target, overwrite)
        self._before = identity(self._target)
        self._types, self.make = jazzy_types()
        self._open = ExitStack()
        self._aside: Path | None = None
        self._products = products_of(self._target)
        work = in_work(self._products, self._target.name)
        if not in_place:
            self._open.enter_context(sole_writer(self._target, work, self._products))
        try:
            if not in_place:
                self._aside = self._open.enter_context(work_folder(aside_of(self._target), work))
            # Files of the bag are named after its folder.
            self.path = self._target if self._aside is None else self._aside / self._target.name
            self._writer = Writer(
                self.path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP
            )
            if compress:
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except (WriterError, OSError) as error:
            self._open.close()
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"cannot make bag {self._target}: {reason}") from error
        self._writer.set_custom_data(WRITER, "")
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
        with refusing(f"cannot write bag {self._target}"):
            self._writer.write(self._connections[topic], time, data)

    def annotate(self, key: str, value: str) -> None:
        """Add to the custom metadata of the bag, before it is closed."""
        self._writer.set_custom_data(key, value)

    def close(self) -> None:
        """Complete the bag.

        Raises `InputError` if it cannot be written, for instance on a full disk.
        """
        with self._open, refusing(f"cannot write bag {self._target}"):
            self._writer.close()
            if self._aside is not None:
                self._take_place()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *details: object) -> None:
        if kind is None:
            self.close()
            return
        # An error does not matter: the unfinished bag is removed anyway.
        with self._open, suppress(OSError):
            self._writer.abort()

    def _take_place(self) -> None:
        try:
            check_replaced(self._target, self._products, self._before)
        except InputError as error:
            aside = aside_of(self._target)
            kept = self.path.rename(aside.with_name(aside.name.removeprefix(".")))
            raise InputError(f"{error}; the bag is in {kept}") from error
        replace_folder(self.path, self._target, self._products, self._before)

