# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Low-frequency noise after JPEG is separated from texture by comparing both views."""

import cv2
import numpy as np
import pytest

from uw_visibility.images.view import StereoViews, View
from uw_visibility.stereo.codec_noise import low_frequency_noise, with_codec_noise

HEIGHT, WIDTH, DISPARITY = 240, 320, 12
POINTS = np.array([
    (x, y, DISPARITY) for y in range(12, 230, 10) for x in range(30, 300, 10)], np.float32)


def pair(noise: float, quality: int | None) -> StereoViews:
    """Texture of two pixels, shifted, with noise of brightness, compressed by JPEG."""
    rng = np.random.default_rng(4)
    wide = cv2.GaussianBlur(rng.normal(size=(HEIGHT, WIDTH + DISPARITY)), (0, 0), 2.0)
    wide = 90 + 12 * wide / wide.std()
    sides = []
    for shift in (0, DISPARITY):
        grey = wide[:, shift : shift + WIDTH]
        grey = grey + rng.normal(0, noise, grey.shape) if noise else grey
        pixels = np.repeat(np.clip(grey + 0.5, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
        if quality is not None:
            data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            pixels = cv2.imdecode(data, 1)
        sides.append(View.of(pixels))
    return StereoViews(*sides)


@pytest.mark.parametrize("quality", [None, 95, 90])
def test_noise_of_the_views_is_told_from_their_texture(quality: int | None) -> None:
    left, right = (view.pixels for view in pair(2.0, quality))
    assert low_frequency_noise(left, right, POINTS) == pytest.approx(2.0, rel=0.3)
    wide = low_frequency_noise(256 * left.astype(np.uint16), 256 * right.astype(np.uint16), POINTS)
    assert wide == pytest.approx(256 * low_frequency_noise(left, right, POINTS), rel=0.01)
    left, right = (view.pixels for view in pair(0.0, None))
    assert low_frequency_noise(left, right, POINTS) < 0.1


def test_only_what_went_through_jpeg_has_more_noise_than_is_measured() -> None:
    raw = pair(2.0, None)
    assert with_codec_noise(raw, POINTS) is raw
    views = pair(2.0, 90)
    for before, after in zip(views, with_codec_noise(views, POINTS), strict=True):
        assert (after.low_frequency_noise > 1.2 * before.noise).all()
        np.testing.assert_array_equal(after.noise, before.noise)


def test_too_few_matches_tell_nothing() -> None:
    views = pair(2.0, 90)
    assert with_codec_noise(views, POINTS[:5]) is views
    assert with_codec_noise(views, np.empty((0, 3), np.float32)) is views


def test_where_little_but_blocks_is_left_rounding_is_noise() -> None:
    # Without matches, noise cannot be measured from the views' difference.
    none = np.empty((0, 3), np.float32)
    faint = StereoViews(*(
        View.of(coarse(np.uint8(90 + (view.pixels.astype(float) - 90) / 4)))
        for view in pair(0.0, None)))
    for view in with_codec_noise(faint, none):
        np.testing.assert_allclose(view.low_frequency_noise, 1.5 * 2.0)


def coarse(pixels: np.ndarray) -> np.ndarray:
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 60])[1]
    return cv2.imdecode(data, 1)
