# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Compressed images as compressed_image_transport, old publishers and cameras write them."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility.messages.compressed import message_chroma, read_compressed

# Smooth, so that JPEG keeps it.
Y, X = np.mgrid[:32, :48]
RGB = np.dstack([4 * X, 255 - 4 * X, 6 * Y + 20]).astype(np.uint8)
RGB16 = RGB.astype(np.uint16) * 256
GREY = RGB[..., 0].copy()


def message(kind: str, stored: np.ndarray, codec: str, **changes: bytes) -> SimpleNamespace:
    """Make a message whose data hold the pixels as the codec is given them."""
    fields = {"format": kind, "data": cv2.imencode(codec, stored)[1].tobytes()} | changes
    return SimpleNamespace(**fields)


@pytest.mark.parametrize(("kind", "stored", "codec", "encoding"), [
    ("rgb8; jpeg compressed bgr8", RGB[..., ::-1], ".jpg", "rgb8"),
    ("bgr8; jpeg compressed bgr8", RGB[..., ::-1], ".jpg", "bgr8"),
    ("bgra8; jpeg compressed bgr8", RGB[..., ::-1], ".jpg", "bgr8"),
    ("rgb8; jpeg compressed rgb8", RGB, ".jpg", "rgb8"),
    ("rgb16; jpeg compressed bgr8", RGB[..., ::-1], ".jpg", "rgb8"),
    ("bgr8; png compressed bgr8", RGB[..., ::-1], ".png", "bgr8"),
    ("rgb8; png compressed bgr8", RGB[..., ::-1], ".png", "rgb8"),
    ("rgb16; png compressed bgr16", RGB16[..., ::-1], ".png", "rgb16"),
    ("rgba8; png compressed bgra8", np.dstack([RGB[..., ::-1], GREY]), ".png", "rgb8"),
    ("jpeg", RGB[..., ::-1], ".jpg", "bgr8"),
    ("png", RGB[..., ::-1], ".png", "bgr8"),
    ("mono8; jpeg compressed ", GREY, ".jpg", "mono8"),
    ("mono8; png compressed mono8", GREY, ".png", "mono8"),
    ("mono16; png compressed ", RGB16[..., 0], ".png", "mono16"),
    ("16UC1; png compressed ", RGB16[..., 0], ".png", "mono16"),
    ("jpeg", GREY, ".jpg", "mono8"),
])
def test_formats(kind: str, stored: np.ndarray, codec: str, encoding: str) -> None:
    pixels, found = read_compressed(message(kind, np.ascontiguousarray(stored), codec))
    assert found == encoding
    expected = GREY if stored.ndim == 2 else RGB
    expected = expected.astype(stored.dtype) * (256 if stored.dtype == np.uint16 else 1)
    tolerance = 8 if codec == ".jpg" else 0
    assert pixels.dtype == stored.dtype and pixels.flags.c_contiguous
    np.testing.assert_allclose(pixels.astype(int), expected, atol=tolerance)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_mosaic_in_a_png_is_interpolated(pattern: str, bits: int) -> None:
    colour = {"r": 200, "g": 120, "b": 40}
    tile = np.array([colour[c] for c in pattern], np.uint16).reshape(2, 2)
    mosaic = np.tile(tile, (8, 8)) * (1 if bits == 8 else 256)
    mosaic = mosaic.astype(np.uint8 if bits == 8 else np.uint16)
    kind = f"bayer_{pattern}{bits}; png compressed "
    pixels, encoding = read_compressed(message(kind, mosaic, ".png"))
    assert encoding == f"rgb{bits}"
    expected = np.array([200, 120, 40]) * (1 if bits == 8 else 256)
    np.testing.assert_array_equal(pixels[2:-2, 2:-2], np.broadcast_to(expected, (12, 12, 3)))
    other = "grbg" if pattern[0] != "g" else "rggb"
    with pytest.raises(InputError, match="green pixels are those of"):
        read_compressed(message(kind.replace(pattern, other), mosaic, ".png"))


def test_mosaic_that_its_publisher_interpolated_is_colour() -> None:
    kind = "bayer_rggb8; jpeg compressed bgr8"
    pixels, encoding = read_compressed(message(kind, RGB[..., ::-1].copy(), ".jpg"))
    assert encoding == "bgr8"
    np.testing.assert_allclose(pixels.astype(int), RGB, atol=8)


@pytest.mark.parametrize("codec", [".jpg", ".png"])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_truncated_image_is_refused_not_filled_with_grey(codec: str, share: float) -> None:
    whole = message("jpeg", RGB, codec)
    whole.data = whole.data[: int(share * len(whole.data))]
    with pytest.raises(InputError, match=r"left image .* truncated"):
        read_compressed(whole, "left image")


def test_a_jpeg_without_a_format_tells_its_colour_too() -> None:
    pixels = np.kron(RGB, np.ones((8, 8, 1), np.uint8))
    named, unnamed = (message(kind, pixels, ".jpg") for kind in ("jpeg", ""))
    expected = message_chroma(named, read_compressed(named)[0])
    found = message_chroma(unnamed, read_compressed(unnamed)[0])
    assert expected is not None
    assert found is not None
    np.testing.assert_array_equal(found.pixels, expected.pixels)


def test_reasons_of_unlike_images_are_one() -> None:
    says = set()
    for data in (bytes(10), bytes(20), b"\xff\xd8\xff" + bytes(5), b"\xff\xd8\xff" + bytes(9)):
        with pytest.raises(InputError) as error:
            read_compressed(SimpleNamespace(format="webp", data=data))
        says.add(str(error.value))
    assert len(says) == 2


@pytest.mark.parametrize(("kind", "data", "reason"), [
    ("jpeg", b"", "data that are neither JPEG nor PNG"),
    ("rgb8; tiff compressed bgr8", b"II*\0" + bytes(50), "'rgb8; tiff compressed bgr8'"),
    ("16UC1; compressedDepth png", bytes(12) + b"\x89PNG\r\n\x1a\n", "compressedDepth"),
    ("jpeg", b"\xff\xd8\xff\xda" + bytes(20) + b"\xff\xd9", "damaged"),
])
def test_what_is_no_image_is_refused(kind: str, data: bytes, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        read_compressed(SimpleNamespace(format=kind, data=data), "left image")
