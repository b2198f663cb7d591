# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image messages as arrays and back, for the classes of rclpy and of rosbags alike."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, TypeAlias

import cv2
import numpy as np

from uw_visibility.errors import InputError, printable
from uw_visibility.images.arrays import DisparityMap, Image
from uw_visibility.images.noise import ROUNDING_VARIANCE


class Encoding(NamedTuple):
    """Pixel layout of an encoding, and the encoding of its enhanced image.

    The enhanced image has the input's order of channels and bit depth, without alpha; Bayer and YUV
    images become RGB.
    """

    dtype: type[np.unsignedinteger[Any]]
    channels: int
    to_rgb: int | None  # cv2 conversion to RGB; None where the pixels are grey or RGB already
    output: str


ENCODINGS: dict[str, Encoding] = {
    "mono8": Encoding(np.uint8, 1, None, "mono8"),
    "mono16": Encoding(np.uint16, 1, None, "mono16"),
    "rgb8": Encoding(np.uint8, 3, None, "rgb8"),
    "bgr8": Encoding(np.uint8, 3, cv2.COLOR_BGR2RGB, "bgr8"),
    "rgba8": Encoding(np.uint8, 4, cv2.COLOR_RGBA2RGB, "rgb8"),
    "bgra8": Encoding(np.uint8, 4, cv2.COLOR_BGRA2RGB, "bgr8"),
    "rgb16": Encoding(np.uint16, 3, None, "rgb16"),
    "bgr16": Encoding(np.uint16, 3, cv2.COLOR_BGR2RGB, "bgr16"),
    # OpenCV's encodings without names of channels; three channels are BGR.
    "8UC1": Encoding(np.uint8, 1, None, "mono8"),
    "8UC3": Encoding(np.uint8, 3, cv2.COLOR_BGR2RGB, "bgr8"),
    # ITU-R BT.601 with luma from 16 to 235, as USB cameras send it.
    "uyvy": Encoding(np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY, "rgb8"),
    "yuyv": Encoding(np.uint8, 2, cv2.COLOR_YUV2RGB_YUY2, "rgb8"),
    # The same two by their older names.
    "yuv422": Encoding(np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY, "rgb8"),
    "yuv422_yuy2": Encoding(np.uint8, 2, cv2.COLOR_YUV2RGB_YUY2, "rgb8"),
} | {
    # Named by the pixels of the first two rows.
    f"bayer_{pattern}{bits}": Encoding(
        dtype, 1, getattr(cv2, f"COLOR_Bayer{pattern.upper()}2RGB"), f"rgb{bits}")
    for pattern in ("rggb", "bggr", "gbrg", "grbg")
    for bits, dtype in ((8, np.uint8), (16, np.uint16))
}
# Encodings in which two pixels side by side share their chroma.
SUBSAMPLED = ("uyvy", "yuyv", "yuv422", "yuv422_yuy2")


MessageFactory: TypeAlias = Callable[..., Any]
"""Makes a message of a type from all its fields; sequences of numbers are numpy arrays."""


def stamp_to_nanoseconds(stamp: Any) -> int:
    """Return a message's time as nanoseconds since its clock's origin."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def image_view(message: Any, name: str = "image") -> Image:
    """View the pixels of an Image message, without a copy; `name` is for error messages.

    Returns (H, W) or (H, W, C), uint8 or uint16 of the message's byte order, channels
    in the order of the encoding; Bayer images have one, those of YUV 4:2:2 two.
    """
    encoding = _encoding(message, name)
    width, height, step = int(message.width), int(message.height), int(message.step)
    order: Literal[">", "<"] = ">" if message.is_bigendian else "<"
    dtype = np.dtype(encoding.dtype).newbyteorder(order)
    row_bytes = width * encoding.channels * dtype.itemsize
    if width < 1 or height < 1:
        raise InputError(f"{name} has {width}x{height} pixels: publish an image that is not empty")
    if step < row_bytes:
        raise InputError(
            f"{name} has step {step}, but a row of {width} pixels of {message.encoding} takes "
            f"{row_bytes} bytes: set step to the length of a row"
        )
    if message.encoding in SUBSAMPLED and width % 2:
        raise InputError(
            f"{name} is {width} pixels wide, but {message.encoding} holds pairs of pixels: publish "
            "an even width"
        )
    needed = step * (height - 1) + row_bytes
    data = np.frombuffer(message.data, np.uint8)
    if data.size < needed:
        raise InputError(
            f"{name} has {data.size} bytes of data where {width}x{height} pixels of "
            f"{message.encoding} need {needed}: the message is truncated"
        )
    shape: tuple[int, ...] = (height, width)
    strides: tuple[int, ...] = (step, encoding.channels * dtype.itemsize)
    if encoding.channels > 1:
        shape += (encoding.channels,)
        strides += (dtype.itemsize,)
    return np.ndarray(shape, dtype, buffer=data, strides=strides)


def read_image(message: Any, name: str = "image") -> Image:
    """Read an Image message as the package's arrays; `name` is for error messages.

    Returns (H, W) or (H, W, 3), uint8 or uint16, grey or RGB; alpha is dropped, Bayer patterns and
    subsampled colour are interpolated. May share the message's memory.
    """
    view = image_view(message, name)
    native = np.ascontiguousarray(view, view.dtype.newbyteorder("="))
    conversion = _encoding(message, name).to_rgb
    check_mosaic(native, message.encoding, name)
    return native if conversion is None else cv2.cvtColor(native, conversion)


def check_mosaic(mosaic: Image, encoding: str, name: str) -> None:
    """Refuse a Bayer image whose green pixels are where its encoding has red and blue.

    A driver that flips the image, or crops it at an odd pixel, may still state the sensor's order.
    Both greens of a cell have one filter and differ less than red and blue do, in real images under
    water 0.04 to 0.8 times as much. They are in the wrong place if they differ twice as much, also
    relative to their brightness: where red and blue are lost, green has more noise than both.
    """
    if not encoding.startswith("bayer_"):
        return
    # Every other row of cells is enough.
    height, width = mosaic.shape[0] // 2 * 2, mosaic.shape[1] // 2 * 2
    upper, lower = (mosaic[row:height:4, :width].astype(np.float32) for row in (0, 1))
    # What is lost may have one code, whose rounding is not seen.
    falling, rising = (
        (np.square(a - b).sum() + 2.0 * ROUNDING_VARIANCE * a.size, np.square(a + b).sum())
        for a, b in ((upper[:, ::2], lower[:, 1::2]), (upper[:, 1::2], lower[:, ::2])))
    green_first = encoding[6] == "g"
    (greens, bright), (others, dark) = (falling, rising) if green_first else (rising, falling)
    if greens > 4.0 * others and greens * dark > 4.0 * others * bright:
        likely = " or ".join(
            other for other in ENCODINGS
            if other.startswith("bayer_") and (other[6] == "g") is not green_first
            and other[10:] == encoding[10:])
        raise InputError(
            f"{name} has the encoding {encoding}, but its green pixels are those of {likely}: "
            "publish the order of its first two rows")


def read_disparity(message: Any) -> DisparityMap:
    """Return the disparity of a DisparityImage, px, (H, W); NaN where there is none."""
    image = message.image
    values = np.frombuffer(image.data, np.float32).reshape(image.height, image.width)
    return np.where(values >= np.float32(message.min_disparity), values, np.float32(np.nan))


def write_image(make: MessageFactory, pixels: Image, encoding: str, header: Any) -> Any:
    """Make an Image message of grey or RGB pixels, or of float32 for ``32FC1``.

    `encoding` is that of the message; RGB is converted for ``bgr8`` and ``bgr16``.
    """
    if encoding.startswith("bgr"):
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    pixels = np.ascontiguousarray(pixels)
    return make(
        "sensor_msgs/msg/Image",
        header=header,
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(sys.byteorder == "big"),
        step=pixels.strides[0],
        data=pixels.reshape(-1).view(np.uint8),
    )


def _encoding(message: Any, name: str) -> Encoding:
    encoding = ENCODINGS.get(message.encoding)
    if encoding is None:
        raise InputError(
            f"{name} has the encoding {printable(message.encoding)!r}: "
            f"publish one of {', '.join(ENCODINGS)}"
        )
    return encoding
