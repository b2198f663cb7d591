# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pixels of outgoing messages: disparity, depth and point cloud."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import DisparityMap, Image, Mask

# The disparity is published in steps of 1/64 px, far below what matching
# resolves, so that delta_d can state the step.
DISPARITY_STEP = 1.0 / 64.0


def published_disparity(
    disparity: DisparityMap, valid: Mask | None, offset: float, low: float, high: float
) -> DisparityMap:
    """Return a disparity as ``stereo_msgs/DisparityImage`` defines it.

    disparity: (H, W) float32, x_left - x_right, px; NaN where nothing was matched.
    valid: (H, W) bool or None, where the left image shows anything; None where all of it does.
    offset: cx_left - cx_right, px.
    low, high: smallest and largest disparity published, px.
    Returns (H, W) float32, x_left - x_right - offset, rounded to `DISPARITY_STEP`; ``low - 1``
    where nothing was matched, and where what was matched does not lie in front of the camera or
    between the limits.
    """
    step = np.float32(DISPARITY_STEP)
    value = np.rint((disparity - np.float32(offset)) / step) * step
    # A comparison with NaN is false, so what was not matched is not kept.
    kept = (value > 0) & (value >= np.float32(low)) & (value <= np.float32(high))
    if valid is not None:
        kept &= valid
    return np.where(kept, value, np.float32(low) - np.float32(1))


def depth_of(
    published: NDArray[np.float32], low: float, scale: float
) -> NDArray[np.float32]:
    """Z = scale / disparity, m, of a published disparity, NaN below low; scale in px m."""
    depth = np.full_like(published, np.nan)
    np.divide(np.float32(scale), published, out=depth, where=published >= np.float32(low))
    return depth


def cloud_of(
    depth: NDArray[np.float32],
    columns: NDArray[np.float32],
    rows: NDArray[np.float32],
    colours: Image,
) -> NDArray[np.float32]:
    """Return a point for each pixel, (H, W, 4) float32: X, Y, Z, m, and colour.

    `columns` and `rows` are X / Z of each column and Y / Z of each row; `colours` RGB or grey,
    uint8 or uint16. The colour is as PCL packs it: the number 0x00RRGGBB in the memory of a
    float.
    """
    if colours.dtype == np.uint16:
        colours = (colours >> 8).astype(np.uint8)
    rgb = np.broadcast_to(colours.reshape(*depth.shape, -1), (*depth.shape, 3)).astype(np.uint32)
    cloud = np.empty((*depth.shape, 4), np.float32)
    cloud[..., 0] = depth * columns
    cloud[..., 1] = depth * rows[:, np.newaxis]
    cloud[..., 2] = depth
    cloud.view(np.uint32)[..., 3] = rgb[..., 0] << 16 | rgb[..., 1] << 8 | rgb[..., 2]
    return cloud
