# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Blockiness of images with and without JPEG compression."""

import cv2
import numpy as np
import pytest

from uw_visibility.stereo.codec_noise import blocking


def scene(seed, size=(240, 320)):
    """Texture of several scales, blurred as by a lens, with noise."""
    rng = np.random.default_rng(seed)
    rows, columns = size
    grey = sum(
        cv2.resize(rng.random((rows // s, columns // s, 3)), (columns, rows)) / 4
        for s in (2, 6, 20, 60))
    grey = cv2.GaussianBlur(grey, (0, 0), 0.7) + 0.003 * rng.normal(size=(rows, columns, 3))
    return np.round(255 * np.clip(grey, 0, 1)).astype(np.uint8)


def compressed(image, quality):
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


@pytest.mark.parametrize("seed", range(3))
def test_a_jpeg_shows_its_blocks(seed):
    image = scene(seed)
    assert blocking(image) == pytest.approx(1.0, abs=0.07)
    assert min(blocking(compressed(image, quality)) for quality in (60, 75, 90)) > 1.2
    # More bits alone change nothing.
    assert blocking(257 * image.astype(np.uint16)) == pytest.approx(blocking(image), abs=1e-3)


def test_what_was_moved_since_shows_none():
    image = compressed(scene(0), 75)
    turned = cv2.warpAffine(image, cv2.getRotationMatrix2D((160, 120), 3.0, 1.03), (320, 240))
    assert blocking(turned) == pytest.approx(1.0, abs=0.1)


def test_blank_and_narrow_images_show_none():
    image = scene(1)
    assert blocking(np.full_like(image, 90)) == 1.0
    assert blocking(compressed(image, 60)[:, :24]) == 1.0
