# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the form of an image message or file tells of its colour."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from uw_visibility.config.files import read_regular
from uw_visibility.images.chroma import Colour, mosaic_colour
from uw_visibility.images.encoded import JPEG, MOST_BYTES


def read_format(kind: str) -> tuple[str, bool]:
    """Read the format of a ``sensor_msgs/CompressedImage``.

    Parameters
    ----------
    kind : str
        Such as ``rgb8; jpeg compressed bgr8``.

    Returns
    -------
    original : str
        Encoding of the image that was compressed, or the codec where that is all.
    swapped : bool
        Whether the codec, which takes its input for BGR, was handed RGB, as by old
        publishers.
    """
    original, _, compression = (part.strip() for part in kind.partition(";"))
    return original, "compressed rgb" in compression


def message_colour(message: Any, pixels: NDArray[Any]) -> Colour | None:
    """Tell what is known of an image's colour beside its pixels.

    Parameters
    ----------
    message : object
        A ``sensor_msgs/Image`` or ``CompressedImage`` of rclpy or rosbags.
    pixels : ndarray
        What was read of it.

    Returns
    -------
    Colour or None
        None where the pixels say all that there is.
    """
    if pixels.ndim == 2:
        return None
    kind = str(getattr(message, "format", ""))
    original, swapped = read_format(kind)
    if kind:
        colour = _jpeg_colour(memoryview(message.data))
        if colour is not None:
            return colour.swapped if swapped else colour
    encoding = original or str(getattr(message, "encoding", ""))
    if encoding.startswith("bayer_"):
        return mosaic_colour(pixels, encoding.removeprefix("bayer_")[:4])
    return None


def file_colour(path: str | Path, pixels: NDArray[Any]) -> Colour | None:
    """Tell what is known of the colour of a file that pixels were read from; see above."""
    if pixels.ndim == 2:
        return None
    return _jpeg_colour(memoryview(read_regular(path, MOST_BYTES, "image")))


def _jpeg_colour(data: memoryview) -> Colour | None:
    if bytes(data[: len(JPEG)]) != JPEG:
        return None
    # Imported here, since images without loss need none of it.
    from uw_visibility.images.jpeg import jpeg_colour

    return jpeg_colour(bytes(data))
