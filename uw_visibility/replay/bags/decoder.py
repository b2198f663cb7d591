# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Decoder of recorded messages, by the message definitions in the recording."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from uw_visibility.errors import InputError, printable
from uw_visibility.messages.images import MessageFactory
from uw_visibility.replay.bags.storage import Channel, Recorded

IDL_SEPARATOR = "=" * 80 + "\n"


class Decoder:
    """Decoder of messages of ROS 2 or ROS 1; `channels` are by message type.

    Each type has its own type store, so that a bad definition does not affect others.
    """

    def __init__(self, channels: Mapping[str, Channel], ros1: bool) -> None:
        self._channels = channels
        self._ros1 = ros1
        self._stores: dict[str, Any] = {}

    def decode(self, message: Recorded) -> Any:
        """Return a message as an object.

        Raises `InputError` if its type is unknown, or its data do not fit the type.
        """
        store = self._stores.get(message.type)
        if store is None:
            store = self._stores[message.type] = self._store(message.type)
        read = store.deserialize_ros1 if self._ros1 else store.deserialize_cdr
        try:
            # Arrays in the object are views of this. A bytearray makes them writable: for read-only
            # arrays kernels would be compiled again.
            return read(bytearray(message.data), message.type)
        except Exception as error:
            # The generated readers check nothing, so that damage may raise any error.
            raise InputError(
                f"a message on {printable(message.topic)} is damaged: {type(error).__name__}"
            ) from error

    def _store(self, kind: str) -> Any:
        channel = self._channels.get(kind)
        # The common types never changed. Their definitions in a recording may be damaged, or of
        # another type under this name.
        known = common_types(self._ros1)
        if kind in known.types:
            return known
        if channel is None or not channel.format:
            raise InputError(f"the recording does not define its type {printable(kind)}")
        store = get_typestore(Stores.EMPTY)
        try:
            store.register(_types(channel))
        except Exception as error:
            raise InputError(
                f"the definition of {printable(kind)} in the recording cannot be read: "
                f"{printable(error)}"
            ) from error
        return store


@functools.cache
def common_types(ros1: bool) -> Any:
    """Return the type store of messages of ROS; do not add types to it.

    It is cached, since it compiles a reader and a writer for each type in use.
    """
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)


def _types(channel: Channel) -> dict[str, Any]:
    if channel.format == "msg":
        return dict(get_types_from_msg(channel.definition, channel.type))
    types: dict[str, Any] = {}
    parts = channel.definition.split(IDL_SEPARATOR)
    for part in parts[1:] or parts:
        # If there are several parts, each begins with a line with its name.
        text = part.split("\n", 1)[1] if part.startswith("IDL: ") else part
        types.update(get_types_from_idl(text))
    return types


def jazzy_types() -> tuple[Any, MessageFactory]:
    """Return the type store of ROS 2 Jazzy, for serialisation, and a factory of its messages."""
    store = common_types(ros1=False)
    return store, lambda name, /, **fields: store.types[name](**fields)
