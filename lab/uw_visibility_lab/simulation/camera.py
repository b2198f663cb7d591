# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated stereo camera: geometry, pose, sensor noise, and other effects of the camera.

These are vignetting, colour filters, white balance, transfer and codec.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from uw_visibility.errors import InputError, check_range
from uw_visibility.images.arrays import Array, Image8, Map
from uw_visibility.optics.transfer import from_linear
from uw_visibility.stereo.rig import StereoRig

# Frames of this size already take minutes.
LARGEST_SIDE = 8192
Triple = tuple[float, float, float]

LARGEST_GAIN = 4.0
"""Largest gain of automatic white balance."""


@dataclass(frozen=True)
class StereoCamera:
    """Rectified pair of ideal cameras."""

    width: int = 640  # width, height: size of an image in px
    height: int = 480
    focal_length: float = 600.0  # focal length in px
    baseline: float = 0.12  # distance of the right camera from the left one in m

    def __post_init__(self) -> None:
        check_range("sides of the image size", (self.width, self.height), 8, LARGEST_SIDE, "px")
        check_range("focal length", self.focal_length, 0.0, above=True)
        check_range("baseline", self.baseline, 0.0, above=True)

    @property
    def principal_point(self) -> tuple[float, float]:
        """Column and row of the optical axis in px, in both images."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    @property
    def rig(self) -> StereoRig:
        """Geometry of the pair, in the pipeline's form."""
        return StereoRig(self.focal_length, self.baseline, self.principal_point)


@dataclass(frozen=True)
class Pose:
    """Pose of the left camera."""

    position: tuple[float, float, float]  # x, y, z of the left camera in m
    heading: float = 0.0  # turn from the world's x axis to the left in rad
    tilt: float = 0.0  # downward tilt of the optical axis in rad
    roll: float = 0.0  # turn about the optical axis in rad, right side down

    def rotation(self) -> Array:
        """Return the axes of the optical frame (right, down, forward) as columns."""
        ch, sh = math.cos(self.heading), math.sin(self.heading)
        ct, st = math.cos(self.tilt), math.sin(self.tilt)
        cr, sr = math.cos(self.roll), math.sin(self.roll)
        forward = np.array([ch * ct, sh * ct, -st])
        level = np.array([sh, -ch, 0.0])
        below = np.cross(forward, level)
        right = cr * level + sr * below
        return np.column_stack([right, np.cross(forward, right), forward])


@dataclass(frozen=True)
class Sensor:
    """Sensor of a small camera: shot noise, read noise, quantisation."""

    full_well: float = 15000.0  # electrons of a saturated pixel; inf: no noise at all
    read_noise: float = 20.0  # standard deviation of the read noise in electrons

    def __post_init__(self) -> None:
        if not self.full_well > 0.0:
            raise InputError(f"full well is {self.full_well:g} electrons: give more than zero")
        check_range("read noise", self.read_noise, 0.0, unit="electrons")

    def read(self, irradiance: Map, random: np.random.Generator) -> Map:
        """Convert irradiance (1: saturation) to code values with noise, not rounded or clipped."""
        grey = irradiance * np.float32(255.0)
        if math.isfinite(self.full_well):
            # Counts are large enough for the normal approximation of the Poisson distribution.
            variance = np.maximum(irradiance, 0.0) / self.full_well
            variance += (self.read_noise / self.full_well) ** 2
            noise = random.standard_normal(irradiance.shape, dtype=np.float32)
            grey = grey + np.float32(255.0) * np.sqrt(variance).astype(np.float32) * noise
        return np.asarray(grey, dtype=np.float32)

    @classmethod
    def gaussian(cls, codes: float) -> Sensor:
        """Return a sensor with noise of a fixed standard deviation in codes of 255; 0: none."""
        check_range("noise", codes, 0.0, 255.0, "codes")
        if codes == 0.0:
            return NOISELESS
        # With so large a well the shot noise is negligible.
        return cls(full_well=1e12, read_noise=codes / 255.0 * 1e12)


NOISELESS = Sensor(full_well=math.inf, read_noise=0.0)
"""A sensor without noise: it only quantises."""


@dataclass(frozen=True)
class CameraEffects:
    """Departures of a camera from a linear one; the defaults change nothing."""

    transfer: str = "linear"  # ``linear``, or ``srgb``: pixels are gamma-encoded
    white_balance: Triple = (1.0, 1.0, 1.0)  # gains of R, G and B
    # whether gains that equalise each frame's channel means (grey world) are applied, too
    automatic_white_balance: bool = False
    # share of the light that is lost in the corners; the loss grows with the square of the radius
    vignetting: float = 0.0
    # whether each pixel senses one colour (RGGB) and the others are interpolated
    bayer: bool = False
    jpeg: int = 0  # quality of JPEG compression, 1 .. 100; 0: no compression

    def __post_init__(self) -> None:
        if self.transfer not in ("linear", "srgb"):
            raise InputError(f"transfer is {self.transfer!r}: give linear or srgb")
        check_range("gains of white balance", self.white_balance, 0.0, 10.0, above=True)
        check_range("vignetting", self.vignetting, 0.0, 0.999)
        check_range("JPEG quality", self.jpeg, 0, 100)

    def gains(self, irradiance: Map) -> Array:
        """Return a frame's white balance gains, RGB, from the irradiance of its left image."""
        fixed = np.array(self.white_balance)
        if not self.automatic_white_balance:
            return fixed
        means = np.clip(irradiance, 0.0, 1.0).mean(axis=(0, 1), dtype=np.float64) * fixed
        automatic = means[1] / np.maximum(means, 1e-6)
        return np.asarray(fixed * np.minimum(automatic, LARGEST_GAIN))

    def record(
        self, irradiance: Map, sensor: Sensor, random: np.random.Generator, gains: Array
    ) -> Image8:
        """Convert irradiance (1: saturation) to pixels, with all effects in the camera's order.

        gains: white balance gains of the frame, see `gains`.
        """
        if self.vignetting > 0.0:
            irradiance = irradiance * lens_falloff(irradiance.shape[:2], self.vignetting)
        codes = sensor.read(irradiance, random)
        if self.bayer:
            codes = interpolate_mosaic(codes)
        if (gains != 1.0).any():
            codes = np.minimum(codes, 255.0) * gains.astype(np.float32)
        if self.transfer == "linear":
            image = np.clip(np.rint(codes), 0, 255).astype(np.uint8)
        else:
            image = np.asarray(from_linear(codes / 255.0, self.transfer, np.uint8), np.uint8)
        return compress(image, self.jpeg) if self.jpeg else image


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


def compress(image: Image8, quality: int) -> Image8:
    """Compress an RGB image as JPEG (quality 1 .. 100) and decompress it."""
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return np.asarray(decoded[..., ::-1], dtype=np.uint8, order="C")
