# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Blocks of pixels: what of an image is saturated."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image
from scenes import blurred, texture

from uw_visibility.images.jpeg import jpeg_chroma
from uw_visibility.images.view import View
from uw_visibility.water.blocks import without_ranges


def overexposed() -> np.ndarray:
    """A textured image, (160, 240, 3) uint8, whose green is saturated in most places."""
    light = blurred(texture((160, 240, 3), 1, (4, 12)), 1.0)
    light = 128.0 + 60.0 * (light - light.mean()) / light.std() + np.array([-40.0, 135.0, -20.0])
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)


def clipped(view: View) -> np.ndarray:
    assert view.colour is not None
    return without_ranges(view.colour, None).clipped


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("low", [False, True])
def test_saturation_is_told_whatever_the_camera_s_bits(bits: int, low: bool) -> None:
    shown = overexposed()
    share = (shown == 255).mean(axis=(0, 1))
    assert share[1] > 0.5
    codes = np.rint(shown / 255.0 * (2**bits - 1)).astype(np.uint16) << (0 if low else 16 - bits)
    np.testing.assert_allclose(clipped(View.of(codes.astype(np.uint16))), share)


@pytest.mark.parametrize("layout", [0, 1, 2])
@pytest.mark.parametrize("quality", [75, 95])
def test_saturation_is_told_behind_a_codec(layout: int, quality: int) -> None:
    shown = overexposed()
    file = io.BytesIO()
    Image.fromarray(shown).save(file, "JPEG", quality=quality, subsampling=layout)
    decoded = np.array(Image.open(io.BytesIO(file.getvalue())))
    found = clipped(View.of(decoded, chroma=jpeg_chroma(file.getvalue())))
    np.testing.assert_allclose(found, (shown == 255).mean(axis=(0, 1)), atol=0.1)


@pytest.mark.parametrize("layout", [None, 0, 1, 2])
def test_the_noise_of_a_block_is_that_of_its_samples(layout: int | None) -> None:
    """A sample of subsampled colour is the mean of four pixels."""
    random = np.random.default_rng(0)
    light = np.array([90.0, 120.0, 140.0]) + 6.0 * random.standard_normal((480, 640, 3))
    pixels, chroma = np.rint(light).astype(np.uint8), None
    if layout is not None:
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "JPEG", quality=97, subsampling=layout)
        pixels, chroma = np.array(Image.open(file)), jpeg_chroma(file.getvalue())
    colour = View.of(pixels, chroma=chroma).colour
    assert colour is not None
    blocks = without_ranges(colour, None)
    shown = blocks.light.std(axis=(0, 1))
    np.testing.assert_allclose(blocks.noise / blocks.size, shown, rtol=0.4)
