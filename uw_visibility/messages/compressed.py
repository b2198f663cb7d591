# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""CompressedImage messages as arrays, for the classes of rclpy and of rosbags alike.

``format`` is that of compressed_image_transport: ``rgb8; jpeg compressed
bgr8`` or ``mono8; png compressed``; older publishers and cameras write
``jpeg`` or ``png`` alone. The encoding of the original image precedes the
semicolon; the last word is the order of channels in which it was compressed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import cv2
import numpy as np

from uw_visibility.errors import InputError, printable
from uw_visibility.images.arrays import Image
from uw_visibility.images.chroma import ChromaImage, mosaic_chroma, subsampled_chroma
from uw_visibility.images.encoded import JPEG, PNG, TruncatedError, decode, read_size
from uw_visibility.images.jpeg import jpeg_chroma
from uw_visibility.messages.images import ENCODINGS, SUBSAMPLED, check_mosaic

T = TypeVar("T")


def read_format(kind: str) -> tuple[str, bool]:
    """Read the format of a CompressedImage, such as ``rgb8; jpeg compressed bgr8``.

    Returns the encoding of the original image, or the codec if the format names nothing else; and
    whether the codec, which expects BGR, was given RGB, as by old publishers.
    """
    original, _, compression = (part.strip() for part in kind.partition(";"))
    return original, "compressed rgb" in compression


def read_compressed(message: Any, name: str = "image") -> tuple[Image, str]:
    """Decompress a CompressedImage, JPEG or PNG; `name` is for error messages.

    Returns `pixels`, (H, W) or (H, W, 3) of uint8 or uint16, grey, or RGB; alpha is dropped and
    Bayer patterns are interpolated; and the `encoding` of the enhanced image: the original's order
    of channels, with the bit depth of the compressed data.
    """
    original, swapped = read_format(str(message.format))
    stored = _decoded(message, name, decode)
    bits = 8 * stored.dtype.itemsize
    if stored.ndim == 2:
        encoding = f"{original.removesuffix('16').removesuffix('8')}{bits}"
        if original.startswith("bayer_") and encoding in ENCODINGS:
            check_mosaic(stored, encoding, name)
            return cv2.cvtColor(stored, ENCODINGS[encoding].to_rgb), ENCODINGS[encoding].output
        return stored, f"mono{bits}"
    order = "rgb" if original.startswith("rgb") else "bgr"
    if swapped:
        return np.ascontiguousarray(stored[..., :3]), f"{order}{bits}"
    conversion = cv2.COLOR_BGR2RGB if stored.shape[2] == 3 else cv2.COLOR_BGRA2RGB
    return cv2.cvtColor(stored, conversion), f"{order}{bits}"


def message_chroma(message: Any, pixels: Image) -> ChromaImage | None:
    """Read the colour of an Image or a CompressedImage at native resolution, with its noise.

    `pixels` are those of the message. None if they are grey, or have their colour in full.
    """
    if pixels.ndim == 2:
        return None
    # The format may be empty: the field alone shows that it is a CompressedImage.
    compressed = hasattr(message, "format")
    original, swapped = read_format(str(getattr(message, "format", "")))
    if compressed and bytes(message.data[: len(JPEG)]) == JPEG:
        chroma = jpeg_chroma(bytes(message.data))
        if chroma is not None:
            return chroma.swapped if swapped else chroma
    encoding = original or str(getattr(message, "encoding", ""))
    if not compressed and encoding in SUBSAMPLED:
        return subsampled_chroma(pixels)
    if encoding.startswith("bayer_"):
        return mosaic_chroma(pixels, encoding.removeprefix("bayer_")[:4])
    return None


def size_of(message: Any, name: str) -> tuple[int, int]:
    """Read width and height, px, of a compressed image, without decompressing it."""
    return _decoded(message, name, read_size)


def _decoded(message: Any, name: str, read: Callable[[bytes], T]) -> T:
    """Apply `read` to the data of a message, which must be a JPEG or a PNG."""
    data, kind = bytes(message.data), printable(message.format)
    if "compressedDepth" in message.format or not data.startswith((JPEG, PNG)):
        raise InputError(
            f"{name} has the format {kind!r} and data that are neither JPEG nor PNG: publish it "
            "with compressed_image_transport as jpeg or png"
        )
    try:
        return read(data)
    except TruncatedError as error:
        # Without the length, which differs in every image: reasons are counted by their text.
        raise InputError(f"{name} has data without an end: it is truncated") from error
    except InputError as error:
        raise InputError(
            f"{name} has the format {kind!r} but cannot be decompressed: {error}") from error
