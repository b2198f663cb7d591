# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of an estimate of the water, and of its comparison with a depth sensor."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from uw_visibility.config.schema import NodeConfig
from uw_visibility.images.arrays import Array
from uw_visibility.messages.images import MessageFactory
from uw_visibility.plausibility.comparison import Comparison
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility

# Variance of the unmeasured components of a pose: they get no weight if they
# are fused by mistake. robot_localization takes a variance of 0 for certainty,
# and -1 by its magnitude.
UNMEASURED_VARIANCE = 1e6

# sensor_msgs/Range.INFRARED: the message's closest type to visible light.
RADIATION_LIGHT = 1

_OPTICAL = re.compile(r"_optical(_frame|_link)?$")

VECTOR = "geometry_msgs/msg/Vector3Stamped"
NIS, STAMPED_NIS = "depth_plausibility/nis", "depth_plausibility/nis_stamped"

NIS_TOPICS = MappingProxyType({NIS: "std_msgs/msg/Float64", STAMPED_NIS: VECTOR})
"""Type of message by topic."""


class ImageHeader(NamedTuple):
    """Stamp and frame of an image."""

    sec: int
    nanosec: int
    frame_id: str

    @classmethod
    def of(cls, message: Any) -> ImageHeader:
        """Read the header of a message of rclpy or rosbags."""
        header = message.header
        return cls(int(header.stamp.sec), int(header.stamp.nanosec), str(header.frame_id))

    @classmethod
    def at(cls, stamp: int, frame_id: str = "") -> ImageHeader:
        """Return a header with a stamp, ns."""
        return cls(*divmod(stamp, 1_000_000_000), frame_id)

    @property
    def seconds(self) -> float:
        """The stamp, s."""
        return 1e-9 * (self.sec * 1_000_000_000 + self.nanosec)

    def message(self, make: MessageFactory) -> Any:
        """Make a ``std_msgs/Header``."""
        time = make("builtin_interfaces/msg/Time", sec=self.sec, nanosec=self.nanosec)
        return make("std_msgs/msg/Header", stamp=time, frame_id=self.frame_id)


def vector_message(make: MessageFactory, header: Any, values: Iterable[float]) -> Any:
    """Make a Vector3Stamped of three numbers."""
    x, y, z = map(float, values)
    vector = make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
    return make(VECTOR, header=header, vector=vector)


def depth_message(make: MessageFactory, header: Any, depth: float, variance: float) -> Any:
    """Make a PoseWithCovarianceStamped: z = −depth, m, with its variance, m²; others unmeasured."""
    covariance = UNMEASURED_VARIANCE * np.eye(6)
    covariance[2, 2] = variance
    pose = make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=-float(depth)),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    return make(
        "geometry_msgs/msg/PoseWithCovarianceStamped", header=header, pose=make(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel()),
    )


def region_message(
    make: MessageFactory, window: tuple[int, int, int, int], do_rectify: bool = False
) -> Any:
    """Make a RegionOfInterest of column, row, width and height, px."""
    x, y, width, height = window
    return make(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=x, y_offset=y, height=height, width=width, do_rectify=do_rectify,
    )


@dataclass(frozen=True, eq=False)
class Estimate:
    """Source of an estimate's messages: the estimate, and header and optics of the left image.

    `field_of_view` is horizontal, rad.
    """

    make: MessageFactory
    header: ImageHeader
    water: WaterEstimate
    visibility: Visibility
    field_of_view: float
    config: NodeConfig

    def message(self, name: str) -> Any:
        """Make the message of an output of `ESTIMATES`; None where it is not assessable."""
        return _BUILDERS[name][1](self)


def field_of_view(width: int, focal_length: float) -> float:
    """Return the field of view, rad, of an image with a width and focal length, px."""
    return 2.0 * math.atan(width / (2.0 * focal_length))


def _distance(estimate: Estimate) -> Any:
    visibility = estimate.visibility
    if visibility.status is not Status.OK or math.isnan(visibility.distance):
        return None
    max_range = estimate.config.max_range
    # Range points along x, which is to the right in an optical frame. The body's frame has the same
    # name without the suffix (REP 103).
    body = estimate.config.distance_frame or _OPTICAL.sub(r"\1", estimate.header.frame_id)
    header = estimate.header._replace(frame_id=body)
    seen = visibility.distance <= max_range
    known = math.isfinite(visibility.distance_stddev)
    return estimate.make(
        "sensor_msgs/msg/Range",
        header=header.message(estimate.make),
        radiation_type=RADIATION_LIGHT,
        field_of_view=estimate.field_of_view,
        min_range=0.0,
        max_range=max_range,
        range=visibility.distance if seen else math.inf,
        # 0 means unknown.
        variance=visibility.distance_stddev**2 if seen and known else 0.0,
    )


def _vector(estimate: Estimate, values: Array) -> Any:
    """Make a vector of R, G, B; NaN for a channel without light."""
    if estimate.water.status is not Status.OK or not np.isfinite(values).any():
        return None
    return _stamped(estimate, values)


def _stamped(estimate: Estimate, values: Iterable[float]) -> Any:
    return vector_message(estimate.make, estimate.header.message(estimate.make), values)


def _mean_attenuation(estimate: Estimate, stamped: bool) -> Any:
    """Make α alone, or stamped with α as x and its standard deviation as y, 0 if unknown."""
    visibility = estimate.visibility
    alpha, stddev = visibility.mean_attenuation, visibility.mean_attenuation_stddev
    if estimate.water.status is not Status.OK or not math.isfinite(alpha):
        return None
    if stamped:
        return _stamped(estimate, (alpha, stddev if math.isfinite(stddev) else 0.0, 0.0))
    return estimate.make("std_msgs/msg/Float64", data=float(alpha))


def _depth(estimate: Estimate) -> Any:
    visibility = estimate.visibility
    numbers = (visibility.depth, visibility.depth_stddev)
    if visibility.depth_status is not Status.OK or not all(map(math.isfinite, numbers)):
        return None
    header = estimate.header._replace(frame_id=estimate.config.depth_frame)
    return depth_message(
        estimate.make, header.message(estimate.make), visibility.depth, visibility.depth_stddev**2)


_BUILDERS: dict[str, tuple[str, Callable[[Estimate], Any]]] = {
    "distance": ("sensor_msgs/msg/Range", _distance),
    "attenuation": (VECTOR, lambda e: _vector(e, e.water.attenuation)),
    "attenuation_stddev": (VECTOR, lambda e: _vector(e, e.water.attenuation_stddev)),
    "ambient_light": (VECTOR, lambda e: _vector(e, e.water.ambient_light)),
    "mean_attenuation": ("std_msgs/msg/Float64", lambda e: _mean_attenuation(e, stamped=False)),
    "mean_attenuation_stamped": (VECTOR, lambda e: _mean_attenuation(e, stamped=True)),
    "depth": ("geometry_msgs/msg/PoseWithCovarianceStamped", _depth),
}

ESTIMATES = MappingProxyType({name: kind for name, (kind, _) in _BUILDERS.items()})
"""Type of message by output."""


def nis_messages(
    make: MessageFactory, comparison: Comparison, frame_id: str
) -> Iterator[tuple[str, Any]]:
    """Make the messages of a comparison of sensor and estimate, by topic of `NIS_TOPICS`."""
    yield NIS, make(NIS_TOPICS[NIS], data=comparison.nis)
    header = ImageHeader.at(comparison.estimate.stamp, frame_id).message(make)
    yield STAMPED_NIS, vector_message(
        make, header, (comparison.nis, comparison.innovation, comparison.variance))
