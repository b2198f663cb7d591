# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pixels of image messages: encodings, byte order, padded rows, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plain_messages import image_message as image
from plain_messages import make

from uw_visibility.errors import InputError
from uw_visibility.messages.images import (
    ENCODINGS,
    SUBSAMPLED,
    image_view,
    read_image,
    write_image,
)

RGB = np.random.default_rng(3).integers(0, 65536, (6, 5, 3), np.uint16)


def stored(encoding: str) -> tuple[np.ndarray, np.ndarray]:
    """Return an array as it is stored in an encoding, and as it must be read."""
    rgb = RGB if encoding.endswith("16") else (RGB >> 8).astype(np.uint8)
    alpha = np.full((6, 5, 1), 9, rgb.dtype)
    layouts = {
        "mono": (rgb[..., 1], rgb[..., 1]),
        "rgba": (np.dstack([rgb, alpha]), rgb),
        "bgra": (np.dstack([rgb[..., ::-1], alpha]), rgb),
        "rgb": (rgb, rgb),
        "bgr": (rgb[..., ::-1], rgb),
        "8UC1": (rgb[..., 1], rgb[..., 1]),
        "8UC3": (rgb[..., ::-1], rgb),
    }
    return layouts[encoding if encoding in layouts else encoding.rstrip("0168")]


@pytest.mark.parametrize("encoding", [
    name for name in ENCODINGS if "bayer" not in name and name not in SUBSAMPLED
])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("padding", [0, 3])
def test_every_layout_of_the_same_pixels_reads_the_same(
    encoding: str, order: str, padding: int
) -> None:
    pixels, expected = stored(encoding)
    rows = pixels.astype(pixels.dtype.newbyteorder(order)).view(np.uint8).reshape(6, -1)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    message = image(
        pixels, encoding, is_bigendian=int(order == ">"), step=padded.shape[1],
        data=padded.tobytes(),
    )
    result = read_image(message)
    assert result.dtype == expected.dtype.newbyteorder("=")
    np.testing.assert_array_equal(result, expected)


@pytest.mark.parametrize(("encoding", "quad"), [
    ("uyvy", "u0v1"), ("yuv422", "u0v1"), ("yuyv", "0u1v"), ("yuv422_yuy2", "0u1v"),
])
def test_subsampled_colour_is_that_of_bt_601(encoding: str, quad: str) -> None:
    # Pure red; white and black have luma 235 and 16.
    for values, colour in (
        ({"0": 81, "1": 81, "u": 90, "v": 240}, (255, 0, 0)),
        ({"0": 235, "1": 235, "u": 128, "v": 128}, (255, 255, 255)),
        ({"0": 16, "1": 16, "u": 128, "v": 128}, (0, 0, 0)),
    ):
        row = np.array([values[name] for name in quad], np.uint8).reshape(1, 2, 2)
        pixels = read_image(image(np.tile(row, (4, 3, 1)), encoding))
        assert pixels.shape == (4, 6, 3)
        assert np.abs(pixels.astype(int) - colour).max() <= 1
    with pytest.raises(InputError, match="5 pixels wide, but"):
        image_view(image(np.zeros((4, 5, 2), np.uint8), encoding))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_keep_the_colour(pattern: str, bits: int) -> None:
    colour = {"r": 200, "g": 120, "b": 40}
    tile = np.array([colour[c] for c in pattern], np.uint16).reshape(2, 2)
    mosaic = np.tile(tile, (4, 4)) * (1 if bits == 8 else 256)
    message = image(mosaic.astype(np.uint8 if bits == 8 else np.uint16), f"bayer_{pattern}{bits}")
    expected = np.array([200, 120, 40]) * (1 if bits == 8 else 256)
    np.testing.assert_array_equal(read_image(message)[2:-2, 2:-2], np.tile(expected, (4, 4, 1)))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_bayer_pattern_with_green_elsewhere_is_refused(pattern: str, bits: int) -> None:
    """As of a driver that flips the image, and states the sensor's order."""
    random = np.random.default_rng(0)
    colour = {"r": 40, "g": 120, "b": 100}
    tile = np.array([colour[c] for c in pattern]).reshape(2, 2)
    mosaic = np.tile(tile, (20, 30)) + random.normal(0.0, 5.0, (40, 60))
    dtype = np.uint8 if bits == 8 else np.uint16
    for stated in ("rggb", "bggr", "gbrg", "grbg"):
        message = image(mosaic.astype(dtype), f"bayer_{stated}{bits}")
        if (stated[0] == "g") is (pattern[0] == "g"):
            assert read_image(message).shape == (40, 60, 3)
            continue
        with pytest.raises(
            InputError,
            match=f"left image has the encoding bayer_{stated}{bits}, but .*bayer_{pattern}{bits}",
        ):
            read_image(message, "left image")
    # Where red and blue are lost, green has more noise than both.
    lost = np.array([100 if c == "g" else 2 for c in pattern]).reshape(2, 2)
    mosaic = np.tile(lost, (20, 30)) * (1.0 + random.normal(0.0, 0.05, (40, 60)))
    assert read_image(image(mosaic.round().astype(dtype), f"bayer_{pattern}{bits}")).any()
    # Nothing tells where green is in a grey image.
    grey = (100 + random.normal(0.0, 5.0, (40, 60))).astype(dtype)
    assert read_image(image(grey, f"bayer_{pattern}{bits}")).shape == (40, 60, 3)


def test_view_shares_the_messages_memory() -> None:
    data = np.zeros(18, np.uint8)
    view = image_view(image(np.zeros((2, 3, 3), np.uint8), "bgr8", data=data))
    data[3] = 7
    assert view[0, 1, 0] == 7


def test_last_row_needs_no_padding() -> None:
    message = image(np.ones((2, 3), np.uint8), "mono8", step=4, data=bytes([1, 1, 1, 0, 1, 1, 1]))
    np.testing.assert_array_equal(read_image(message), 1)


@pytest.mark.parametrize(("changes", "reason"), [
    ({"encoding": "nv21"}, "left image has the encoding 'nv21': publish one of mono8"),
    ({"encoding": ""}, "left image has the encoding ''"),
    ({"height": 0}, "5x0 pixels"),
    ({"step": 14}, "step 14, but a row of 5 pixels of rgb8 takes 15"),
    ({"data": bytes(80)}, "80 bytes of data where 5x6 pixels of rgb8 need 90: .* truncated"),
    ({"data": b""}, "0 bytes of data"),
])
def test_what_cannot_be_read_is_named(changes: dict[str, Any], reason: str) -> None:
    message = image(np.zeros((6, 5, 3), np.uint8), "rgb8")
    vars(message).update(changes)
    with pytest.raises(InputError, match=reason):
        read_image(message, "left image")


@given(st.sampled_from(["rgb8", "bgr8", "mono8", "rgb16", "bgr16", "mono16"]))
def test_written_images_read_back(encoding: str) -> None:
    _, pixels = stored(encoding)
    message = write_image(make, pixels, encoding, header="the header")
    assert message.name == "sensor_msgs/msg/Image"
    assert (message.header, message.encoding) == ("the header", encoding)
    assert message.data.dtype == np.uint8 and message.data.ndim == 1
    np.testing.assert_array_equal(read_image(message), pixels)


def test_enhanced_images_keep_order_and_depth() -> None:
    pairs = {
        "bgr8": "bgr8", "rgba8": "rgb8", "bgra8": "bgr8", "bgr16": "bgr16", "mono16": "mono16",
        "bayer_rggb8": "rgb8", "bayer_grbg16": "rgb16",
    }
    assert {name: ENCODINGS[name].output for name in pairs} == pairs
