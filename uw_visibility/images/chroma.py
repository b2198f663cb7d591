# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Colour at the resolution of codec or mosaic, with noise that the pixels do not show."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Image
from uw_visibility.images.cells import means
from uw_visibility.images.noise import BLOCK, SMOOTHEST, noise_stddev
from uw_visibility.images.pair import read_only


@dataclass(frozen=True, eq=False)
class ChromaImage:
    """Colour at its native (subsampled) resolution, with the noise of codec or interpolation."""

    pixels: Image | None  # (h, w, 3) uint8 or uint16, RGB at that resolution; None: the image
    scale: int = 1  # a pixel is the mean of scale × scale pixels of the camera
    # (3,) float64 or None, standard deviation of noise of R, G, B in 8-bit code values that
    # `noise_stddev` does not measure: rounding of texture by a codec, and noise smoothed by
    # interpolation. None without such noise.
    hidden_noise: Array | None = None

    @property
    def swapped(self) -> ChromaImage:
        """This colour with red and blue exchanged."""
        pixels, noise = self.pixels, self.hidden_noise
        return replace(
            self,
            pixels=None if pixels is None else read_only(np.ascontiguousarray(pixels[..., ::-1])),
            hidden_noise=None if noise is None else noise[::-1].copy(),
        )


def mosaic_chroma(image: Image, pattern: str) -> ChromaImage:
    """Chroma noise of an image (H, W, 3) that was demosaiced from a pattern such as ``"rggb"``.

    Interpolation smooths noise, but keeps the measured channel of each pixel. Measured pixels of a
    channel are two pixels apart, so that texture adds to their differences; the share of noise is
    estimated from green, which also has nearer neighbours.
    """
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    cells = np.empty((height // 2, width // 2, 3), image.dtype)
    for channel, name in enumerate("rgb"):
        row, column = divmod(pattern.index(name), 2)
        cells[..., channel] = image[row:height:2, column:width:2, channel]
    noise = _noise_share(image[:height, :width, 1], pattern) * noise_stddev(read_only(cells)) ** 2
    hidden = noise - noise_stddev(read_only(image)) ** 2
    return ChromaImage(None, 1, np.sqrt(np.maximum(hidden, 0.0)) / code_value(image))


def subsampled_chroma(image: Image) -> ChromaImage | None:
    """Colour at half resolution of an image (H, W, 3) whose chroma is subsampled, as in 4:2:2.

    None for an image of a single row or column, which is refused later, as in other encodings.
    """
    if min(image.shape[:2]) < 2:
        return None
    return ChromaImage(read_only(means(image, 2)), 2)


def _noise_share(green: Image, pattern: str) -> float:
    """Return the share of noise in the variance of green between pixels two apart.

    Variance by texture rises with the fourth power of the distance, variance by noise is constant.
    """
    row, column = divmod(pattern.index("g"), 2)
    one = green[row::2, column::2].astype(np.float32)
    other = green[1 - row::2, 1 - column::2].astype(np.float32)
    middle = one[1:-1, 1:-1]
    far = middle - (one[:-2, 1:-1] + one[2:, 1:-1] + one[1:-1, :-2] + one[1:-1, 2:]) / 4
    # The other green pixels of these cells are diagonal neighbours.
    shift = slice(2, None) if column else slice(None, -2)
    near = middle - (
        other[1:-1, 1:-1] + other[:-2, 1:-1] + other[1:-1, shift] + other[:-2, shift]
    ) / 4
    apart, close = _smoothest(far), _smoothest(near)
    return float(np.clip((4 * close - apart) / (3 * apart), 0.0, 1.0)) if apart > 0 else 0.0


def _smoothest(difference: NDArray[np.floating]) -> float:
    """Return the variance of differences in the smoothest blocks; 0 without any."""
    if min(difference.shape) < BLOCK:
        return 0.0
    variances = means(difference * difference, BLOCK)
    alive = variances[variances > 0]
    return float(np.quantile(alive, SMOOTHEST)) if alive.size else 0.0


def code_value(pixels: Image) -> float:
    """Return the number of an image's code values (uint8 or uint16) per 8-bit code value."""
    return float((np.iinfo(pixels.dtype).max + 1) / 256)
