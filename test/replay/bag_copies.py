# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Copies of a bag in other forms, edited or damaged, and the command on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from uw_visibility.cli import main
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.table import read_rows

FRAMES, DIVE_FRAMES = 6, 12
# What is wrong with a disturbed dive: three frames, and ns.
DARK, SET_BACK, WALL, SENSOR_DELAY = 3, 7, 9, 130_000_000
TOPICS = ("/left/image_rect", "/right/image_rect", "/left/camera_info", "/right/camera_info",
          "/depth_sensor")

# With them, frames depend on those before in every way that there is.
HARD_PARAMETERS = {"tracking.enabled": True,
                   "plausibility.max_gate": 50.0}

# A message on its way into a copy: topic, type, object, time.
Message = tuple[str, str, Any, int]
Edit = Callable[[Iterator[Message]], Iterator[Message]]


def copy_bag(
    source: Path,
    target: Path,
    *,
    edit: Edit = lambda messages: messages,
    storage: StoragePlugin = StoragePlugin.MCAP,
    mode: CompressionMode = CompressionMode.NONE,
) -> Path:
    """Copy a bag, as another kind of ROS 2 bag or edited."""
    types = get_typestore(Stores.ROS2_JAZZY)
    with BagReader(source) as reader:
        writer = Writer2(target, version=9, storage_plugin=storage)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            connections: dict[str, Any] = {}
            for topic, kind, message, time in edit(_messages(reader)):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=types)
                writer.write(connections[topic], time, types.serialize_cdr(message, kind))
    return target


def copy_bag_ros1(source: Path, target: Path, compression: str = "") -> Path:
    """Copy a bag as one of ROS 1."""
    types = get_typestore(Stores.ROS1_NOETIC)
    with BagReader(source) as reader:
        writer = Writer1(target)
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression])
        with writer:
            connections: dict[str, Any] = {}
            for topic, kind, message, time in _messages(reader):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=types)
                old = _as_ros1(types, message)
                writer.write(connections[topic], time, types.serialize_ros1(old, kind))
    return target


def _messages(reader: BagReader) -> Iterator[Message]:
    for m in reader.messages(TOPICS):
        yield m.topic, m.type, reader.deserialize(m), m.time


def _as_ros1(types: Any, message: Any) -> Any:
    """Make the ROS 1 form of a message: headers count, and CameraInfo is in capitals."""
    name = getattr(message, "__msgtype__", None)
    if name is None:
        return message
    fields = {}
    for field in types.types[name].__dataclass_fields__:
        if field in ("__msgtype__", "seq"):
            continue
        old = field if hasattr(message, field) else field.lower()
        fields[field] = _as_ros1(types, getattr(message, old))
    if name == "std_msgs/msg/Header":
        fields["seq"] = 7
    return types.types[name](**fields)


def compressed(messages: Iterator[Message]) -> Iterator[Message]:
    """Turn images into PNG."""
    types = get_typestore(Stores.ROS2_JAZZY).types
    for topic, kind, message, time in messages:
        if kind == "sensor_msgs/msg/Image":
            pixels = message.data.reshape(message.height, message.width, 3)
            _, data = cv2.imencode(".png", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
            kind = "sensor_msgs/msg/CompressedImage"
            message = types[kind](
                message.header, "rgb8; png compressed bgr8", data.ravel().astype(np.uint8)
            )
            topic += "/compressed"
        yield topic, kind, message, time


def fix(beside: Message, latitude: float, longitude: float) -> Message:
    """A GPS fix with the header of another message."""
    types = get_typestore(Stores.ROS2_JAZZY).types
    return "/fix", "sensor_msgs/msg/NavSatFix", types["sensor_msgs/msg/NavSatFix"](
        header=beside[2].header, status=types["sensor_msgs/msg/NavSatStatus"](status=0, service=1),
        latitude=latitude, longitude=longitude, altitude=0.0, position_covariance=np.zeros(9),
        position_covariance_type=0), beside[3]


def disturbed(messages: Iterator[Message]) -> Iterator[Message]:
    """Let the sensor run late, a pair be black, the clock be set back, and a pair show a wall."""
    frame = -1
    seen = np.empty(0, np.uint8)
    for topic, kind, message, time in messages:
        frame += topic == "/left/image_rect"
        if topic == "/depth_sensor":
            message.header.stamp.nanosec += SENSOR_DELAY
            time += SENSOR_DELAY
        if kind == "sensor_msgs/msg/Image" and frame == DARK:
            message.data = np.zeros_like(message.data)
        if topic == "/left/image_rect":
            seen = message.data.reshape(message.height, message.width, 3)
        if topic == "/right/image_rect" and frame == WALL:
            # Of one range, so refused: it is restored with the water of the frames before.
            message.data = np.roll(seen, -8, axis=1).ravel()
        if frame >= SET_BACK:
            message.header.stamp.sec -= 60
        yield topic, kind, message, time


def shortened(path: Path, share: float) -> Path:
    """Cut a file off."""
    data = path.read_bytes()
    path.write_bytes(data[: round(share * len(data))])
    return path


def messages_of(out: Path) -> list[tuple[str, int, bytes]]:
    """Return topic, time and content of the messages of a result."""
    with BagReader(out / "results.mcap") as reader:
        return [(m.topic, m.time, m.data) for m in reader.messages()]


def parameter_file(path: Path, values: dict[str, Any]) -> str:
    """Write parameters by their dotted names; returns the path."""
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
    return str(path)


def run(
    bag: Path, target: Path, *options: str, capsys: pytest.CaptureFixture[str] | None = None
) -> SimpleNamespace:
    """Replay a bag by the command; returns exit code, rows and what was printed."""
    code = main(["replay", str(bag), "-o", str(target), "--jobs", "1", *options])
    table = target / "frames.csv"
    printed = capsys.readouterr() if capsys else SimpleNamespace(out="", err="")
    return SimpleNamespace(
        code=code, rows=list(read_rows(table)) if table.is_file() else [],
        out=printed.out, err=printed.err,
    )
