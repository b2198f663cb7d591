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
from uw_visibility.messages.estimates import Estimate, ImageHeader, field_of_view, region_message
from uw_visibility.messages.frames import StereoFrame, StereoPair
from uw_visibility.messages.images import MessageFactory, write_image
from uw_visibility.messages.output_kernels import (
    DISPARITY_STEP,
    cloud_of,
    depth_of,
    published_disparity,
)
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
    def left_header(self) -> Any:
        """Stamp and frame of the left image."""
        return self._header(self.frame.left)

    @functools.cached_property
    def right_header(self) -> Any:
        """Stamp and frame of the right image."""
        return self._header(self.frame.right)

    @functools.cached_property
    def left_info(self) -> Any:
        """Calibration of the left image, as a message."""
        return _camera_info(self, self.frame.left_info, self.left_header)

    @functools.cached_property
    def disparity(self) -> tuple[NDArray[np.float32], float, float]:
        """What `corrected_disparity` returns."""
        return corrected_disparity(self)

    @functools.cached_property
    def depth(self) -> NDArray[np.float32]:
        """Z of the matched pixels, ``(H, W)`` float32, m; NaN elsewhere."""
        disparity, low, _ = self.disparity
        return depth_of(disparity, low, self.pair.rig.focal_length * self.pair.rig.baseline)

    def _header(self, message: Any) -> Any:
        return ImageHeader.of(message).message(self.make)


def left_image(source: Source) -> Any:
    """Make the enhanced left image."""
    pixels = source.result.left_enhanced
    return write_image(source.make, pixels, source.pair.encodings[0], source.left_header)


def right_image(source: Source) -> Any:
    """Make the enhanced right image."""
    pixels = source.result.right_enhanced
    return write_image(source.make, pixels, source.pair.encodings[1], source.right_header)


def left_info(source: Source) -> Any:
    """Pass the left calibration on."""
    return source.left_info


def right_info(source: Source) -> Any:
    """Pass the right calibration on."""
    return _camera_info(source, source.frame.right_info, source.right_header)


def _camera_info(source: Source, info: Any, header: Any) -> Any:
    """Pass the calibration on: P holds for the rectified image, as image_pipeline has it."""
    roi = info.roi
    return source.make(
        "sensor_msgs/msg/CameraInfo",
        header=header,
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
        header=source.left_header,
        image=write_image(source.make, pixels, "32FC1", source.left_header),
        f=source.pair.rig.focal_length,
        t=source.pair.rig.baseline,
        valid_window=region_message(source.make, _valid_window(source)),
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
    low = max(result.stereo.min_disparity - rig.offset, 0.0)
    high = max(result.stereo.max_disparity - rig.offset, low)
    pixels = published_disparity(result.disparity, source.pair.valid, rig.offset, low, high)
    return pixels, low, high


def depth_info(source: Source) -> Any:
    """Pass the calibration of the depth image on: it lies in the left rectified image."""
    return left_info(source)


def depth_image(source: Source) -> Any:
    """Make the depth image (REP 118): Z in m, NaN where nothing was matched."""
    return write_image(source.make, source.depth, "32FC1", source.left_header)


def points(source: Source) -> Any:
    """Make the cloud of the matched pixels: one point per pixel, NaN where none was matched."""
    rig, depth = source.pair.rig, source.depth
    height, width = depth.shape
    cx, cy = rig.principal_point
    columns = (np.arange(width) - cx) / rig.focal_length
    rows = (np.arange(height) - cy) / (rig.focal_length_y or rig.focal_length)
    cloud = cloud_of(
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
        header=source.left_header,
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
