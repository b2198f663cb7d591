# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Colour is read at the scale at which it is real, with the noise that pixels do not show."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from plain_messages import mosaic

from uw_visibility.images.chroma import ChromaImage, mosaic_chroma
from uw_visibility.images.jpeg import file_chroma
from uw_visibility.images.noise import noise_stddev
from uw_visibility.messages.compressed import message_chroma
from uw_visibility.messages.images import ENCODINGS

RNG = np.random.default_rng(5)
PIXELS = RNG.integers(40, 200, (32, 48, 3), np.uint8)
PATTERNS = ("rggb", "bggr", "gbrg", "grbg")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_interpolation_of_a_mosaic_hides_no_noise(pattern: str, bits: int) -> None:
    noise = np.array([2.0, 3.0, 4.0])
    code = 1 if bits == 8 else 256
    pixels = code * (100 + noise * np.random.default_rng(1).standard_normal((240, 320, 3)))
    raw = mosaic((pixels + 0.5).astype(np.uint8 if bits == 8 else np.uint16), pattern)
    image = cv2.cvtColor(raw, ENCODINGS[f"bayer_{pattern}{bits}"].to_rgb)
    shown = noise_stddev(image) / code
    assert (shown < 0.6 * noise).all()
    colour = mosaic_chroma(image, pattern)
    assert colour.pixels is None and colour.scale == 1
    np.testing.assert_allclose(np.hypot(shown, colour.hidden_noise), noise, rtol=0.15)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_texture_in_a_mosaic_is_not_taken_for_noise(pattern: str) -> None:
    texture = np.random.default_rng(1).random((240, 320, 3))
    pixels = (255 * np.clip(cv2.GaussianBlur(texture, (0, 0), 1.5) * 3 - 1, 0, 1)).astype(np.uint8)
    raw = mosaic(pixels, pattern)
    hidden = mosaic_chroma(
        cv2.cvtColor(raw, ENCODINGS[f"bayer_{pattern}8"].to_rgb), pattern
    ).hidden_noise
    # What pixels of one colour differ by from their neighbours, without regard to texture.
    apart = noise_stddev(np.ascontiguousarray(pixels[::2, ::2]))
    assert hidden is not None and (apart > 10).all()
    assert (hidden < 0.3 * apart).all()


def compressed(kind: str, stored: np.ndarray, codec: str) -> SimpleNamespace:
    data = np.frombuffer(cv2.imencode(codec, stored)[1].tobytes(), np.uint8)
    return SimpleNamespace(format=kind, data=data)


def test_only_what_loses_colour_has_more_than_its_pixels() -> None:
    grey = PIXELS[..., 0].copy()
    for message in (
        SimpleNamespace(encoding="rgb8"), SimpleNamespace(encoding="bgr16"),
        compressed("rgb8; png compressed bgr8", PIXELS, ".png"), compressed("png", PIXELS, ".png"),
    ):
        assert message_chroma(message, PIXELS) is None
    for message in (
        SimpleNamespace(encoding="mono8"), compressed("mono8; jpeg compressed ", grey, ".jpg"),
    ):
        assert message_chroma(message, grey) is None


@pytest.mark.parametrize("shape", [(1, 48, 3), (32, 1, 3)])
def test_single_row_or_column_has_no_colour_at_half_resolution(shape: tuple[int, ...]) -> None:
    pixels = PIXELS[: shape[0], : shape[1]].copy()
    assert message_chroma(SimpleNamespace(encoding="yuv422"), pixels) is None


@pytest.mark.parametrize("pattern", PATTERNS)
def test_mosaics_are_known_by_their_encoding(pattern: str) -> None:
    raw = mosaic(PIXELS, pattern)
    image = cv2.cvtColor(raw, ENCODINGS[f"bayer_{pattern}8"].to_rgb)
    expected = mosaic_chroma(image, pattern).hidden_noise
    for message in (
        SimpleNamespace(encoding=f"bayer_{pattern}8"),
        compressed(f"bayer_{pattern}8; png compressed ", raw, ".png"),
    ):
        colour = message_chroma(message, image)
        assert colour is not None
        np.testing.assert_array_equal(colour.hidden_noise, expected)


@pytest.mark.parametrize(
    "kind", ["jpeg", "rgb8; jpeg compressed bgr8", "rgb8; jpeg compressed rgb8"]
)
def test_jpeg_has_its_colour_in_the_right_order(tmp_path: Path, kind: str) -> None:
    pixels = np.full((32, 48, 3), (30, 120, 160), np.uint8)
    given = pixels if "compressed rgb" in kind else pixels[..., ::-1]
    message = compressed(kind, np.ascontiguousarray(given), ".jpg")
    colour = message_chroma(message, pixels)
    assert colour is not None and colour.pixels is not None
    assert colour.hidden_noise is not None
    np.testing.assert_allclose(colour.pixels / 257, pixels[:16, :24], atol=2)
    if kind == "jpeg":
        path = tmp_path / "left.jpg"
        path.write_bytes(message.data.tobytes())
        found = file_chroma(path, pixels)
        assert found is not None
        np.testing.assert_array_equal(found.pixels, colour.pixels)
        assert file_chroma(path, pixels[..., 0]) is None


def test_noise_goes_with_its_channel_where_red_and_blue_are_exchanged() -> None:
    colour = ChromaImage(RNG.integers(0, 9, (2, 2, 3), np.uint16), 2, np.array([1.0, 2, 3]))
    assert colour.pixels is not None and colour.swapped.pixels is not None
    np.testing.assert_array_equal(colour.swapped.pixels, colour.pixels[..., ::-1])
    np.testing.assert_array_equal(colour.swapped.hidden_noise, [3, 2, 1])
