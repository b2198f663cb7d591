# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs for the matcher with disparities known by construction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import stereo_pair
from scenes import texture as texture_of

from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.contrast import ContrastNormalizer

Image = NDArray[np.uint8]


def make_texture(shape: tuple[int, int], seed: int = 0) -> Image:
    """Return contrast of several scales, (H, W) uint8."""
    return (255 * texture_of(shape, seed)).astype(np.uint8)


@pytest.fixture
def texture() -> Callable[..., Image]:
    """Maker of textures."""
    return make_texture


@pytest.fixture
def shifted_pair() -> Callable[..., tuple[Image, Image]]:
    """Maker of pairs of one plane parallel to the image."""

    def make(
        shape: tuple[int, int] = (96, 160), disparity: int = 12, seed: int = 0
    ) -> tuple[Image, Image]:
        return stereo_pair(make_texture((shape[0], shape[1] + disparity), seed), disparity)

    return make


@pytest.fixture
def contrast_of() -> Callable[[Image], ContrastNormalizer]:
    """Maker of the raw contrast of an image."""

    def make(image: Image) -> ContrastNormalizer:
        contrast = ContrastNormalizer((image.shape[0], image.shape[1]))
        # Texture of single pixels, as in the tests, would otherwise be measured as noise.
        contrast.stretch(image, Workers(1), np.zeros(3))
        return contrast

    return make
