# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Makes rclpy messages from type names and numpy arrays."""

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
    """Make a message; see `uw_visibility.messages.MessageFactory`."""
    return message_type(name)(**{key: _sequence(value) for key, value in fields.items()})


def _sequence(value: Any) -> Any:
    if not isinstance(value, np.ndarray) or value.dtype != np.uint8:
        return value
    # rclpy copies an array.array at once, a numpy array byte by byte.
    data = array.array("B")
    data.frombytes(value.data)
    return data
