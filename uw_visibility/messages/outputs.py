# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Output messages of a frame's result by topic, the same in node and replay.

Messages under ``visibility/`` are published only if the status of their estimate is ok: they have
no invented values, and NaN only for a channel without light. Images and disparity always appear.

Each estimate appears twice: that of the frame alone under ``visibility/raw/``, and the one
filtered over frames, if they are tracked, under ``visibility/``. Use the raw one in a filter
of your own: errors of the filtered one are correlated over seconds.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import NodeConfig
from uw_visibility.images.overview import shown
from uw_visibility.messages.estimates import (
    ESTIMATES,
    Estimate,
    ImageHeader,
    field_of_view,
    region_message,
)
from uw_visibility.messages.frames import StereoFrame, StereoPair
from uw_visibility.messages.images import MessageFactory, write_image
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.stereo.calibration import matrix_of
from uw_visibility.water.series.filter import FilteredWater

# sensor_msgs/PointField.FLOAT32.
POINT_FLOAT32 = 7
# Step of the published disparity, px, stated as delta_d; far below the
# resolution of matching.
DISPARITY_STEP = 1.0 / 64.0


@dataclass(frozen=True)
class Source:
    """Input, result and message factory for the output messages of a frame."""

    make: MessageFactory
    frame: StereoFrame
    pair: StereoPair
    result: FrameResult
    config: NodeConfig
    filtered: FilteredWater | None = None

    @functools.cached_property
    def headers(self) -> dict[str, Any]:
        """Headers of the images, as messages by side."""
        images = {"left": self.frame.left, "right": self.frame.right}
        return {side: ImageHeader.of(image).message(self.make) for side, image in images.items()}

    @functools.cached_property
    def disparity(self) -> tuple[NDArray[np.float32], float, float]:
        """The matched disparity (H, W) as ``stereo_msgs/DisparityImage`` defines it, low, high; px.

        x_left - x_right - (cx_left - cx_right), so that Z = f t / disparity, in steps of
        `DISPARITY_STEP`. low and high limit the disparities searched in front of infinity.
        Unmatched pixels, and matches that are not positive or outside of this range, are
        ``low - 1``.
        """
        result, rig = self.result, self.pair.rig
        low = max(result.stereo.min_disparity - rig.offset, 0.0)
        high = max(result.stereo.max_disparity - rig.offset, low)
        step = np.float32(DISPARITY_STEP)
        value = np.rint((result.disparity - np.float32(rig.offset)) / step) * step
        # Unmatched pixels are NaN, whose comparisons are false.
        kept = (value > 0) & (value >= np.float32(low)) & (value <= np.float32(high))
        if self.pair.valid is not None:
            kept &= self.pair.valid
        return np.where(kept, value, np.float32(low) - np.float32(1)), low, high

    @functools.cached_property
    def depth(self) -> NDArray[np.float32]:
        """Z of the matched pixels, ``(H, W)`` float32, m; NaN elsewhere."""
        disparity, low, _ = self.disparity
        scale = np.float32(self.pair.rig.focal_length * self.pair.rig.baseline)
        depth = np.full_like(disparity, np.nan)
        np.divide(scale, disparity, out=depth, where=disparity >= np.float32(low))
        return depth


def estimate(name: str, filtered: bool, source: Source) -> Any:
    """Make an output of the frame's estimate, or of the filtered one where frames are tracked."""
    found = source.filtered if filtered and source.filtered is not None else source.result
    view = field_of_view(source.result.disparity.shape[1], source.pair.rig.focal_length)
    header = ImageHeader.of(source.frame.left)
    return Estimate(
        source.make, header, found.water, found.visibility, view, source.config
    ).message(name)


def enhanced_image(side: str, source: Source) -> Any:
    """Make the enhanced image of a side, left or right."""
    pixels = getattr(source.result, f"{side}_enhanced")
    encoding = source.pair.encodings[side == "right"]
    return write_image(source.make, pixels, encoding, source.headers[side])


def camera_info(side: str, source: Source) -> Any:
    """Copy a side's CameraInfo, whose P is valid for the rectified image, as in image_pipeline."""
    info = getattr(source.frame, f"{side}_info")
    roi = info.roi
    return source.make(
        "sensor_msgs/msg/CameraInfo",
        header=source.headers[side],
        height=info.height,
        width=info.width,
        distortion_model=info.distortion_model,
        binning_x=info.binning_x,
        binning_y=info.binning_y,
        roi=region_message(
            source.make, (roi.x_offset, roi.y_offset, roi.width, roi.height), bool(roi.do_rectify)
        ),
        **{name: matrix_of(info, name) for name in "dkrp"},
    )


def disparity(source: Source) -> Any:
    """Make the disparity image of the matched pixels."""
    pixels, low, high = source.disparity
    # Of possible disparities: a match must lie in the right image.
    x, y, width, height = source.pair.valid_window
    start = max(x, source.result.stereo.min_disparity)
    stop = min(x + width, pixels.shape[1] + source.result.stereo.max_disparity)
    window = start, y, max(stop - start, 0), height
    return source.make(
        "stereo_msgs/msg/DisparityImage",
        header=source.headers["left"],
        image=write_image(source.make, pixels, "32FC1", source.headers["left"]),
        f=source.pair.rig.focal_length,
        t=source.pair.rig.baseline,
        valid_window=region_message(source.make, window),
        min_disparity=low,
        max_disparity=high,
        delta_d=DISPARITY_STEP,
    )


def points(source: Source) -> Any:
    """Make the cloud of the matched pixels: one point per pixel, NaN where none was matched."""
    rig, depth = source.pair.rig, source.depth
    height, width = depth.shape
    cx, cy = rig.principal_point
    columns = (np.arange(width) - cx) / rig.focal_length
    rows = (np.arange(height) - cy) / (rig.focal_length_y or rig.focal_length)
    rgb = shown(source.result.left_enhanced).astype(np.uint32)
    cloud = np.empty((height, width, 4), np.float32)
    cloud[..., 0] = depth * columns.astype(np.float32)
    cloud[..., 1] = depth * rows.astype(np.float32)[:, np.newaxis]
    cloud[..., 2] = depth
    # PCL's packing: 0x00RRGGBB in the bits of a float.
    cloud.view(np.uint32)[..., 3] = rgb[..., 0] << 16 | rgb[..., 1] << 8 | rgb[..., 2]
    fields = [
        source.make(
            "sensor_msgs/msg/PointField", name=name, offset=4 * index, datatype=POINT_FLOAT32,
            count=1,
        )
        for index, name in enumerate(("x", "y", "z", "rgb"))
    ]
    return source.make(
        "sensor_msgs/msg/PointCloud2",
        header=source.headers["left"],
        height=height,
        width=width,
        fields=fields,
        is_bigendian=sys.byteorder == "big",
        point_step=16,
        row_step=16 * width,
        data=cloud.reshape(-1).view(np.uint8),
        is_dense=False,
    )


FILTERED, RAW = "visibility", "visibility/raw"
"""Namespaces of the estimates that are filtered over frames, and of those of single frames."""


class Output(NamedTuple):
    """Type of an output's messages, their factory, and the parameter that enables them, if any."""

    kind: str
    make: Callable[[Source], Any]
    switch: str = ""


_OUTPUTS = {
    # Estimates, which a vehicle acts on, are published before large messages.
    **{
        f"{folder}/{name}": Output(kind, partial(estimate, name, folder == FILTERED))
        for folder in (FILTERED, RAW) for name, kind in ESTIMATES.items()
    },
    "disparity": Output("stereo_msgs/msg/DisparityImage", disparity),
    "left/enhanced/image": Output("sensor_msgs/msg/Image", partial(enhanced_image, "left")),
    "left/enhanced/camera_info": Output(
        "sensor_msgs/msg/CameraInfo", partial(camera_info, "left")),
    "right/enhanced/image": Output("sensor_msgs/msg/Image", partial(enhanced_image, "right")),
    "right/enhanced/camera_info": Output(
        "sensor_msgs/msg/CameraInfo", partial(camera_info, "right")),
    # REP 118: Z in m, NaN where nothing was matched.
    "depth/image": Output("sensor_msgs/msg/Image", lambda source: write_image(
        source.make, source.depth, "32FC1", source.headers["left"]), "publish_depth_image"),
    # The depth image has the geometry of the left rectified image.
    "depth/camera_info": Output(
        "sensor_msgs/msg/CameraInfo", partial(camera_info, "left"), "publish_depth_image"),
    "points2": Output("sensor_msgs/msg/PointCloud2", points, "publish_points"),
}
"""Outputs by topic, in the order in which they are published."""


def each_message(source: Source, topics: Collection[str]) -> Iterator[tuple[str, Any]]:
    """Generate the messages of one frame by topic, so that each can be published at once.

    In the order of `topics`, without those whose value is not assessable.
    """
    for topic in topics:
        message = _OUTPUTS[topic].make(source)
        if message is not None:
            yield topic, message


def all_topics(config: NodeConfig) -> dict[str, str]:
    """Return type of message by topic, with the optional ones that are enabled."""
    return {
        topic: output.kind for topic, output in _OUTPUTS.items()
        if not output.switch or getattr(config, output.switch)
    }


def enhanced_sides(topics: Collection[str]) -> tuple[str, ...]:
    """Return the sides whose enhanced image is needed for topics."""
    left = "left/enhanced/image" in topics or "points2" in topics
    right = "right/enhanced/image" in topics
    return ("left",) * left + ("right",) * right
