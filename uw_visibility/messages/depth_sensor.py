# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Depth from messages of depth sensors, for the classes of rclpy and of rosbags alike."""

from __future__ import annotations

import math
from typing import Any

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.errors import InputError
from uw_visibility.messages.images import stamp_to_nanoseconds
from uw_visibility.plausibility.comparison import DepthSample

STANDARD_GRAVITY = 9.80665

SENSOR_TYPES = {
    "PoseWithCovarianceStamped": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "Odometry": "nav_msgs/msg/Odometry",
    "FluidPressure": "sensor_msgs/msg/FluidPressure",
    "PointStamped": "geometry_msgs/msg/PointStamped",
    "Float64": "std_msgs/msg/Float64",
}
"""Type of message by ``plausibility.sensor_type``."""

# Least pressure of a sensor that measures the air's at the surface, Pa: on the highest lakes it is
# 5e4, and in millibar the number is smaller even at 200 m of depth.
LEAST_PRESSURE = 3e4

# Drivers write variances of this size if z is not measured.
UNMEASURED_VARIANCE = 1e6
# Values that stand for an unknown variance.
UNKNOWN_VARIANCES = (0.0, -1.0)
# The deepest place on Earth is 10,935 m deep.
MAX_DEPTH = 12_000.0
Z_VARIANCE = 14  # index in the covariance of a pose


def read_depth(message: Any, config: PlausibilityConfig, arrival: int) -> DepthSample:
    """Read the depth of the camera from a sensor's message of the configured type.

    `arrival`, ns, is the stamp of types that have none. Raises `InputError` without a stamp, for
    numbers that are not finite or deeper than any ocean, and for a pressure that cannot be in Pa.
    Errors do not have the value: they are counted by their text.
    """
    if config.sensor_type == "Float64":
        stamp, value, variance = arrival, float(message.data), 0.0
    else:
        stamp = stamp_to_nanoseconds(message.header.stamp)
        value, variance = _value(message, config)
        if stamp == 0:
            raise InputError("depth_sensor has no stamp: fill header.stamp with its time")
    if not math.isfinite(value):
        raise InputError(f"depth_sensor says {value}: publish finite numbers only")
    depth = _sign(config) * value + config.sensor_offset
    if abs(depth) > MAX_DEPTH:
        raise InputError(
            f"depth_sensor says a depth beyond {MAX_DEPTH:g} m, but no ocean is so deep: publish "
            "metres, or pascals as FluidPressure"
        )
    if not math.isfinite(variance) or (variance < 0.0 and variance not in UNKNOWN_VARIANCES):
        raise InputError(
            f"depth_sensor states the variance {variance:.6g}: publish a positive one, or 0 if it "
            "is unknown"
        )
    if config.sensor_type == "FluidPressure" and variance > 0.0:
        variance /= (config.density * STANDARD_GRAVITY) ** 2
    if not 0.0 < variance < UNMEASURED_VARIANCE:
        variance = config.sensor_stddev**2
    return DepthSample(stamp, depth, variance)


def _value(message: Any, config: PlausibilityConfig) -> tuple[float, float]:
    """Return a message's depth or height in m, and the variance that it states."""
    if config.sensor_type == "FluidPressure":
        pressure = float(message.fluid_pressure)
        if pressure < LEAST_PRESSURE <= config.surface_pressure:
            raise InputError(
                "depth_sensor says less than the pressure of air: publish pascals, not mbar, or "
                "set plausibility.surface_pressure to 0 for gauge pressure"
            )
        depth = (pressure - config.surface_pressure) / (config.density * STANDARD_GRAVITY)
        return depth, float(message.variance)
    if config.sensor_type == "PointStamped":
        return float(message.point.z), 0.0
    return float(message.pose.pose.position.z), float(message.pose.covariance[Z_VARIANCE])


def _sign(config: PlausibilityConfig) -> float:
    if config.sensor_type == "FluidPressure":
        return 1.0
    if config.sensor_sign == "auto":
        return 1.0 if config.sensor_type == "Float64" else -1.0
    return 1.0 if config.sensor_sign == "down" else -1.0
