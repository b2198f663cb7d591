# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Camera effects beside noise: vignetting, colour filters, white balance, transfer, codec."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError, check_range
from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.transfer import from_linear
from uw_visibility.simulation.camera import Sensor

Image = NDArray[np.uint8]
Triple = tuple[float, float, float]

LARGEST_GAIN = 4.0
"""Largest gain of automatic white balance."""


@dataclass(frozen=True)
class CameraEffects:
    """Departures of a camera from a linear one; the defaults change nothing.

    Attributes
    ----------
    transfer : str
        ``linear``, or ``srgb``: pixels are gamma-encoded.
    white_balance : tuple of float
        Gains of R, G and B.
    automatic_white_balance : bool
        Whether each frame's channels are made equal on average (grey world), on top.
    vignetting : float
        Part of the light that is lost in the corners, falling with the square of the radius.
    exposure_difference : float
        Relative difference of the right image's exposure from the left one's.
    bayer : bool
        Whether each pixel senses one colour (RGGB) and the others are interpolated.
    jpeg : int
        Quality of JPEG compression, 1 .. 100; 0 leaves it out.
    """

    transfer: str = "linear"
    white_balance: Triple = (1.0, 1.0, 1.0)
    automatic_white_balance: bool = False
    vignetting: float = 0.0
    exposure_difference: float = 0.0
    bayer: bool = False
    jpeg: int = 0

    def __post_init__(self) -> None:
        """Validate the effects."""
        if self.transfer not in ("linear", "srgb"):
            raise InputError(f"transfer is {self.transfer!r}: give linear or srgb")
        check_range("gains of white balance", self.white_balance, 0.0, 10.0, above=True)
        check_range("vignetting", self.vignetting, 0.0, 0.999)
        check_range("exposure difference", self.exposure_difference, -0.9, 9.0)
        check_range("JPEG quality", self.jpeg, 0, 100)

    def gains(self, irradiance: Map) -> Array:
        """Return the gains of white balance for a frame, by its left image, RGB."""
        fixed = np.array(self.white_balance)
        if not self.automatic_white_balance:
            return fixed
        means = np.clip(irradiance, 0.0, 1.0).mean(axis=(0, 1), dtype=np.float64) * fixed
        automatic = means[1] / np.maximum(means, 1e-6)
        return np.asarray(fixed * np.minimum(automatic, LARGEST_GAIN))

    def record(
        self, irradiance: Map, sensor: Sensor, random: np.random.Generator, gains: Array,
        *, right: bool = False,
    ) -> Image:
        """Turn irradiance into pixels: lens, exposure, sensor, colours, curve, codec.

        Parameters
        ----------
        irradiance : ndarray, shape (H, W, 3), float32
            Irradiance, 0 .. 1; what is above saturates.
        sensor : Sensor
            Its noise.
        random : numpy.random.Generator
            Where the noise comes from.
        gains : ndarray, shape (3,), float64
            From `gains`, of the left image.
        right : bool
            Whether this is the right image.

        Returns
        -------
        ndarray, shape (H, W, 3), uint8
        """
        if self.vignetting > 0.0:
            irradiance = irradiance * lens_falloff(irradiance.shape[:2], self.vignetting)
        if right and self.exposure_difference != 0.0:
            irradiance = irradiance * np.float32(1.0 + self.exposure_difference)
        codes = sensor.read(irradiance, random)
        if self.bayer:
            codes = interpolate_mosaic(codes)
        if (gains != 1.0).any():
            codes = np.minimum(codes, 255.0) * gains.astype(np.float32)
        if self.transfer == "linear":
            image = np.clip(np.rint(codes), 0, 255).astype(np.uint8)
        else:
            image = np.asarray(from_linear(codes / 255.0, self.transfer, np.uint8), np.uint8)
        return _compress(image, self.jpeg) if self.jpeg else image


def lens_falloff(shape: tuple[int, ...], loss: float) -> Map:
    """Return 1 − loss · (r / r_corner)², shape (H, W, 1)."""
    rows, columns = ((np.arange(n) - (n - 1) / 2) / ((n - 1) / 2) for n in shape)
    aspect = (shape[0] - 1) / (shape[1] - 1)
    squared = (rows[:, np.newaxis] * aspect) ** 2 + columns**2
    return (1.0 - loss * squared / (1.0 + aspect**2)).astype(np.float32)[..., np.newaxis]


def interpolate_mosaic(codes: Map) -> Map:
    """Keep one colour of each pixel (RGGB) and interpolate the others bilinearly."""
    raw = codes[..., 1].copy()
    raw[0::2, 0::2] = codes[0::2, 0::2, 0]
    raw[1::2, 1::2] = codes[1::2, 1::2, 2]
    sensed = np.clip(raw * 256.0 + 0.5, 0, 65535).astype(np.uint16)
    # OpenCV names a pattern by its second row and column.
    return cv2.cvtColor(sensed, cv2.COLOR_BayerBG2RGB).astype(np.float32) / np.float32(256.0)


def _compress(image: Image, quality: int) -> Image:
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return np.asarray(decoded[..., ::-1], dtype=np.uint8, order="C")
