# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Output messages of a frame's result by topic, the same from node and replay.

What is not assessable is not said: the messages under ``visibility/`` appear
only where the estimate behind them has the status ok, so that a consumer never
meets a NaN or an invented value. Images and the disparity always appear.

Each estimate appears twice: under ``visibility/raw/`` that of the frame alone, and
under ``visibility/`` the one filtered over frames, where they are tracked. Who
filters by himself wants the raw one: errors of the filtered one last for seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from functools import partial
from types import MappingProxyType
from typing import Any

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.estimates import ESTIMATES
from uw_visibility.messages.output_images import (
    Source,
    camera_info,
    depth_image,
    disparity,
    enhanced_image,
    points,
)

FILTERED, RAW = "visibility", "visibility/raw"
"""Where estimates appear, filtered over frames and of the frame alone."""


def each_message(source: Source, topics: Collection[str]) -> Iterator[tuple[str, Any]]:
    """Make the messages of one frame, one after the other, so that each can go at once.

    Parameters
    ----------
    source : Source
        Input messages, the pair that was processed, and its result.
    topics : collection of str
        Which of `all_topics` are wanted.

    Yields
    ------
    topic : str
        In the order of `topics`; those whose value is not assessable are left out.
    message : object
    """
    for topic in topics:
        message = _BUILDERS[topic](source)
        if message is not None:
            yield topic, message


def _estimates(folder: str, filtered: bool) -> dict[str, tuple[str, Callable[[Source], Any]]]:
    def of(name: str) -> Callable[[Source], Any]:
        return lambda source: source.estimate(filtered).message(name)

    return {f"{folder}/{name}": (kind, of(name)) for name, kind in ESTIMATES.items()}


_OUTPUTS: dict[str, tuple[str, Callable[[Source], Any]]] = {
    # What a vehicle acts on goes first, before what is large.
    **_estimates(FILTERED, True),
    **_estimates(RAW, False),
    "disparity": ("stereo_msgs/msg/DisparityImage", disparity),
    "left/enhanced/image": ("sensor_msgs/msg/Image", partial(enhanced_image, "left")),
    "left/enhanced/camera_info": ("sensor_msgs/msg/CameraInfo", partial(camera_info, "left")),
    "right/enhanced/image": ("sensor_msgs/msg/Image", partial(enhanced_image, "right")),
    "right/enhanced/camera_info": ("sensor_msgs/msg/CameraInfo", partial(camera_info, "right")),
}

_DEPTH_OUTPUTS: dict[str, tuple[str, Callable[[Source], Any]]] = {
    "depth/image": ("sensor_msgs/msg/Image", depth_image),
    # It lies in the left rectified image.
    "depth/camera_info": ("sensor_msgs/msg/CameraInfo", partial(camera_info, "left")),
}
_POINT_OUTPUTS: dict[str, tuple[str, Callable[[Source], Any]]] = {
    "points2": ("sensor_msgs/msg/PointCloud2", points),
}
_BUILDERS = {
    topic: builder
    for outputs in (_OUTPUTS, _DEPTH_OUTPUTS, _POINT_OUTPUTS)
    for topic, (_, builder) in outputs.items()
}

TOPICS = MappingProxyType({topic: name for topic, (name, _) in _OUTPUTS.items()})
"""Type of message by topic, in the order in which they are published."""

_NEEDS_LEFT = ("left/enhanced/image", "points2")


def all_topics(config: NodeConfig) -> dict[str, str]:
    """Return type of message by topic, with the optional ones that are switched on."""
    topics = dict(TOPICS)
    if config.publish_depth_image:
        topics |= {topic: name for topic, (name, _) in _DEPTH_OUTPUTS.items()}
    if config.publish_points:
        topics |= {topic: name for topic, (name, _) in _POINT_OUTPUTS.items()}
    return topics


def enhanced_sides(topics: Collection[str]) -> tuple[str, ...]:
    """Return the sides whose enhanced image is needed for topics."""
    left = any(topic in topics for topic in _NEEDS_LEFT)
    right = "right/enhanced/image" in topics
    return ("left",) * left + ("right",) * right
