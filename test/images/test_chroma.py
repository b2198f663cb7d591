# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Colour is read at the scale at which it is real, with the noise that pixels do not show."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from uw_visibility.images.chroma import Colour, mosaic_colour, sampled
from uw_visibility.images.noise import noise_stddev
from uw_visibility.images.sampling import CAMERA, Sampling
from uw_visibility.messages.chroma import file_colour, message_colour
from uw_visibility.messages.images import ENCODINGS

RNG = np.random.default_rng(5)
PIXELS = RNG.integers(40, 200, (32, 48, 3), np.uint8)
PATTERNS = ("rggb", "bggr", "gbrg", "grbg")


def mosaic(pixels: np.ndarray, pattern: str) -> np.ndarray:
    plane = np.empty(pixels.shape[:2], pixels.dtype)
    for k, name in enumerate(pattern):
        place = np.s_[k // 2::2, k % 2::2]
        plane[place] = pixels[..., "rgb".index(name)][place]
    return plane


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
    colour = mosaic_colour(image, pattern)
    assert colour.image is None and colour.sampling.scale == 1
    np.testing.assert_allclose(np.hypot(shown, colour.sampling.hidden_noise), noise, rtol=0.15)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_texture_in_a_mosaic_is_not_taken_for_noise(pattern: str) -> None:
    texture = np.random.default_rng(1).random((240, 320, 3))
    pixels = (255 * np.clip(cv2.GaussianBlur(texture, (0, 0), 1.5) * 3 - 1, 0, 1)).astype(np.uint8)
    raw = mosaic(pixels, pattern)
    hidden = mosaic_colour(
        cv2.cvtColor(raw, ENCODINGS[f"bayer_{pattern}8"].to_rgb), pattern
    ).sampling.hidden_noise
    # What pixels of one colour differ by from their neighbours, without regard to texture.
    apart = noise_stddev(np.ascontiguousarray(pixels[::2, ::2]))
    assert hidden is not None and (apart > 10).all()
    assert (hidden < 0.3 * apart).all()


def test_pixels_that_say_all_are_read_as_they_are() -> None:
    ranges = np.ones((32, 48), np.float32)
    for colour, sampling in ((None, CAMERA), (mosaic_colour(PIXELS, "rggb"), None)):
        found = sampled(PIXELS, ranges, None, colour)
        assert found[0] is PIXELS and found[1] is ranges and found[2] is None
        assert colour is not None or found[3] is sampling


def test_ranges_and_valid_pixels_follow_the_scale_of_colour() -> None:
    ranges = RNG.uniform(1, 2, (33, 49)).astype(np.float32)
    ranges[5, 7] = np.nan
    valid = np.ones((33, 49), bool)
    valid[10, 20] = False
    colour = Colour(np.zeros((16, 24, 3), np.uint16), Sampling(2))
    image, small, mask, sampling = sampled(np.zeros((33, 49, 3), np.uint8), ranges, valid, colour)
    assert image is colour.image and sampling.scale == 2
    expected = ranges[:32, :48].reshape(16, 2, 24, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(small, expected, rtol=1e-6)
    assert np.isnan(small).sum() == 1 and np.isnan(small[2, 3])
    assert mask is not None and (~mask).sum() == 1 and not mask[5, 10]
    assert sampled(image, ranges, None, colour)[2] is None


def test_counts_and_distances_are_those_of_the_camera() -> None:
    half = Sampling(2)
    assert (half.pixels(100), half.pixels(2.0), CAMERA.pixels(100)) == (25, 1, 100)
    assert ([half.margin(m) for m in (1, 3, 6)], CAMERA.margin(3)) == ([1, 2, 3], 3)


def compressed(kind: str, stored: np.ndarray, codec: str) -> SimpleNamespace:
    data = np.frombuffer(cv2.imencode(codec, stored)[1].tobytes(), np.uint8)
    return SimpleNamespace(format=kind, data=data)


def test_only_what_loses_colour_has_more_than_its_pixels() -> None:
    grey = PIXELS[..., 0].copy()
    for message in (
        SimpleNamespace(encoding="rgb8"), SimpleNamespace(encoding="bgr16"),
        compressed("rgb8; png compressed bgr8", PIXELS, ".png"), compressed("png", PIXELS, ".png"),
    ):
        assert message_colour(message, PIXELS) is None
    for message in (
        SimpleNamespace(encoding="mono8"), compressed("mono8; jpeg compressed ", grey, ".jpg"),
    ):
        assert message_colour(message, grey) is None


@pytest.mark.parametrize("pattern", PATTERNS)
def test_mosaics_are_known_by_their_encoding(pattern: str) -> None:
    raw = mosaic(PIXELS, pattern)
    image = cv2.cvtColor(raw, ENCODINGS[f"bayer_{pattern}8"].to_rgb)
    expected = mosaic_colour(image, pattern).sampling.hidden_noise
    for message in (
        SimpleNamespace(encoding=f"bayer_{pattern}8"),
        compressed(f"bayer_{pattern}8; png compressed ", raw, ".png"),
    ):
        colour = message_colour(message, image)
        assert colour is not None
        np.testing.assert_array_equal(colour.sampling.hidden_noise, expected)


@pytest.mark.parametrize(
    "kind", ["jpeg", "rgb8; jpeg compressed bgr8", "rgb8; jpeg compressed rgb8"]
)
def test_jpeg_has_its_colour_in_the_right_order(tmp_path: Path, kind: str) -> None:
    pixels = np.full((32, 48, 3), (30, 120, 160), np.uint8)
    given = pixels if "compressed rgb" in kind else pixels[..., ::-1]
    message = compressed(kind, np.ascontiguousarray(given), ".jpg")
    colour = message_colour(message, pixels)
    assert colour is not None and colour.image is not None
    assert colour.sampling.hidden_noise is not None
    np.testing.assert_allclose(colour.image / 257, pixels[:16, :24], atol=2)
    if kind == "jpeg":
        path = tmp_path / "left.jpg"
        path.write_bytes(message.data.tobytes())
        found = file_colour(path, pixels)
        assert found is not None
        np.testing.assert_array_equal(found.image, colour.image)
        assert file_colour(path, pixels[..., 0]) is None


def test_noise_goes_with_its_channel_where_red_and_blue_are_exchanged() -> None:
    colour = Colour(RNG.integers(0, 9, (2, 2, 3), np.uint16), Sampling(2, np.array([1.0, 2, 3])))
    assert colour.image is not None and colour.swapped.image is not None
    np.testing.assert_array_equal(colour.swapped.image, colour.image[..., ::-1])
    np.testing.assert_array_equal(colour.swapped.sampling.hidden_noise, [3, 2, 1])
