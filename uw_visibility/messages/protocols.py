# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Protocols of incoming messages, for the classes of rclpy and of rosbags alike."""

from __future__ import annotations

from typing import Any, Protocol

from uw_visibility.stereo.calibration import CameraInfo


class Stamp(Protocol):
    """``builtin_interfaces/Time``."""

    sec: int
    nanosec: int


class Header(Protocol):
    """``std_msgs/Header``."""

    frame_id: str

    @property
    def stamp(self) -> Stamp: ...


class Stamped(Protocol):
    """Any message with a header."""

    @property
    def header(self) -> Header: ...


class ImageMessage(Stamped, Protocol):
    """``sensor_msgs/Image``; its data are a buffer of bytes."""

    height: int
    width: int
    encoding: str
    is_bigendian: Any
    step: int
    data: Any


class CompressedImageMessage(Stamped, Protocol):
    """``sensor_msgs/CompressedImage``."""

    format: str
    data: Any


class CameraInfoMessage(Stamped, CameraInfo, Protocol):
    """``sensor_msgs/CameraInfo``."""
