# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes with known disparity, seen through simulated water, and noise (section III)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import DisparityMap, Image8, Mask, RangeMap
from uw_visibility.images.files import read_image
from uw_visibility.images.overview import shown
from uw_visibility.optics.light_model import attenuate, transmission
from uw_visibility.stereo.interpolation import fill_gaps
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view
from uw_visibility_lab.simulation.camera import NOISELESS, Sensor

# Middlebury 2005 and 2006 (Scharstein and Pal, doi 10.1109/CVPR.2007.383191):
# https://vision.middlebury.edu/stereo/data/scenes2006
FULL_SIZE_FOCAL_LENGTH = 3740.0
BASELINE = 0.160
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm")
QUIET, CAMERA = "0", "camera"
"""Names of no noise, and of the shot and read noise of a small camera, see `Sensor`."""


@dataclass(frozen=True)
class Scene:
    """A stereo pair in air with its true disparity."""

    name: str  # name of its folder
    left: Image8  # left, right: (H, W, 3); the images, RGB, taken as normalised radiance
    right: Image8
    # disparity_left, disparity_right: (H, W); true disparity of each view, px; NaN if unknown
    disparity_left: DisparityMap
    disparity_right: DisparityMap
    # geometry of the pair; the principal point is the centre of the image, in both views
    rig: StereoRig

    @property
    def known(self) -> Mask:
        """(H, W) bool: pixels of the left view whose disparity is known."""
        return np.isfinite(self.disparity_left)

    def degraded(
        self,
        mean_attenuation: float,
        depth: float,
        clear_water_attenuation: ArrayLike,
        sensor: Sensor = NOISELESS,
    ) -> tuple[Image8, Image8]:
        """Return the pair as seen under water; see `degrade`."""
        left, right = (
            degrade(
                image, self.rig.range_from_disparity(fill_from_background(disparity)),
                mean_attenuation, depth, clear_water_attenuation, sensor, seed,
            )
            for seed, (image, disparity) in enumerate((
                (self.left, self.disparity_left), (self.right, self.disparity_right),
            ))
        )
        return left, right


def load_scene(folder: str | Path) -> Scene:
    """Load a scene in the form of Middlebury 2005 or 2006.

    ``view1`` and ``view5`` are the left and the right image, ``disp1.png`` and ``disp5.png``
    their disparities, 0 where unknown. Images of less than 500 px have a third of the full size,
    of less than 800 px half of it. Without ``disp5.png`` the left disparity is warped to the right.
    """
    folder = Path(folder)
    left, right = (_read_image(folder, name) for name in ("view1", "view5"))
    height, width = left.shape[:2]
    scale = 3 if width < 500 else 2 if width < 800 else 1
    disparity_left = read_disparity(folder / "disp1.png", scale)
    if (folder / "disp5.png").is_file():
        disparity_right = read_disparity(folder / "disp5.png", scale)
    else:
        disparity_right = in_right_view(disparity_left)
    if not right.shape[:2] == disparity_left.shape == disparity_right.shape == (height, width):
        raise InputError(f"scene {folder} has files of different size: give all in one size")
    return Scene(
        name=folder.name,
        left=left,
        right=right,
        disparity_left=disparity_left,
        disparity_right=disparity_right,
        rig=StereoRig(
            FULL_SIZE_FOCAL_LENGTH / scale, BASELINE, ((width - 1) / 2, (height - 1) / 2)),
    )


def read_disparity(path: Path, scale: int) -> DisparityMap:
    """Read a disparity map of a scene, px: the value / `scale`; NaN where the value is 0."""
    values = cv2.cvtColor(shown(read_image(path)), cv2.COLOR_RGB2GRAY)
    disparity = values.astype(np.float32) / np.float32(scale)
    disparity[values == 0] = np.nan
    return disparity


def degrade(
    radiance: Image8,
    range_map: RangeMap,
    mean_attenuation: float,
    depth: float,
    clear_water_attenuation: ArrayLike,
    sensor: Sensor = NOISELESS,
    seed: int = 0,
) -> Image8:
    """Degrade an image as water does (eq. 1-3), in 8 bit.

    radiance: (H, W, 3), in air, normalised, times 255. range_map: (H, W), m.
    mean_attenuation, clear_water_attenuation: α and κ (RGB), 1/m. depth: z, m; T·I0 is 1.
    """
    attenuation = np.asarray(clear_water_attenuation, dtype=np.float64) + mean_attenuation
    ambient = transmission(attenuation, depth)
    irradiance = attenuate(radiance / np.float32(255), range_map, attenuation, ambient)
    codes = sensor.read(irradiance, np.random.default_rng(seed))
    return np.asarray(np.clip(codes + np.float32(0.5), 0, 255), dtype=np.uint8)


def fill_from_background(disparity: DisparityMap) -> DisparityMap:
    """Fill gaps (NaN) of a disparity map, px, with the farther known neighbour in the row.

    Unknown pixels are mostly occluded ones, which lie on the background side.
    A row without any known pixel takes the nearest filled row.
    """
    rows = np.flatnonzero(np.isfinite(disparity).any(axis=1))
    if not len(rows):
        raise InputError("the disparity map has no known pixel to fill the others from")
    height, width = disparity.shape
    filled = fill_gaps(disparity, width, Workers(1))
    nearest = rows[np.abs(np.arange(height)[:, np.newaxis] - rows).argmin(axis=1)]
    return filled[nearest]


def _read_image(folder: Path, name: str) -> Image8:
    for suffix in IMAGE_SUFFIXES:
        path = folder / f"{name}{suffix}"
        if path.is_file():
            return np.ascontiguousarray(shown(read_image(path)))
    raise InputError(
        f"scene {folder} has no {name}{IMAGE_SUFFIXES[0]} (or {', '.join(IMAGE_SUFFIXES[1:])})"
    )


def sensor_of(noise: str) -> Sensor:
    """Return the sensor of a noise: codes of 255 (Gaussian, standard deviation), or ``camera``."""
    if noise == CAMERA:
        return Sensor()
    try:
        codes = float(noise)
    except ValueError:
        raise InputError(
            f"noise is {noise!r}: give codes of 255, such as 2, or {CAMERA} for shot and read noise"
        ) from None
    return Sensor.gaussian(codes)


def title_of(noise: str) -> str:
    """Return the name of a noise in tables and figures."""
    if noise == CAMERA:
        return "shot and read noise"
    return "no noise" if noise == QUIET else f"noise of {noise} codes"
