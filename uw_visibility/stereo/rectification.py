# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rectification of raw image pairs."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Image
from uw_visibility.images.cells import means
from uw_visibility.stereo.calibration import EQUIDISTANT, CameraCalibration, CameraInfo, read_pair
from uw_visibility.stereo.rig import StereoRig


class Rectifier:
    """Rectification of raw image pairs from the CameraInfo (K, D, R and P) of both cameras.

    rig: geometry of the rectified images.
    valid: (H, W) bool, pixels of the rectified left image that come from within the raw one.
    valid_window: (x, y, width, height) of the smallest window that contains all of `valid`.
    """

    def __init__(self, left: Any, right: Any) -> None:
        calibrations = read_pair(left, right)
        self.rig = StereoRig.from_projection(*(c.projection for c in calibrations))
        self.size = calibrations[0].size
        maps = [
            _undistortion_maps(calibration, side)
            for calibration, side in zip(calibrations, ("left", "right"), strict=True)
        ]
        self._left_map = maps[0]
        self._reduced: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}
        # Fixed-point maps are about twice as fast to apply as float ones.
        self._maps = [cv2.convertMaps(x, y, cv2.CV_16SC2) for x, y in maps]
        self.valid = _inside(*maps[0], self.size)
        self.valid.flags.writeable = False
        if not self.valid.any() or not _inside(*maps[1], self.size).any():
            raise InputError(
                "R and P of camera_info map all pixels out of the image: calibrate the pair again"
            )
        rows, columns = np.flatnonzero(self.valid.any(1)), np.flatnonzero(self.valid.any(0))
        self.valid_window = (
            int(columns[0]), int(rows[0]),
            int(columns[-1] - columns[0] + 1), int(rows[-1] - rows[0] + 1),
        )

    def rectify(self, left: Image, right: Image) -> tuple[NDArray[Any], NDArray[Any]]:
        """Rectify a pair of raw images of `size`; pixels from outside the raw image are 0."""
        first, second = (
            cv2.remap(image, *maps, cv2.INTER_LINEAR)
            for image, maps in zip((left, right), self._maps, strict=True))
        return first, second

    def rectify_reduced(self, left: Image, factor: int) -> NDArray[Any]:
        """Rectify a raw left image that was reduced to means of ``factor`` by ``factor`` pixels."""
        if factor not in self._reduced:
            x, y = ((means(plane, factor) + 0.5) / factor - 0.5 for plane in self._left_map)
            self._reduced[factor] = cv2.convertMaps(x, y, cv2.CV_16SC2)
        maps = self._reduced[factor]
        return np.asarray(cv2.remap(left, maps[0], maps[1], cv2.INTER_LINEAR))


def rectify_one(image: Image, info: CameraInfo, side: str) -> NDArray[Any]:
    """Rectify a raw image of a side, as a `Rectifier` of the pair does."""
    maps = _undistortion_maps(CameraCalibration.from_camera_info(info, side), side)
    return np.asarray(
        cv2.remap(image, *cv2.convertMaps(*maps, cv2.CV_16SC2), cv2.INTER_LINEAR))


def _undistortion_maps(
    calibration: CameraCalibration, side: str
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    calibration.check_distortion(side)
    function: Any = cv2.initUndistortRectifyMap
    if calibration.distortion_model == EQUIDISTANT:
        function = cv2.fisheye.initUndistortRectifyMap
    # Any number of zeros means no distortion, but OpenCV accepts certain numbers only.
    distortion = calibration.distortion if calibration.distortion.any() else np.zeros(4)
    x, y = function(
        calibration.camera_matrix, distortion, calibration.rotation,
        calibration.projection[:, :3], calibration.size, cv2.CV_32FC1,
    )
    return x, y


def _inside(
    x: NDArray[np.float32], y: NDArray[np.float32], size: tuple[int, int]
) -> NDArray[np.bool_]:
    # The fixed-point maps round to 1/32 px, so half of that outside counts as inside.
    reach = 1.0 / 64.0
    horizontal = (x >= -reach) & (x <= size[0] - 1 + reach)
    return horizontal & (y >= -reach) & (y <= size[1] - 1 + reach)
