# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images and maps as files: PNG, JPEG and TIFF in, PNG and PFM out."""

from __future__ import annotations

import warnings
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.files import read_regular, write_whole
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Image
from uw_visibility.images.encoded import MOST_BYTES, decode


def read_image(path: str | Path) -> Image:
    """Read a PNG, JPEG, TIFF or binary PNM as it is stored, grey (H, W) or RGB (H, W, 3).

    Depth, uint8 or uint16, and channels are not converted; a transparency channel is dropped.
    Raises `InputError` if the file cannot be read, is not a complete image of `MOST_PIXELS` or
    less, or has neither 8 nor 16 bit per channel.
    """
    content = read_regular(path, MOST_BYTES, "image")
    try:
        image = decode(content)
    except InputError as error:
        raise InputError(
            f"{path} is no image that can be read ({error}): give a complete PNG, JPEG or TIFF file"
        ) from error
    if image.ndim == 3:
        image = image[:, :, 2::-1]
    return np.ascontiguousarray(image)


def is_turned(path: str | Path) -> bool:
    """Return whether a JPEG, by its EXIF, is to be turned or mirrored for viewing.

    `read_image` does not do so: pixels stay where the camera and its calibration have them.
    """
    from PIL import ExifTags, Image

    # Damage of the EXIF is told by warnings.
    with (
        warnings.catch_warnings(action="ignore"), suppress(OSError, SyntaxError, ValueError),
        Image.open(path, formats=["JPEG"]) as image,
    ):
        return image.getexif().get(ExifTags.Base.Orientation) in range(2, 9)
    return False


def write_png(path: str | Path, image: Image) -> None:
    """Write an image, grey (H, W) or RGB (H, W, 3) of uint8 or uint16, as PNG, without loss.

    Raises `InputError` if the file cannot be written.
    """
    stored = image if image.ndim == 2 else image[:, :, ::-1]
    _, content = cv2.imencode(".png", np.ascontiguousarray(stored))
    write_whole(path, content.tobytes())


def write_pfm(path: str | Path, values: NDArray[np.float32]) -> None:
    """Write a map (H, W) as portable float map: little endian, bottom row first.

    Raises `InputError` if the file cannot be written.
    """
    height, width = values.shape
    header = f"Pf\n{width} {height}\n-1.0\n".encode("ascii")
    write_whole(path, header + values[::-1].astype("<f4").tobytes())
