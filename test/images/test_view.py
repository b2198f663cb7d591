# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A view's noise and colour, at the scale at which its colour is real."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.images.chroma import ChromaImage, mosaic_chroma
from uw_visibility.images.noise import noise_stddev
from uw_visibility.images.view import ColourSamples, View

RNG = np.random.default_rng(5)
PIXELS = RNG.integers(40, 200, (32, 48, 3), np.uint8)


def test_pixels_that_say_all_are_read_as_they_are() -> None:
    ranges = np.ones((32, 48), np.float32)
    for chroma in (None, mosaic_chroma(PIXELS, "rggb")):
        view = View.of(PIXELS, "srgb", None, chroma)
        assert view.colour is not None and view.colour.pixels is PIXELS
        assert view.colour.transfer == "srgb"
        found, valid = view.colour.reduce(ranges, None)
        assert found is ranges and valid is None
        np.testing.assert_array_equal(view.noise, noise_stddev(PIXELS))


@pytest.mark.parametrize("code", [1, 256])
def test_noise_that_pixels_hide_adds_to_what_they_show(code: int) -> None:
    pixels = PIXELS if code == 1 else np.uint16(code) * PIXELS
    chroma = ChromaImage(None, 1, np.array([3.0, 4.0, 5.0]))
    view = View.of(pixels, chroma=chroma)
    assert view.colour is not None
    expected = np.sqrt(view.noise**2 + (code * np.array([3.0, 4.0, 5.0])) ** 2)
    np.testing.assert_allclose(view.colour.noise, expected)


def test_means_have_no_more_noise_than_the_pixels() -> None:
    # Texture over two pixels looks like noise in means of two, and not in the pixels.
    smooth = np.full((64, 96, 3), 100, np.uint8)
    smooth[:, ::2] += 1
    rough = RNG.integers(0, 60000, (32, 48, 3), np.uint16)
    view = View.of(smooth, chroma=ChromaImage(rough, 2))
    assert view.colour is not None and view.colour.pixels is rough
    assert (noise_stddev(rough) > 256 * 10).all()
    np.testing.assert_allclose(view.colour.noise, 256 * view.noise)


def test_ranges_and_valid_pixels_follow_the_scale_of_colour() -> None:
    ranges = RNG.uniform(1, 2, (33, 49)).astype(np.float32)
    ranges[5, 7] = np.nan
    valid = np.ones((33, 49), bool)
    valid[10, 20] = False
    colour = ColourSamples(np.zeros((16, 24, 3), np.uint16), "linear", np.zeros(3), 2)
    small, mask = colour.reduce(ranges, valid)
    expected = ranges[:32, :48].reshape(16, 2, 24, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(small, expected, rtol=1e-6)
    assert np.isnan(small).sum() == 1 and np.isnan(small[2, 3])
    assert mask is not None and (~mask).sum() == 1 and not mask[5, 10]
    assert colour.reduce(ranges, None)[1] is None


def test_foreground_leaves_the_valid_pixels() -> None:
    outside = np.zeros((32, 48), bool)
    outside[:4] = True
    hand = np.zeros((32, 48), bool)
    hand[:, :6] = True
    view = View.of(PIXELS)
    np.testing.assert_array_equal(view.without(hand).valid, ~hand)
    both = View.of(PIXELS, valid=~outside).without(hand)
    np.testing.assert_array_equal(both.valid, ~(hand | outside))
    assert both.noise is not None and both.shape == (32, 48)


def test_a_grey_view_has_noise_but_no_colour() -> None:
    grey = View.of(PIXELS[..., 1].copy())
    assert grey.colour is None
    np.testing.assert_array_equal(grey.noise, noise_stddev(PIXELS)[1:2])
