# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Colour as codecs and mosaics leave it: at its own resolution, with noise that pixels hide."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Image
from uw_visibility.images.noise import BLOCK, SMOOTHEST, noise_stddev
from uw_visibility.images.pair import read_only


@dataclass(frozen=True, eq=False)
class ChromaImage:
    """Colour at its native (subsampled) resolution, with the codec's noise."""

    # (h, w, 3) of uint8 or uint16, or None, RGB at that resolution; None where that is the image
    # itself
    pixels: Image | None
    scale: int = 1  # a pixel is the mean of so many times so many of the camera's
    # (3,) float64 or None, standard deviation of R, G, B in 8-bit code values that the smoothest
    # parts of the image do not show: what a codec rounds where there is texture, and what
    # interpolation smooths. None where there is none.
    hidden_noise: Array | None = None

    @property
    def swapped(self) -> ChromaImage:
        """The same with red and blue exchanged."""
        pixels, noise = self.pixels, self.hidden_noise
        return replace(
            self,
            pixels=None if pixels is None else read_only(np.ascontiguousarray(pixels[..., ::-1])),
            hidden_noise=None if noise is None else noise[::-1].copy(),
        )


def mosaic_chroma(image: Image, pattern: str) -> ChromaImage:
    """Chroma noise of an image (H, W, 3) that was demosaiced from a pattern such as ``"rggb"``.

    Interpolation smooths noise, but leaves each pixel as it was in the channel that the
    sensor has measured there. These are two pixels apart, over which texture looks like
    noise; how much of it is noise is told by green, which has neighbours nearer by.
    """
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    cells = np.empty((height // 2, width // 2, 3), image.dtype)
    for channel, name in enumerate("rgb"):
        row, column = divmod(pattern.index(name), 2)
        cells[..., channel] = image[row:height:2, column:width:2, channel]
    noise = _noise_share(image[:height, :width, 1], pattern) * noise_stddev(read_only(cells)) ** 2
    hidden = noise - noise_stddev(read_only(image)) ** 2
    return ChromaImage(None, 1, np.sqrt(np.maximum(hidden, 0.0)) / code_value(image))


def subsampled_chroma(image: Image) -> ChromaImage:
    """Colour of an image (H, W, 3) whose pixels share it in twos, as in YUV 4:2:2."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    whole = image[: 2 * height, : 2 * width]
    half = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    return ChromaImage(read_only(half), 2)


def _noise_share(green: Image, pattern: str) -> float:
    """Return the part of green's variance over two pixels that is noise.

    Texture adds as the fourth power of the distance that it is seen over, noise alike.
    """
    row, column = divmod(pattern.index("g"), 2)
    one = green[row::2, column::2].astype(np.float32)
    other = green[1 - row::2, 1 - column::2].astype(np.float32)
    middle = one[1:-1, 1:-1]
    far = middle - (one[:-2, 1:-1] + one[2:, 1:-1] + one[1:-1, :-2] + one[1:-1, 2:]) / 4
    # The other green pixels of the cells above and left, or right, are as near.
    shift = slice(2, None) if column else slice(None, -2)
    near = middle - (
        other[1:-1, 1:-1] + other[:-2, 1:-1] + other[1:-1, shift] + other[:-2, shift]
    ) / 4
    apart, close = _smoothest(far), _smoothest(near)
    return float(np.clip((4 * close - apart) / (3 * apart), 0.0, 1.0)) if apart > 0 else 0.0


def _smoothest(difference: NDArray[np.floating]) -> float:
    """Return the variance of differences in the smoothest blocks; 0 where there is none."""
    size = difference.shape[1] // BLOCK, difference.shape[0] // BLOCK
    if min(size) < 1:
        return 0.0
    whole = difference[: size[1] * BLOCK, : size[0] * BLOCK]
    variances = cv2.resize(whole * whole, size, interpolation=cv2.INTER_AREA)
    alive = variances[variances > 0]
    return float(np.quantile(alive, SMOOTHEST)) if alive.size else 0.0


def code_value(pixels: Image) -> float:
    """Return how many code values of an image, uint8 or uint16, are one of 8 bits."""
    return float((np.iinfo(pixels.dtype).max + 1) / 256)
