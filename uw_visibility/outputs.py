# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A frame's result as outgoing messages by topic, the same from the node and from replay.

What is not assessable is not said: the messages under ``visibility/`` appear
only where the estimate behind them has the status ok, so that a consumer never
meets a NaN or an invented value. Images and the disparity always appear.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config import NodeConfig
from uw_visibility.frames import StereoFrame, StereoPair
from uw_visibility.messages import MessageFactory, output_encoding, write_image
from uw_visibility.result import FrameResult
from uw_visibility.status import Status

# The disparity is published in steps of 1/64 px, far below what matching
# resolves, so that delta_d can state the step.
DISPARITY_STEP = 1.0 / 64.0

# Variance of the components of a pose that are not measured: whoever fuses
# them by mistake gives them no weight. A variance of 0 would mean certainty
# to robot_localization, and -1 would be taken by its magnitude.
UNMEASURED_VARIANCE = 1e6

# sensor_msgs/Range.INFRARED: the nearest to visible light that the message knows.
RADIATION_LIGHT = 1


@dataclass(frozen=True)
class Source:
    """What messages are made from: the input, the result, and what makes messages."""

    make: MessageFactory
    frame: StereoFrame
    pair: StereoPair
    result: FrameResult
    config: NodeConfig

    @functools.cached_property
    def left_header(self) -> Any:
        """Stamp and frame of the left image."""
        return self._header(self.frame.left)

    @functools.cached_property
    def right_header(self) -> Any:
        """Stamp and frame of the right image."""
        return self._header(self.frame.right)

    def header(self, stamp: Any, frame_id: str) -> Any:
        """Make a header from a stamp of whatever library."""
        time = self.make("builtin_interfaces/msg/Time", sec=stamp.sec, nanosec=stamp.nanosec)
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame_id)

    def _header(self, message: Any) -> Any:
        return self.header(message.header.stamp, message.header.frame_id)


def build_messages(source: Source, topics: Collection[str]) -> dict[str, Any]:
    """Make the messages of one frame.

    Parameters
    ----------
    source : Source
        Input messages, the pair that was processed, and its result.
    topics : collection of str
        Which of `TOPICS` are wanted.

    Returns
    -------
    dict of str to object
        Message by topic; topics whose value is not assessable are absent.
    """
    messages = {}
    for topic in topics:
        message = _BUILDERS[topic](source)
        if message is not None:
            messages[topic] = message
    return messages


def _left_image(source: Source) -> Any:
    encoding = output_encoding(source.frame.left.encoding)
    return write_image(source.make, source.result.left_enhanced, encoding, source.left_header)


def _right_image(source: Source) -> Any:
    encoding = output_encoding(source.frame.right.encoding)
    return write_image(source.make, source.result.right_enhanced, encoding, source.right_header)


def _left_info(source: Source) -> Any:
    return _camera_info(source, source.frame.left_info, source.left_header)


def _right_info(source: Source) -> Any:
    return _camera_info(source, source.frame.right_info, source.right_header)


def _camera_info(source: Source, info: Any, header: Any) -> Any:
    """Pass the calibration on: P holds for the rectified image, as image_pipeline has it."""
    upper = not hasattr(info, "k")
    matrices = {
        name: np.array(getattr(info, name.upper() if upper else name), np.float64)
        for name in "dkrp"
    }
    roi = info.roi
    return source.make(
        "sensor_msgs/msg/CameraInfo",
        header=header,
        height=info.height,
        width=info.width,
        distortion_model=info.distortion_model,
        binning_x=info.binning_x,
        binning_y=info.binning_y,
        roi=_region(
            source, (roi.x_offset, roi.y_offset, roi.width, roi.height), bool(roi.do_rectify)
        ),
        **matrices,
    )


def _disparity(source: Source) -> Any:
    pixels, low, high = corrected_disparity(source)
    return source.make(
        "stereo_msgs/msg/DisparityImage",
        header=source.left_header,
        image=write_image(source.make, pixels, "32FC1", source.left_header),
        f=source.pair.rig.focal_length,
        t=source.pair.rig.baseline,
        valid_window=_region(source, _valid_window(source)),
        min_disparity=low,
        max_disparity=high,
        delta_d=DISPARITY_STEP,
    )


def corrected_disparity(source: Source) -> tuple[NDArray[np.float32], float, float]:
    """Return the matched disparity as ``stereo_msgs/DisparityImage`` defines it.

    Parameters
    ----------
    source : Source
        The pair and its result.

    Returns
    -------
    disparity : ndarray, (H, W) float32
        x_left - x_right - (cx_left - cx_right), px, so that Z = f t / disparity;
        ``low - 1`` where nothing was matched.
    low, high : float
        The range of disparities searched, without what lies behind infinity.
    """
    result, rig = source.result, source.pair.rig
    low = max(result.min_disparity - rig.offset, 0.0)
    high = max(result.max_disparity - rig.offset, low)
    corrected = result.disparity - np.float32(rig.offset)
    corrected = np.round(corrected / np.float32(DISPARITY_STEP)) * np.float32(DISPARITY_STEP)
    # A comparison with NaN is false, so what was not matched is not kept.
    kept = (corrected > 0.0) & (corrected >= np.float32(low)) & (corrected <= np.float32(high))
    if source.pair.valid is not None:
        kept &= source.pair.valid
    return np.where(kept, corrected, np.float32(low - 1.0)), low, high


def _valid_window(source: Source) -> tuple[int, int, int, int]:
    """Return the window that may hold disparities: the partner must lie in the right image."""
    x, y, width, height = source.pair.valid_window
    image_width = source.result.disparity.shape[1]
    start = max(x, source.result.min_disparity)
    stop = min(x + width, image_width + source.result.max_disparity)
    return start, y, max(stop - start, 0), height


def _region(source: Source, window: tuple[int, int, int, int], do_rectify: bool = False) -> Any:
    x, y, width, height = window
    return source.make(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=x, y_offset=y, height=height, width=width, do_rectify=do_rectify,
    )


def _distance(source: Source) -> Any:
    visibility = source.result.visibility
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


def _attenuation(source: Source) -> Any:
    return _vector(source, source.result.water.attenuation)


def _attenuation_stddev(source: Source) -> Any:
    return _vector(source, source.result.water.attenuation_stddev)


def _ambient_light(source: Source) -> Any:
    return _vector(source, source.result.water.ambient_light)


def _vector(source: Source, values: NDArray[np.float64]) -> Any:
    if source.result.water.status is not Status.OK or not np.isfinite(values).all():
        return None
    vector = source.make(
        "geometry_msgs/msg/Vector3",
        x=float(values[0]), y=float(values[1]), z=float(values[2]),
    )
    return source.make(
        "geometry_msgs/msg/Vector3Stamped", header=source.left_header, vector=vector
    )


def _mean_attenuation(source: Source) -> Any:
    visibility = source.result.visibility
    if visibility.status is not Status.OK or not math.isfinite(visibility.mean_attenuation):
        return None
    return source.make("std_msgs/msg/Float64", data=float(visibility.mean_attenuation))


def _depth(source: Source) -> Any:
    visibility = source.result.visibility
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


_OUTPUTS: dict[str, tuple[str, Callable[[Source], Any]]] = {
    "left/enhanced/image": ("sensor_msgs/msg/Image", _left_image),
    "left/enhanced/camera_info": ("sensor_msgs/msg/CameraInfo", _left_info),
    "right/enhanced/image": ("sensor_msgs/msg/Image", _right_image),
    "right/enhanced/camera_info": ("sensor_msgs/msg/CameraInfo", _right_info),
    "disparity": ("stereo_msgs/msg/DisparityImage", _disparity),
    "visibility/distance": ("sensor_msgs/msg/Range", _distance),
    "visibility/attenuation": ("geometry_msgs/msg/Vector3Stamped", _attenuation),
    "visibility/attenuation_stddev": ("geometry_msgs/msg/Vector3Stamped", _attenuation_stddev),
    "visibility/ambient_light": ("geometry_msgs/msg/Vector3Stamped", _ambient_light),
    "visibility/mean_attenuation": ("std_msgs/msg/Float64", _mean_attenuation),
    "visibility/depth": ("geometry_msgs/msg/PoseWithCovarianceStamped", _depth),
}

_BUILDERS = {topic: builder for topic, (_, builder) in _OUTPUTS.items()}

TOPICS = MappingProxyType({topic: name for topic, (name, _) in _OUTPUTS.items()})
"""Type of message by topic, in the order in which they are published."""
