# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Factory of rclpy messages, from type names and numpy arrays."""

from __future__ import annotations

import array
import functools
import importlib
from typing import Any

import numpy as np


@functools.cache
def message_type(name: str) -> Any:
    """Return the class of a type named like ``sensor_msgs/msg/Image``."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def make_message(name: str, /, **fields: Any) -> Any:
    """Make a message; see `uw_visibility.messages.images.MessageFactory`."""
    kind = message_type(name)
    images = {
        key: value for key, value in fields.items()
        if isinstance(value, np.ndarray) and value.dtype == np.uint8
    }
    others = {key: value for key, value in fields.items() if key not in images}
    if images and hasattr(kind, "_check_fields"):
        # With the check a message keeps the array; without it, a message copies it, but all else
        # is quicker. Only this private attribute shows that the check is optional, since Jazzy.
        others["check_fields"] = True
    message = kind(**others)
    for key, value in images.items():
        # Set afterwards, since the constructor copies. rclpy keeps an array.array, but
        # converts a numpy array byte by byte.
        data = array.array("B")
        data.frombytes(value.data)
        setattr(message, key, data)
    return message
