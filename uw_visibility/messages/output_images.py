# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image messages of a frame's result: enhanced, disparity, depth and points."""

from __future__ import annotations

import functools
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import NodeConfig
from uw_visibility.messages import output_kernels as kernels
from uw_visibility.messages.estimates import Estimate, ImageHeader, field_of_view, region_message
from uw_visibility.messages.frames import StereoFrame, StereoPair
from uw_visibility.messages.images import MessageFactory, write_image
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.stereo.calibration import matrix_of
from uw_visibility.water.filter import FilteredWater

# sensor_msgs/PointField.FLOAT32.
POINT_FLOAT32 = 7


@dataclass(frozen=True)
class Source:
    """Input, result and message factory that output messages are made from."""

    make: MessageFactory
    frame: StereoFrame
    pair: StereoPair
    result: FrameResult
    config: NodeConfig
    filtered: FilteredWater | None = None

    def estimate(self, filtered: bool) -> Estimate:
        """Return the estimate of the frame alone, or the filtered one where frames are tracked."""
        alone = self.result
        found = self.filtered if filtered and self.filtered is not None else alone
        view = field_of_view(alone.disparity.shape[1], self.pair.rig.focal_length)
        return Estimate(
            self.make, ImageHeader.of(self.frame.left), found.water, found.visibility, view,
            self.config,
        )

    @functools.cached_property
    def headers(self) -> dict[str, Any]:
        """Stamp and frame of the images, as messages by side."""
        images = {"left": self.frame.left, "right": self.frame.right}
        return {side: ImageHeader.of(image).message(self.make) for side, image in images.items()}

    @functools.cached_property
    def disparity(self) -> tuple[NDArray[np.float32], float, float]:
        """The matched disparity as ``stereo_msgs/DisparityImage`` defines it.

        x_left - x_right - (cx_left - cx_right), ``(H, W)`` float32, px, so that Z = f t /
        disparity, and ``low - 1`` where nothing was matched; low and high, the range of
        disparities searched, without what lies behind infinity.
        """
        result, rig = self.result, self.pair.rig
        low = max(result.stereo.min_disparity - rig.offset, 0.0)
        high = max(result.stereo.max_disparity - rig.offset, low)
        pixels = kernels.published_disparity(
            result.disparity, self.pair.valid, rig.offset, low, high)
        return pixels, low, high

    @functools.cached_property
    def depth(self) -> NDArray[np.float32]:
        """Z of the matched pixels, ``(H, W)`` float32, m; NaN elsewhere."""
        disparity, low, _ = self.disparity
        return kernels.depth_of(disparity, low, self.pair.rig.focal_length * self.pair.rig.baseline)


def enhanced_image(side: str, source: Source) -> Any:
    """Make the enhanced image of a side, left or right."""
    pixels = getattr(source.result, f"{side}_enhanced")
    encoding = source.pair.encodings[side == "right"]
    return write_image(source.make, pixels, encoding, source.headers[side])


def camera_info(side: str, source: Source) -> Any:
    """Pass a side's calibration on: P holds for the rectified image, as image_pipeline has it."""
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
    return source.make(
        "stereo_msgs/msg/DisparityImage",
        header=source.headers["left"],
        image=write_image(source.make, pixels, "32FC1", source.headers["left"]),
        f=source.pair.rig.focal_length,
        t=source.pair.rig.baseline,
        valid_window=region_message(source.make, _valid_window(source)),
        min_disparity=low,
        max_disparity=high,
        delta_d=kernels.DISPARITY_STEP,
    )


def depth_image(source: Source) -> Any:
    """Make the depth image (REP 118): Z in m, NaN where nothing was matched."""
    return write_image(source.make, source.depth, "32FC1", source.headers["left"])


def points(source: Source) -> Any:
    """Make the cloud of the matched pixels: one point per pixel, NaN where none was matched."""
    rig, depth = source.pair.rig, source.depth
    height, width = depth.shape
    cx, cy = rig.principal_point
    columns = (np.arange(width) - cx) / rig.focal_length
    rows = (np.arange(height) - cy) / (rig.focal_length_y or rig.focal_length)
    cloud = kernels.cloud_of(
        depth, columns.astype(np.float32), rows.astype(np.float32), source.result.left_enhanced
    )
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


def _valid_window(source: Source) -> tuple[int, int, int, int]:
    """Return the window that may hold disparities: the partner must lie in the right image."""
    x, y, width, height = source.pair.valid_window
    image_width = source.result.disparity.shape[1]
    start = max(x, source.result.stereo.min_disparity)
    stop = min(x + width, image_width + source.result.stereo.max_disparity)
    return start, y, max(stop - start, 0), height
