# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops that write the pixels of outgoing messages, each in one pass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import DisparityMap, Image, Mask

# The disparity is published in steps of 1/64 px, far below what matching
# resolves, so that delta_d can state the step.
DISPARITY_STEP = 1.0 / 64.0

_EVERYWHERE = np.zeros((0, 0), bool)


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
    published = np.empty_like(disparity)
    _publish_disparity(
        disparity, _EVERYWHERE if valid is None else valid,
        np.float32(offset), np.float32(low), np.float32(high), published,
    )
    return published


@njit(nogil=True, error_model="numpy")
def _publish_disparity(
    disparity: Any, valid: Any, offset: np.float32, low: np.float32, high: np.float32,
    published: Any,
) -> None:
    steps, step = np.float32(1.0 / DISPARITY_STEP), np.float32(DISPARITY_STEP)
    missing = low - np.float32(1.0)
    zero = np.float32(0.0)
    height, width = disparity.shape
    for y in range(height):
        for x in range(width):
            value = np.rint((disparity[y, x] - offset) * steps) * step
            # A comparison with NaN is false, so what was not matched is not kept.
            kept = value > zero and value >= low and value <= high
            if valid.size > 0:
                kept = kept and valid[y, x]
            published[y, x] = value if kept else missing


def depth_of(
    published: NDArray[np.float32], low: float, scale: float
) -> NDArray[np.float32]:
    """Z = scale / disparity, m, of a published disparity, NaN below low; scale in px m."""
    depth = np.empty_like(published)
    _fill_depth(published, np.float32(low), np.float32(scale), depth)
    return depth


@njit(nogil=True, error_model="numpy")
def _fill_depth(published: Any, low: np.float32, scale: np.float32, depth: Any) -> None:
    height, width = published.shape
    for y in range(height):
        for x in range(width):
            value = published[y, x]
            depth[y, x] = scale / value if value >= low else np.float32(np.nan)


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
    # Grey as an image of one channel, so that there is one kernel for both.
    colours = np.ascontiguousarray(colours.reshape(*depth.shape, -1))
    cloud = np.empty((*depth.shape, 4), np.float32)
    _fill_cloud(depth, columns, rows, colours, cloud, cloud.view(np.uint32))
    return cloud


@njit(nogil=True, error_model="numpy")
def _fill_cloud(depth: Any, columns: Any, rows: Any, colours: Any, cloud: Any, packed: Any) -> None:
    height, width = depth.shape
    green, blue = (1, 2) if colours.shape[2] > 1 else (0, 0)
    for y in range(height):
        for x in range(width):
            z = depth[y, x]
            cloud[y, x, 0] = z * columns[x]
            cloud[y, x, 1] = z * rows[y]
            cloud[y, x, 2] = z
            packed[y, x, 3] = (
                np.uint32(colours[y, x, 0]) << np.uint32(16)
                | np.uint32(colours[y, x, green]) << np.uint32(8)
                | np.uint32(colours[y, x, blue])
            )


def warm_up() -> None:
    """Load the kernels, or compile them where they are not on disk."""
    pixel = np.ones((1, 1), np.float32)
    disparity = published_disparity(pixel, None, 0.0, 0.0, 2.0)
    cloud_of(depth_of(disparity, 0.0, 1.0), pixel[0], pixel[0], np.ones((1, 1, 3), np.uint8))
