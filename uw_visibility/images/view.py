# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""View: one image with its valid pixels, transfer, noise and colour."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from uw_visibility.images.arrays import Image, Mask, PerChannel, RangeMap
from uw_visibility.images.cells import means
from uw_visibility.images.chroma import ChromaImage, code_value
from uw_visibility.images.noise import noise_stddev


@dataclass(frozen=True, eq=False)
class ColourSamples:
    """Pixels (RGB code values) at the resolution at which their colour was measured."""

    pixels: Image
    transfer: str
    # (3,) float64, standard deviation in code values, including `ChromaImage.hidden_noise`
    noise: PerChannel
    scale: int = 1  # a sample is the mean of scale × scale pixels of the camera
    codec_known: bool = False  # whether chroma of codec or mosaic was given

    def reduce(self, range_map: RangeMap, valid: Mask | None) -> tuple[RangeMap, Mask | None]:
        """Return the range (m) of each sample, and the mask of valid samples; None for all.

        A sample's range is the mean over its pixels, NaN if one of them is; a sample is valid if
        all of its pixels are.
        """
        if self.scale == 1:
            return range_map, valid
        if valid is not None:
            valid = means(valid.astype(np.float32), self.scale) == 1.0
        return means(range_map, self.scale), valid


@dataclass(frozen=True, eq=False)
class View:
    """One image with its valid pixels, transfer, noise and colour; see `View.of`."""

    pixels: Image  # (H, W, 3) or (H, W) of uint8 or uint16, RGB or grey code values
    transfer: str  # ``"linear"`` or ``"srgb"``
    valid: Mask | None  # (H, W) bool or None, pixels that show the scene; None for all
    noise: PerChannel  # (3,) or (1,) float64, standard deviation by `noise_stddev`, in code values
    colour: ColourSamples | None  # samples for the water's estimate; None for a grey image
    # (3,) or (1,) float64, standard deviation of white noise with the low-frequency power of the
    # noise, in code values: `noise`, but larger where JPEG removed high frequencies; see
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
        """Measure an image's noise and select its colour samples.

        `chroma` is the colour of codec or mosaic; by default the pixels are the samples.
        """
        noise = noise_stddev(pixels)
        colour = None if pixels.ndim == 2 else _samples(pixels, transfer, noise, chroma)
        return cls(pixels, transfer, valid, noise, colour, noise)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.pixels.shape[0], self.pixels.shape[1]

    def with_noise_below(self, limit: PerChannel) -> View:
        """Return the view with noise, in code values, limited in each channel."""
        noise = np.minimum(self.noise, limit)
        colour = self.colour and replace(self.colour, noise=np.minimum(self.colour.noise, limit))
        smoothed = np.minimum(self.low_frequency_noise, limit)
        return replace(self, noise=noise, colour=colour, low_frequency_noise=smoothed)

    def without(self, mask: Mask) -> View:
        """Return the view with the pixels of a mask not valid."""
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
            # A mean has no more noise than a pixel, but texture adds more to its measured noise,
            # since neighbours are farther away.
            shown = np.minimum(shown, code_value(samples) * (noise / code_value(pixels)))
        noise = shown
    if chroma.hidden_noise is not None:
        noise = np.hypot(noise, code_value(samples) * chroma.hidden_noise)
    return ColourSamples(samples, transfer, noise, chroma.scale, True)
