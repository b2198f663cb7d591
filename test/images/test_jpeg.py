# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Colour that a JPEG has rounded comes back as far as brightness tells of it."""

from __future__ import annotations

import io
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scenes import blurred, codes, texture

from uw_visibility.images.chroma import ChromaImage
from uw_visibility.images.jpeg import jpeg_chroma

# Pillow's names of the resolution of colour: whole, half across, half both ways.
LAYOUTS = {"4:4:4": 0, "4:2:2": 1, "4:2:0": 2}


def under_water(seed: int = 3, shape: tuple[int, int] = (160, 240)) -> np.ndarray:
    """Make a textured scene of two colours, of which water has left little red."""
    width = shape[1]
    light = blurred(texture(shape, seed, (1, 2, 4, 8, 16)), 0.8)
    light = np.clip((light - light.mean()) / light.std() * 0.25 + 0.4, 0, 1)[..., None]
    albedo = np.where(np.arange(width)[:, None] < width // 2, [1.0, 0.8, 0.7], [0.5, 0.8, 1.0])
    water, direct = np.array([6.0, 50.0, 60.0]), np.array([24.0, 120.0, 130.0])
    return codes((water + direct * light * albedo) / 255)


def compress(pixels: np.ndarray, quality: int = 95, layout: str = "4:2:0", **more: int) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(
        buffer, "JPEG", quality=quality, subsampling=LAYOUTS[layout], **more
    )
    return buffer.getvalue()


def halved(pixels: np.ndarray) -> np.ndarray:
    height, width = pixels.shape[0] // 2, pixels.shape[1] // 2
    squares = pixels[: 2 * height, : 2 * width].astype(float)
    return np.asarray(squares.reshape(height, 2, width, 2, 3).mean(axis=(1, 3)))


def as_read(colour: ChromaImage) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Return colour in 8-bit codes, and what brings an image to its scale."""
    assert colour.pixels is not None
    if colour.scale == 1:
        return colour.pixels.astype(float), lambda pixels: pixels.astype(float)
    return colour.pixels / 257, halved


def deviation(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean((found - truth) ** 2, axis=(0, 1))))


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("quality", [80, 95])
def test_red_is_nearer_to_the_scene_than_as_decoded(
    quality: int, layout: str, progressive: bool
) -> None:
    pixels = under_water()
    data = compress(pixels, quality, layout, progressive=progressive)
    colour = jpeg_chroma(data)
    assert colour is not None
    assert colour.scale == (1 if layout == "4:4:4" else 2)
    image, scaled = as_read(colour)
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    plain = deviation(scaled(decoded), scaled(pixels))
    found = deviation(image, scaled(pixels))
    assert found[0] < 0.7 * plain[0]
    assert (found < 1.1 * plain).all()
    # What is left is known.
    assert colour.hidden_noise is not None
    ratio = colour.hidden_noise / found
    assert (ratio > 0.5).all() and (ratio < 2.0).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_means_of_chroma_are_not_rounded_to_one_side(layout: str) -> None:
    pixels = under_water()
    colour = jpeg_chroma(compress(pixels, 95, layout))
    assert colour is not None
    image, scaled = as_read(colour)
    assert (np.abs((image - scaled(pixels)).mean(axis=(0, 1))) < 0.1).all()


def test_nothing_contradicts_the_file() -> None:
    data = compress(under_water(), 80)
    colour = jpeg_chroma(data)
    assert colour is not None and colour.pixels is not None
    file = Image.open(io.BytesIO(data))
    steps = np.array(file.quantization[1]).reshape(8, 8)
    file.draft("YCbCr", (120, 80))
    stored = np.asarray(file).astype(float)
    red, green, blue = np.moveaxis(colour.pixels / 257, 2, 0)
    light = 0.299 * red + 0.587 * green + 0.114 * blue
    moved = 0.0
    for plane, found in ((1, (blue - light) / 1.772), (2, (red - light) / 1.402)):
        for y in range(0, 80, 8):
            for x in range(0, 120, 8):
                block = np.s_[y:y + 8, x:x + 8]
                before = cv2.dct(stored[block][..., plane] - 128)
                before = np.rint(before / steps) * steps
                difference = np.abs(cv2.dct(np.ascontiguousarray(found[block])) - before)
                assert (difference <= 0.5 * steps + 0.1).all()
                moved = max(moved, float((difference / steps).max()))
    assert moved > 0.4


def test_a_finer_quality_leaves_less_noise() -> None:
    pixels = under_water()
    noises = []
    for quality in (60, 80, 95, 100):
        colour = jpeg_chroma(compress(pixels, quality))
        assert colour is not None and colour.hidden_noise is not None
        noises.append(colour.hidden_noise)
    assert (np.diff(noises, axis=0) < 0).all()


@pytest.mark.parametrize("shape", [(61, 83), (9, 17), (2, 2)])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_sizes_that_fill_no_block(shape: tuple[int, int], layout: str) -> None:
    pixels = np.full((*shape, 3), (40, 120, 160), np.uint8)
    colour = jpeg_chroma(compress(pixels, 95, layout))
    assert colour is not None and colour.pixels is not None
    scale = colour.scale
    assert colour.pixels.shape == (shape[0] // scale, shape[1] // scale, 3)
    image, _ = as_read(colour)
    np.testing.assert_allclose(image, np.broadcast_to(pixels[0, 0], image.shape), atol=2)
    assert not colour.pixels.flags.writeable


def test_what_holds_no_colour_of_that_kind_is_left_to_its_pixels() -> None:
    pixels = under_water()
    grey, four = io.BytesIO(), io.BytesIO()
    Image.fromarray(pixels[..., 0]).save(grey, "JPEG")
    Image.fromarray(np.dstack([pixels, pixels[..., 0]]), "CMYK").save(four, "JPEG")
    rgb = io.BytesIO()
    Image.fromarray(pixels).save(rgb, "JPEG", keep_rgb=True, subsampling=0)
    row = compress(pixels[:1])
    cut = compress(pixels)[:3000]
    for data in (
        grey.getvalue(), four.getvalue(), rgb.getvalue(), row, cut, b"\xff\xd8\xff\xe0", b"",
    ):
        assert jpeg_chroma(data) is None


def test_a_table_with_a_step_of_nothing_is_damage() -> None:
    file = io.BytesIO()
    Image.fromarray(np.full((32, 32, 3), 90, np.uint8)).save(file, "JPEG", quality=80)
    data = bytearray(file.getvalue())
    assert jpeg_chroma(bytes(data)) is not None
    # The last of the 64 steps of the first table, behind marker, length and number.
    data[data.index(b"\xff\xdb") + 5 + 63] = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert jpeg_chroma(bytes(data)) is None


def test_an_image_beyond_the_limit_of_pillow_is_left_to_its_pixels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data = compress(under_water())
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    assert jpeg_chroma(data) is None


WARM = """
import sys

import numpy as np

sys.path[:0] = [{folder!r}, {home!r}]
from test_jpeg import LAYOUTS, compress, jpeg_chroma, under_water

from uw_visibility import Pipeline, StereoRig
from uw_visibility.compute.jit import counts

pipeline = Pipeline(StereoRig(200.0, 0.1, (119.5, 79.5)))
pipeline.warm_up((160, 240), compressed=True)
before = counts.compiled + counts.loaded
pixels = under_water()
for layout in LAYOUTS:
    colour = jpeg_chroma(compress(pixels, 95, layout))
    pipeline.process(pixels, np.roll(pixels, -8, axis=1), colour=colour)
print(counts.compiled + counts.loaded - before)
"""


@pytest.mark.node
def test_nothing_is_compiled_at_the_first_jpeg() -> None:
    here = Path(__file__).parent
    script = WARM.format(folder=str(here), home=str(here.parent))
    command = [sys.executable, "-c", script]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=True
    )
    assert done.stdout.strip() == "0"
