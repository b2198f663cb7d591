# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of stereo pairs: types, sizes and exposure."""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Image, Mask
from uw_visibility.status import Status

# Smallest image that has room for a support grid, its neighbourhood and a few pixels of disparity.
MIN_WIDTH = 96
MIN_HEIGHT = 64
# An image whose brightest pixels are below this shows only noise.
_DARK = 4.0 / 255.0
# Share of pixels at the largest code value beyond which an image is saturated.
_SATURATED_PART = 0.8
# Range of code values below which an image is uniform, but for quantisation.
_FLAT = 2.0 / 255.0


def check_pair(left: Any, right: Any) -> tuple[Image, Image]:
    """Check the types and sizes of a pair of images; return them contiguous and read-only.

    RGB (H, W, 3) or grey (H, W); uint8 or uint16.
    """
    one, other = check_image("left image", left), check_image("right image", right)
    if one.shape != other.shape or one.dtype != other.dtype:
        raise InputError(
            f"left image is {_form(one)} and right image is {_form(other)}: give a pair of one "
            "size and type")
    return one, other


def check_image(what: str, image: Any) -> Image:
    """Check the type and size of one image; see `check_pair`."""
    array = np.asarray(image)
    if array.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{what} has type {array.dtype}: give uint8 or uint16")
    if array.ndim != 2 and not (array.ndim == 3 and array.shape[2] == 3):
        raise InputError(
            f"{what} has shape {array.shape}: give (height, width, 3) RGB or (height, width) grey")
    height, width = array.shape[:2]
    if width < MIN_WIDTH or height < MIN_HEIGHT:
        raise InputError(
            f"{what} is {width}x{height} px: give at least {MIN_WIDTH}x{MIN_HEIGHT} px")
    return read_only(np.ascontiguousarray(array))


def check_valid(valid: Any, shape: tuple[int, ...]) -> Mask | None:
    """Check the mask of an image's valid pixels (H, W), since kernels do not check its size."""
    if valid is None:
        return None
    try:
        mask = np.asarray(valid)
    except ValueError:  # rows of several lengths
        mask = np.array(None)
    if mask.dtype != bool or mask.shape != shape[:2]:
        raise InputError(
            f"the valid pixels are {mask.dtype} of shape {mask.shape}, the images are "
            f"{shape[1]}x{shape[0]} px: give one bool per pixel"
        )
    return mask


def read_only(image: Image) -> Image:
    """Return a read-only view.

    Kernels are compiled separately for writable and for read-only arrays, such as views of
    messages. With this all are read-only.
    """
    view = image.view()
    view.flags.writeable = False
    return view


def exposure_status(image: Image) -> Status:
    """Exposure status: `TOO_DARK`, `SATURATED`, `NO_TEXTURE`, or `OK`."""
    largest = float(np.iinfo(image.dtype).max)
    # Every fourth pixel of every fourth row is a sufficient sample.
    sample = image[::4, ::4].reshape(-1, 1 if image.ndim == 2 else 3)
    bright, dark = np.percentile(sample, (99.5, 0.5), axis=0) / largest
    if bright.max() < _DARK:
        return Status.TOO_DARK
    if np.mean(sample.max(axis=1) >= largest) > _SATURATED_PART:
        return Status.SATURATED
    if np.max(bright - dark) < _FLAT:
        return Status.NO_TEXTURE
    return Status.OK


def _form(image: Image) -> str:
    kind = "grey" if image.ndim == 2 else "RGB"
    return f"{image.shape[1]}x{image.shape[0]} px {kind} {image.dtype}"
