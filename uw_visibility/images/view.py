# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""View: one image with its valid pixels, transfer, noise and colour."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from uw_visibility.images.arrays import Image, Mask, PerChannel, RangeMap
from uw_visibility.images.chroma import ChromaImage, code_value
from uw_visibility.images.noise import noise_stddev


@dataclass(frozen=True, eq=False)
class ColourSamples:
    """Pixels (RGB code values) at the resolution at which their colour was measured."""

    pixels: Image
    transfer: str
    # (3,) float64, standard deviation in code values, with what a codec or the interpolation of a
    # mosaic hides
    noise: PerChannel
    scale: int = 1  # a sample is the mean of so many times so many of the camera's pixels
    codec_known: bool = False  # whether the noise holds what a codec or a mosaic did to the colour

    def reduce(self, range_map: RangeMap, valid: Mask | None) -> tuple[RangeMap, Mask | None]:
        """Return the range (m) of each sample, and which of them count; None for all.

        A sample's range is the mean of its pixels', unknown where one of them is; it
        counts where they all do.
        """
        if self.scale == 1:
            return range_map, valid
        scale = self.scale
        height, width = self.pixels.shape[:2]
        rows, columns = slice(height * scale), slice(width * scale)
        small = cv2.resize(range_map[rows, columns], (width, height), interpolation=cv2.INTER_AREA)
        if valid is not None:
            squares = valid[rows, columns].reshape(height, scale, width, scale)
            valid = np.asarray(squares.all(axis=(1, 3)))
        return np.asarray(small), valid


@dataclass(frozen=True, eq=False)
class View:
    """One image with its valid pixels, transfer, noise and colour; see `View.of`."""

    pixels: Image  # (H, W, 3) or (H, W) of uint8 or uint16, RGB or grey code values
    transfer: str  # how they follow light: ``"linear"`` or ``"srgb"``
    valid: Mask | None  # (H, W) bool or None, pixels that show the scene; None for all
    # (3,) or (1,) float64, standard deviation of the noise that the pixels show, in code values
    noise: PerChannel
    colour: ColourSamples | None  # what the water is read from; None for a grey image
    # (3,) or (1,) float64, standard deviation of the white noise that would leave as much once the
    # pixels are smoothed: `noise`, and more where JPEG took the fine part of it; see
    # `uw_visibility.stereo.codec_noise`
    low_frequency_noise: PerChannel

    @classmethod
    def of(
        cls,
        pixels: Image,
        transfer: str = "linear",
        valid: Mask | None = None,
        chroma: ChromaImage | None = None,
    ) -> View:
        """Measure an image's noise, once, and find where its colour is to be read.

        `chroma` is colour as the codec left it; the pixels say all by default.
        """
        noise = noise_stddev(pixels)
        colour = None if pixels.ndim == 2 else _samples(pixels, transfer, noise, chroma)
        return cls(pixels, transfer, valid, noise, colour, noise)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.pixels.shape[0], self.pixels.shape[1]

    def with_noise_below(self, limit: PerChannel) -> View:
        """Return the view with no more noise, in code values, than a limit for each channel."""
        noise = np.minimum(self.noise, limit)
        colour = self.colour and replace(self.colour, noise=np.minimum(self.colour.noise, limit))
        smoothed = np.minimum(self.low_frequency_noise, limit)
        return replace(self, noise=noise, colour=colour, low_frequency_noise=smoothed)

    def without(self, mask: Mask | None) -> View:
        """Return the view whose valid pixels are those outside of a mask; None is an empty one."""
        if mask is None:
            return self
        return replace(self, valid=~mask if self.valid is None else self.valid & ~mask)


class StereoViews(NamedTuple):
    """Left and right view of one frame."""

    left: View
    right: View


def _samples(
    pixels: Image, transfer: str, noise: PerChannel, chroma: ChromaImage | None
) -> ColourSamples:
    if chroma is None:
        return ColourSamples(pixels, transfer, noise)
    samples = pixels
    if chroma.pixels is not None:
        samples = chroma.pixels
        shown = noise_stddev(samples)
        if chroma.scale > 1:
            # A mean has no more noise than the camera's pixels, but its neighbours are
            # farther away, so that texture looks more like it.
            shown = np.minimum(shown, code_value(samples) * (noise / code_value(pixels)))
        noise = shown
    if chroma.hidden_noise is not None:
        noise = np.hypot(noise, code_value(samples) * chroma.hidden_noise)
    return ColourSamples(samples, transfer, noise, chroma.scale, True)
