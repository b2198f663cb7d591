# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Topic selection: stereo pair, calibration and sensors of a recording."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from uw_visibility.errors import InputError
from uw_visibility.messages.depth_sensor import SENSOR_TYPES
from uw_visibility.replay.bags.storage import Channel

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"
ODOMETRY = "nav_msgs/msg/Odometry"
POSITION_TYPES = ("sensor_msgs/msg/NavSatFix", ODOMETRY)

# Patterns of topic names that are not camera images or depth sensors.
OTHER_IMAGES = re.compile(r"enhanced|disparity|ground_truth|depth|mask|compressedDepth|theora")
OTHER_DEPTHS = re.compile(r"ground_truth|visibility|plausibility|image|camera")
DEPTH_NAMES = re.compile(r"depth|pressure")


@dataclass(frozen=True)
class Wanted:
    """Requested topics; those that are None are found by type and name.

    Attributes
    ----------
    left, right, left_info, right_info : str or None
        Images, and their CameraInfo.
    depth : str or None
        Depth sensor, of any of the types that ``plausibility.sensor_type`` names.
    position : str or None
        NavSatFix or Odometry.
    """

    left: str | None = None
    right: str | None = None
    left_info: str | None = None
    right_info: str | None = None
    depth: str | None = None
    position: str | None = None


@dataclass(frozen=True)
class Selection:
    """Topics in use; names as in `Wanted`."""

    left: str
    right: str
    # left_info, right_info: None if the calibration comes from files
    left_info: str | None
    right_info: str | None
    depth: str | None = None
    # message type of the depth sensor, in terms of ``plausibility.sensor_type``
    sensor_type: str = "none"
    position: str | None = None
    notes: list[str] = field(default_factory=list)  # choices among several
    rectify: bool = False  # whether the images must be rectified

    def by_use(self) -> dict[str, str | None]:
        """Return the topics by their use."""
        names = ("left", "right", "left_info", "right_info", "depth", "position")
        return {name: getattr(self, name) for name in names}

    def images(self) -> dict[str, str]:
        return {self.left: "left", self.right: "right"}

    def infos(self) -> dict[str, str]:
        sides = ((self.left_info, "left"), (self.right_info, "right"))
        return {topic: side for topic, side in sides if topic is not None}


def find_topics(
    channels: Mapping[str, Channel],
    wanted: Wanted,
    *,
    rectify: bool,
    calibrated: bool = False,
    sensor_type: str | None = None,
) -> Selection:
    """Choose the topics to use.

    channels, wanted: topics of the recording, and requested ones.
    rectify: whether to look for raw images instead of rectified ones. If there are none, images
        that are rectified by their name are not rectified again.
    calibrated: whether the calibration is known, so that no CameraInfo is needed.
    sensor_type: see ``plausibility.sensor_type``; None finds one.
    """
    notes: list[str] = []
    left, right = _find_pair(channels, wanted, rectify, notes)
    if rectify and wanted.left is None and _is_rectified(left):
        rectify = False
        notes.append(f"{left} is rectified by its name: it is not rectified again")
    infos: list[str | None] = [None, None]
    if not calibrated:
        infos = [
            _find_info(channels, image, given)
            for image, given in ((left, wanted.left_info), (right, wanted.right_info))
        ]
    depth, kind = _find_depth(channels, wanted.depth, sensor_type, notes)
    position = wanted.position
    if position is not None:
        check_topic(channels, position, POSITION_TYPES)
    return Selection(left, right, infos[0], infos[1], depth, kind, position, notes, rectify)


def is_raw(image: str) -> bool:
    """Return whether images are raw by the name of their topic, such as image_raw."""
    return "raw" in image.removesuffix("/compressed").rpartition("/")[2]


def _is_rectified(image: str) -> bool:
    return "rect" in image.rpartition("/left")[2]


def partner(topic: str) -> str | None:
    """Return the topic of the right image for the left one; None without "left" in its name."""
    if not re.search("left", topic, re.IGNORECASE):
        return None
    for old, new in (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT")):
        topic = topic.replace(old, new)
    return topic


def _right_of(channels: Mapping[str, Channel], left: str) -> str | None:
    """Return the right image of a left one, of the same transport if there is one."""
    other = partner(left)
    if other is None:
        return None
    raw = other.removesuffix("/compressed")
    return next((name for name in (other, raw, f"{raw}/compressed") if name in channels), None)


def info_topic(image: str) -> str:
    """Return the topic of the CameraInfo of an image, beside it."""
    base = image.removesuffix("/compressed")
    return f"{base.rpartition('/')[0]}/camera_info"


def _find_pair(
    channels: Mapping[str, Channel], wanted: Wanted, rectify: bool, notes: list[str]
) -> tuple[str, str]:
    if wanted.right is not None and wanted.left is None:
        raise InputError("--right is given without --left: give both")
    if wanted.left is not None:
        check_topic(channels, wanted.left, (IMAGE, COMPRESSED))
        right = wanted.right or _right_of(channels, wanted.left)
        if right is None:
            raise InputError(f"no right image belongs to {wanted.left} by its name: give --right")
        check_topic(channels, right, (IMAGE, COMPRESSED))
        return wanted.left, right
    candidates = [
        (topic, other)
        for topic, channel in channels.items()
        if channel.type in (IMAGE, COMPRESSED) and not OTHER_IMAGES.search(topic)
        and (other := _right_of(channels, topic)) is not None
        and channels[other].type in (IMAGE, COMPRESSED)
    ]
    if not candidates:
        images = [t for t, c in channels.items() if c.type in (IMAGE, COMPRESSED)]
        raise InputError(
            "no pair of images, one with left and one with right in its name, among the topics: "
            f"name them with --left and --right; images are {', '.join(sorted(images)) or 'none'}"
        )
    candidates.sort(key=lambda pair: _rank(channels, pair[0], rectify))
    if len(candidates) > 1:
        others = ", ".join(topic for topic, _ in candidates[1:])
        notes.append(f"{candidates[0][0]} is used instead of {others}")
    return candidates[0]


def _rank(channels: Mapping[str, Channel], topic: str, rectify: bool) -> tuple[object, ...]:
    """Sort key: rectified or raw as requested, with calibration, colour, uncompressed."""
    channel = channels[topic]
    return (
        channel.count == 0,
        _is_rectified(topic) == rectify,
        info_topic(topic) not in channels,
        "mono" in topic,
        channel.type == COMPRESSED,
        topic.count("/"),
        topic,
    )


def _find_info(channels: Mapping[str, Channel], image: str, given: str | None) -> str:
    topic = given or info_topic(image)
    if given is None and topic not in channels:
        raise InputError(
            f"there is no {topic} beside {image}: name the topic with --left-info and "
            "--right-info, or give --calibration"
        )
    check_topic(channels, topic, (INFO,))
    return topic


def _find_depth(
    channels: Mapping[str, Channel], given: str | None, kind: str | None, notes: list[str]
) -> tuple[str | None, str]:
    if kind == "none":
        return None, "none"
    types = depth_types(kind)
    if given is not None:
        check_topic(channels, given, tuple(types))
        return given, types[channels[given].type]
    found = [
        topic for topic, channel in channels.items()
        if channel.type in types and DEPTH_NAMES.search(topic) and not OTHER_DEPTHS.search(topic)
    ]
    if not found:
        return None, "none"
    found.sort(key=lambda t: (
        channels[t].count == 0, not t.endswith("depth_sensor"), t.count("/"), t))
    if len(found) > 1:
        notes.append(f"depth sensor {found[0]} is used instead of {', '.join(found[1:])}")
    return found[0], types[channels[found[0]].type]


def depth_types(kind: str | None) -> dict[str, str]:
    """Return message types of a depth sensor, with their names in parameters."""
    names = {message: name for name, message in SENSOR_TYPES.items()}
    return names if kind is None else {SENSOR_TYPES[kind]: kind}


def check_topic(
    channels: Mapping[str, Channel], topic: str, types: Collection[str] = ()
) -> None:
    """Refuse a topic that is missing, or has none of the given types."""
    if topic not in channels:
        raise InputError(f"there is no topic {topic} in the recording: --list shows what there is")
    if types and channels[topic].type not in types:
        raise InputError(f"{topic} is a {channels[topic].type}: give one of {', '.join(types)}")
