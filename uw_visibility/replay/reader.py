# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of recordings."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from uw_visibility.errors import InputError


class Recorded(NamedTuple):
    """One message as it was recorded.

    Attributes
    ----------
    topic : str
        Topic.
    type : str
        Type of message, such as ``sensor_msgs/msg/Image``.
    time : int
        When it was received, in ns.
    data : bytes
        The serialised message.
    """

    topic: str
    type: str
    time: int
    data: bytes


class BagReader:
    """Reads a bag; to be used in a ``with`` statement.

    Parameters
    ----------
    path : str or Path
        Folder of a ROS 2 bag, or file of a ROS 1 bag.

    Raises
    ------
    InputError
        If it cannot be read as a bag.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        # Bags of older distributions carry no definitions; Jazzy's have not changed since.
        types = get_typestore(Stores.ROS2_JAZZY)
        try:
            self._reader = AnyReader([self.path], default_typestore=types)
            self._reader.open()
        except (AnyReaderError, OSError) as error:
            reason = " ".join(str(getattr(error, "strerror", None) or error).split())
            raise InputError(f"cannot read bag {self.path}: {reason}") from error

    @property
    def topics(self) -> dict[str, str]:
        """Type of message by topic."""
        return {c.topic: c.msgtype for c in self._reader.connections}

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Recorded]:
        """Yield the messages of some topics, or of all, in the order of time.

        Raises
        ------
        InputError
            If the recording is damaged.
        """
        chosen = [c for c in self._reader.connections if topics is None or c.topic in topics]
        if not chosen:
            return
        try:
            for connection, time, data in self._reader.messages(chosen):
                yield Recorded(connection.topic, connection.msgtype, time, data)
        except AnyReaderError as error:
            raise InputError(f"bag {self.path} is damaged: {error}") from error

    def deserialize(self, message: Recorded) -> Any:
        """Return a recorded message as an object of the bag's own types."""
        return self._reader.deserialize(message.data, message.type)

    def __enter__(self) -> BagReader:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._reader.close()
