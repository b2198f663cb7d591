# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of a few tiny frames in every form that is read, and what is in them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

FRAMES = 4
WIDTH, HEIGHT, FOCAL, BASELINE, DISPARITY = 96, 72, 90.0, 0.1, 8
START = 1_700_000_000

Message = tuple[str, str, Any, int]


def scene(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a pair of images with texture, the right one shifted."""
    rng = np.random.default_rng(seed)
    wide = rng.integers(40, 200, (HEIGHT, WIDTH + DISPARITY, 3)).astype(np.uint8)
    wide = cv2.GaussianBlur(wide, (0, 0), 1.2)
    return np.ascontiguousarray(wide[:, :WIDTH]), np.ascontiguousarray(wide[:, DISPARITY:])


def messages(types: Any, codec: str = "") -> Iterator[Message]:
    """Yield the messages of a short dive; images as JPEG or PNG where a codec is given."""
    for frame in range(FRAMES):
        second, nanosecond = START + frame // 2, 500_000_000 * (frame % 2)
        stamp = types["builtin_interfaces/msg/Time"](second, nanosecond)
        header = types["std_msgs/msg/Header"](stamp, "camera")
        time = 1_000_000_000 * second + nanosecond
        for side, image in zip(("left", "right"), scene(frame), strict=True):
            yield f"/{side}/camera_info", "sensor_msgs/msg/CameraInfo", _info(
                types, header, side), time
            if codec:
                data = cv2.imencode(f".{codec}", image[..., ::-1])[1].ravel()
                yield f"/{side}/image_rect/compressed", "sensor_msgs/msg/CompressedImage", types[
                    "sensor_msgs/msg/CompressedImage"](header, f"rgb8; {codec} compressed bgr8",
                                                       data), time
            else:
                yield f"/{side}/image_rect", "sensor_msgs/msg/Image", types[
                    "sensor_msgs/msg/Image"](
                        header, HEIGHT, WIDTH, "rgb8", 0, 3 * WIDTH, image.ravel()), time
        yield "/depth_sensor", "std_msgs/msg/Float64", types["std_msgs/msg/Float64"](
            3.0 + 0.1 * frame), time + 1000


def _info(types: Any, header: Any, side: str) -> Any:
    k = np.array([FOCAL, 0, WIDTH / 2, 0, FOCAL, HEIGHT / 2, 0, 0, 1])
    p = np.array([FOCAL, 0, WIDTH / 2, 0, 0, FOCAL, HEIGHT / 2, 0, 0, 0, 1, 0.0])
    if side == "right":
        p[3] = -FOCAL * BASELINE
    fields = {"k": k, "d": np.zeros(5), "r": np.eye(3).ravel(), "p": p}
    kind = types["sensor_msgs/msg/CameraInfo"]
    if "K" in kind.__dataclass_fields__:
        fields = {name.upper(): value for name, value in fields.items()}
    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    return kind(header=header, height=HEIGHT, width=WIDTH, distortion_model="plumb_bob",
                binning_x=0, binning_y=0, roi=roi, **fields)


def write_ros2(
    folder: Path, storage: StoragePlugin, mode: CompressionMode = CompressionMode.NONE,
    codec: str = "",
) -> Path:
    """Write the dive as a bag of ROS 2; returns the file with the messages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer2(folder, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, message, time in messages(store.types, codec):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, store.serialize_cdr(message, kind))
    return next(file for file in folder.iterdir() if file.suffix != ".yaml")


def write_ros1(path: Path, compression: str = "") -> Path:
    """Write the dive as a bag of ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, message, time in messages(_with_counter(store.types)):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, store.serialize_ros1(message, kind))
    return path


def _with_counter(types: Any) -> dict[str, Any]:
    header = types["std_msgs/msg/Header"]
    return {**types, "std_msgs/msg/Header": lambda stamp, frame: header(7, stamp, frame)}


def write_all(folder: Path) -> dict[str, Path]:
    """Write the dive in every form; returns the file with the messages by form."""
    mcap, sqlite = StoragePlugin.MCAP, StoragePlugin.SQLITE3
    mode = CompressionMode
    return {
        "mcap": write_ros2(folder / "mcap", mcap),
        "mcap, jpeg": write_ros2(folder / "jpeg", mcap, codec="jpg"),
        "mcap, png": write_ros2(folder / "png", mcap, codec="png"),
        "mcap, packed chunks": write_ros2(folder / "chunks", mcap, mode.STORAGE),
        "mcap, packed messages": write_ros2(folder / "messages", mcap, mode.MESSAGE),
        "mcap, packed file": write_ros2(folder / "file", mcap, mode.FILE),
        "sqlite": write_ros2(folder / "sqlite", sqlite),
        "sqlite, packed messages": write_ros2(folder / "sqlite_messages", sqlite, mode.MESSAGE),
        "ROS 1": write_ros1(folder / "plain.bag"),
        "ROS 1, bz2": write_ros1(folder / "bz2.bag", "BZ2"),
        "ROS 1, lz4": write_ros1(folder / "lz4.bag", "LZ4"),
    }
