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

import math
from collections.abc import Callable, Collection, Iterator
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages.output_images import (
    Source,
    depth_image,
    depth_info,
    disparity,
    left_image,
    left_info,
    points,
    right_image,
    right_info,
)
from uw_visibility.status import Status
from uw_visibility.water.assessment import Visibility
from uw_visibility.water.estimation import WaterEstimate

# Variance of the components of a pose that are not measured: whoever fuses
# them by mistake gives them no weight. A variance of 0 would mean certainty
# to robot_localization, and -1 would be taken by its magnitude.
UNMEASURED_VARIANCE = 1e6

# sensor_msgs/Range.INFRARED: the nearest to visible light that the message knows.
RADIATION_LIGHT = 1


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


def _water(source: Source, filtered: bool) -> WaterEstimate:
    tracked = source.result.tracked
    return tracked if filtered and tracked is not None else source.result.water


def _visibility(source: Source, filtered: bool) -> Visibility:
    tracked = source.result.tracked_visibility
    return tracked if filtered and tracked is not None else source.result.visibility


def _distance(source: Source, filtered: bool) -> Any:
    visibility = _visibility(source, filtered)
    if visibility.status is not Status.OK or math.isnan(visibility.distance):
        return None
    max_range = source.config.max_range
    seen = visibility.distance <= max_range
    width = source.result.disparity.shape[1]
    return source.make(
        "sensor_msgs/msg/Range",
        header=source.left_header,
        radiation_type=RADIATION_LIGHT,
        field_of_view=2.0 * math.atan(width / (2.0 * source.pair.rig.focal_length)),
        min_range=0.0,
        max_range=max_range,
        range=visibility.distance if seen else math.inf,
        variance=_variance(visibility.distance_stddev) if seen else 0.0,
    )


def _variance(stddev: float) -> float:
    """Return a variance for Range, where 0 says that it is not known."""
    return stddev**2 if math.isfinite(stddev) else 0.0


def _attenuation(source: Source, filtered: bool) -> Any:
    water = _water(source, filtered)
    return _vector(source, water, water.attenuation)


def _attenuation_stddev(source: Source, filtered: bool) -> Any:
    water = _water(source, filtered)
    return _vector(source, water, water.attenuation_stddev)


def _ambient_light(source: Source, filtered: bool) -> Any:
    water = _water(source, filtered)
    return _vector(source, water, water.ambient_light)


def _vector(source: Source, water: WaterEstimate, values: NDArray[np.float64]) -> Any:
    if water.status is not Status.OK or not np.isfinite(values).all():
        return None
    vector = source.make(
        "geometry_msgs/msg/Vector3",
        x=float(values[0]), y=float(values[1]), z=float(values[2]),
    )
    return source.make(
        "geometry_msgs/msg/Vector3Stamped", header=source.left_header, vector=vector
    )


def _mean_attenuation(source: Source, filtered: bool) -> Any:
    visibility = _visibility(source, filtered)
    if visibility.status is not Status.OK or not math.isfinite(visibility.mean_attenuation):
        return None
    return source.make("std_msgs/msg/Float64", data=float(visibility.mean_attenuation))


def _depth(source: Source, filtered: bool) -> Any:
    visibility = _visibility(source, filtered)
    numbers = (visibility.depth, visibility.depth_stddev)
    if visibility.depth_status is not Status.OK or not all(map(math.isfinite, numbers)):
        return None
    covariance = UNMEASURED_VARIANCE * np.eye(6)
    covariance[2, 2] = visibility.depth_stddev**2
    pose = source.make(
        "geometry_msgs/msg/Pose",
        position=source.make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=-float(visibility.depth)),
        orientation=source.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    return source.make(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        header=source.header(source.frame.left.header.stamp, source.config.depth_frame),
        pose=source.make(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel()
        ),
    )


_ESTIMATES: dict[str, tuple[str, Callable[[Source, bool], Any]]] = {
    "distance": ("sensor_msgs/msg/Range", _distance),
    "attenuation": ("geometry_msgs/msg/Vector3Stamped", _attenuation),
    "attenuation_stddev": ("geometry_msgs/msg/Vector3Stamped", _attenuation_stddev),
    "ambient_light": ("geometry_msgs/msg/Vector3Stamped", _ambient_light),
    "mean_attenuation": ("std_msgs/msg/Float64", _mean_attenuation),
    "depth": ("geometry_msgs/msg/PoseWithCovarianceStamped", _depth),
}


def _estimates(folder: str, filtered: bool) -> dict[str, tuple[str, Callable[[Source], Any]]]:
    def of(builder: Callable[[Source, bool], Any]) -> Callable[[Source], Any]:
        return lambda source: builder(source, filtered)

    return {
        f"{folder}/{topic}": (name, of(builder)) for topic, (name, builder) in _ESTIMATES.items()
    }


_OUTPUTS: dict[str, tuple[str, Callable[[Source], Any]]] = {
    # What a vehicle acts on goes first, before what is large.
    **_estimates("visibility", True),
    **_estimates("visibility/raw", False),
    "disparity": ("stereo_msgs/msg/DisparityImage", disparity),
    "left/enhanced/image": ("sensor_msgs/msg/Image", left_image),
    "left/enhanced/camera_info": ("sensor_msgs/msg/CameraInfo", left_info),
    "right/enhanced/image": ("sensor_msgs/msg/Image", right_image),
    "right/enhanced/camera_info": ("sensor_msgs/msg/CameraInfo", right_info),
}

_DEPTH_OUTPUTS: dict[str, tuple[str, Callable[[Source], Any]]] = {
    "depth/image": ("sensor_msgs/msg/Image", depth_image),
    "depth/camera_info": ("sensor_msgs/msg/CameraInfo", depth_info),
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
