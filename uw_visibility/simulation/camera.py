# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated stereo camera: geometry, pose and sensor noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError, check_range
from uw_visibility.stereo.rig import StereoRig

# A frame of that size takes minutes already.
LARGEST_SIDE = 8192


@dataclass(frozen=True)
class StereoCamera:
    """Rectified pair of ideal cameras.

    Attributes
    ----------
    width, height : int
        Size of an image in px.
    focal_length : float
        Focal length in px.
    baseline : float
        Distance of the right camera from the left one in m.
    """

    width: int = 640
    height: int = 480
    focal_length: float = 600.0
    baseline: float = 0.12

    def __post_init__(self) -> None:
        """Validate size, focal length and baseline."""
        if not 8 <= min(self.width, self.height) <= max(self.width, self.height) <= LARGEST_SIDE:
            raise InputError(
                f"image size is {self.width}x{self.height}: give from 8x8 up to "
                f"{LARGEST_SIDE}x{LARGEST_SIDE} pixels"
            )
        for name, value in (("focal length", self.focal_length), ("baseline", self.baseline)):
            check_range(name, value, 0.0, above=True)

    @property
    def principal_point(self) -> tuple[float, float]:
        """Column and row of the optical axis in px, in both images."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    @property
    def rig(self) -> StereoRig:
        """Geometry of the pair, as the pipeline takes it."""
        return StereoRig(self.focal_length, self.baseline, self.principal_point)


@dataclass(frozen=True)
class Pose:
    """Pose of the left camera.

    Attributes
    ----------
    position : tuple of float
        x, y, z of the left camera in m.
    heading : float
        Turn to the left of the x axis in rad.
    tilt : float
        Downward tilt of the optical axis in rad.
    roll : float
        Turn about the optical axis in rad, right side down.
    """

    position: tuple[float, float, float]
    heading: float = 0.0
    tilt: float = 0.0
    roll: float = 0.0

    def rotation(self) -> NDArray[np.float64]:
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
    """Sensor of a small camera: shot noise, read noise, quantisation.

    Attributes
    ----------
    full_well : float
        Electrons of a saturated pixel; inf leaves out the shot noise.
    read_noise : float
        Standard deviation of reading a pixel in electrons.
    """

    full_well: float = 15000.0
    read_noise: float = 20.0

    def __post_init__(self) -> None:
        """Validate full well and read noise."""
        if not self.full_well > 0.0:
            raise InputError(f"full well is {self.full_well:g} electrons: give more than zero")
        check_range("read noise", self.read_noise, 0.0, unit="electrons")

    def read(
        self, irradiance: NDArray[np.float32], random: np.random.Generator
    ) -> NDArray[np.float32]:
        """Turn irradiance into code values, not yet rounded, with shot and read noise.

        Parameters
        ----------
        irradiance : ndarray, shape (H, W, 3), float32
            Irradiance 0 .. 1; what is above saturates.
        random : numpy.random.Generator
            Where the noise comes from.

        Returns
        -------
        ndarray, shape (H, W, 3), float32
            255 for an irradiance of 1.
        """
        grey = irradiance * np.float32(255.0)
        if math.isfinite(self.full_well):
            # Counts are large enough for the normal law to stand in for Poisson's.
            variance = np.maximum(irradiance, 0.0) / self.full_well
            variance += (self.read_noise / self.full_well) ** 2
            noise = random.standard_normal(irradiance.shape, dtype=np.float32)
            grey = grey + np.float32(255.0) * np.sqrt(variance).astype(np.float32) * noise
        return np.asarray(grey, dtype=np.float32)

    @classmethod
    def gaussian(cls, codes: float) -> Sensor:
        """Return a sensor whose noise is the same at any light.

        Parameters
        ----------
        codes : float
            Standard deviation in codes of 255; 0 for none.

        Raises
        ------
        InputError
            If it is negative or beyond all codes.
        """
        check_range("noise", codes, 0.0, 255.0, "codes")
        if codes == 0.0:
            return NOISELESS
        # So large a well that its shot noise does not count.
        return cls(full_well=1e12, read_noise=codes / 255.0 * 1e12)


NOISELESS = Sensor(full_well=math.inf, read_noise=0.0)
"""A sensor that quantises and does nothing else."""
