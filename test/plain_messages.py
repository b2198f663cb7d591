# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Messages as plain objects, with the fields of ROS 2, and mosaics of pixels."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0), frame_id="camera")


def make(name: str, /, **fields: Any) -> SimpleNamespace:
    """Make a message of a type from its fields."""
    return SimpleNamespace(name=name, **fields)


def image_message(pixels: np.ndarray, encoding: str = "mono8", **changes: Any) -> SimpleNamespace:
    """Make an Image of an array in the encoding's own layout."""
    pixels = np.ascontiguousarray(pixels)
    fields = {
        "header": HEADER, "height": pixels.shape[0], "width": pixels.shape[1],
        "encoding": encoding, "is_bigendian": 0, "step": pixels.strides[0],
        "data": pixels.tobytes(),
    }
    return SimpleNamespace(**(fields | changes))


def region(x: int = 0, y: int = 0, width: int = 0, height: int = 0) -> SimpleNamespace:
    """Make a RegionOfInterest; by default the whole image."""
    return SimpleNamespace(x_offset=x, y_offset=y, width=width, height=height, do_rectify=False)


def camera_info(
    size: tuple[int, int], focal: float, centre: tuple[float, float], tx: float = 0.0,
    **changes: Any,
) -> SimpleNamespace:
    """Make the CameraInfo of rectified images, with tx in the fourth column of P."""
    cx, cy = centre
    fields = {
        "header": HEADER, "width": size[0], "height": size[1], "distortion_model": "plumb_bob",
        "k": [focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0], "d": [0.0] * 5,
        "r": list(np.eye(3).ravel()),
        "p": [focal, 0.0, cx, tx, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        "binning_x": 0, "binning_y": 0, "roi": region(),
    }
    return SimpleNamespace(**(fields | changes))


def mosaic(pixels: np.ndarray, pattern: str) -> np.ndarray:
    """Keep one colour of each RGB pixel, by a pattern such as rggb."""
    plane = np.empty(pixels.shape[:2], pixels.dtype)
    for k, name in enumerate(pattern):
        place = np.s_[k // 2::2, k % 2::2]
        plane[place] = pixels[..., "rgb".index(name)][place]
    return plane
