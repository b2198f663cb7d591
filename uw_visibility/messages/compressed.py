# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""CompressedImage messages as arrays, for the classes of rclpy and of rosbags alike.

``format`` is read as compressed_image_transport writes it: ``rgb8; jpeg
compressed bgr8``, ``mono8; png compressed``, or of older publishers and of
cameras ``jpeg`` or ``png`` alone. Before the semicolon stands the encoding of
the image that was compressed, last the order of channels that it was
compressed in.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.messages.chroma import JPEG, read_format
from uw_visibility.messages.images import ENCODINGS

PNG = b"\x89PNG\r\n\x1a\n"
JPEG_SCAN, JPEG_END, PNG_END = b"\xff\xda", b"\xff\xd9", b"IEND\xae\x42\x60\x82"


def read_compressed(message: Any, name: str = "image") -> tuple[NDArray[Any], str]:
    """Decompress an image.

    Parameters
    ----------
    message : object
        A ``sensor_msgs/CompressedImage`` of rclpy or rosbags, JPEG or PNG.
    name : str
        What errors call the image.

    Returns
    -------
    pixels : ndarray, (H, W) or (H, W, 3), uint8 or uint16
        Grey, or RGB; alpha is dropped and Bayer patterns are interpolated.
    encoding : str
        How the enhanced image is to be encoded: in the order of the image that
        was compressed, with the depth of what was stored.

    Raises
    ------
    InputError
        If the format is another one, or the data are damaged.
    """
    original, swapped = read_format(str(message.format))
    data = np.frombuffer(message.data, np.uint8)
    _check_complete(data.tobytes(), message.format, name)
    stored = _decode(data)
    if stored is None or stored.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{name} has the format {message.format!r} but cannot be decompressed: "
            "the message is damaged"
        )
    bits = 8 * stored.dtype.itemsize
    if stored.ndim == 2:
        encoding = f"{original.removesuffix('16').removesuffix('8')}{bits}"
        if original.startswith("bayer_") and encoding in ENCODINGS:
            return cv2.cvtColor(stored, ENCODINGS[encoding].to_rgb), ENCODINGS[encoding].output
        return stored, f"mono{bits}"
    order = "rgb" if original.startswith("rgb") else "bgr"
    if swapped:
        return np.ascontiguousarray(stored[..., :3]), f"{order}{bits}"
    conversion = cv2.COLOR_BGR2RGB if stored.shape[2] == 3 else cv2.COLOR_BGRA2RGB
    return cv2.cvtColor(stored, conversion), f"{order}{bits}"


def _check_complete(data: bytes, kind: str, name: str) -> None:
    """Refuse what is neither a whole JPEG nor a whole PNG: decoders fill the rest with grey."""
    if "compressedDepth" in kind or not data.startswith((JPEG, PNG)):
        raise InputError(
            f"{name} has the format {kind!r} and {len(data)} bytes that are neither JPEG nor PNG: "
            "publish it with compressed_image_transport as jpeg or png"
        )
    # Drivers pad the end, so it is looked for.
    complete = (
        data.rfind(JPEG_END) > data.rfind(JPEG_SCAN) >= 0
        if data.startswith(JPEG) else data.rfind(PNG_END) > 0
    )
    if not complete:
        raise InputError(f"{name} has {len(data)} bytes of data without an end: it is truncated")


def _decode(data: NDArray[np.uint8]) -> NDArray[Any] | None:
    try:
        image: NDArray[Any] | None = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        # Raised for sizes beyond reason only; what is damaged otherwise is None.
        return None
    return image
