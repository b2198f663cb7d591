# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A camera's calibration as its CameraInfo message states it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError

EQUIDISTANT = "equidistant"
DISTORTION_COEFFICIENTS = {
    "plumb_bob": (4, 5),
    "rational_polynomial": (8, 12, 14),
    EQUIDISTANT: (4,),
}


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """K, D, R and P of one camera, for the pixels of the images that it sends.

    A CameraInfo is written for the sensor's full resolution. Region of
    interest and binning are applied here, so that all matrices are in the
    pixels of the image that comes with the message.

    Attributes
    ----------
    size : tuple of int
        Width and height of the image, px.
    camera_matrix : ndarray, (3, 3) float64
        K, of the raw image.
    distortion : ndarray, (n,) float64
        D; empty where the image is not distorted.
    distortion_model : str
        One of `DISTORTION_COEFFICIENTS`.
    rotation : ndarray, (3, 3) float64
        R, from the camera to the rectified frame.
    projection : ndarray, (3, 4) float64
        P, of the rectified image.
    """

    size: tuple[int, int]
    camera_matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    distortion_model: str
    rotation: NDArray[np.float64]
    projection: NDArray[np.float64]

    @classmethod
    def from_camera_info(cls, info: Any, side: str) -> CameraCalibration:
        """Read a CameraInfo of rclpy, or of rosbags (ROS 1 and ROS 2 names).

        Parameters
        ----------
        info : object
            Has width, height, distortion_model, binning_x, binning_y, roi and
            k, d, r, p (or K, D, R, P).
        side : str
            "left" or "right", for the messages of errors.

        Returns
        -------
        CameraCalibration

        Raises
        ------
        InputError
            If K or P is zero or not finite, or if a size is missing.
        """
        camera_matrix = _matrix(info, "k", side).reshape(3, 3)
        projection = _matrix(info, "p", side).reshape(3, 4)
        rotation = _matrix(info, "r", side).reshape(3, 3)
        _check_calibrated(camera_matrix, projection, side)
        if not rotation.any():
            rotation = np.eye(3)
        left, top, binning_x, binning_y = _window(info)
        # Pixel columns shift with the region of interest, then shrink with
        # binning; image_geometry does the same to K and to P.
        to_image = np.array([
            [1.0 / binning_x, 0.0, -left / binning_x],
            [0.0, 1.0 / binning_y, -top / binning_y],
            [0.0, 0.0, 1.0],
        ])
        return cls(
            size=image_size(info, side),
            camera_matrix=to_image @ camera_matrix,
            distortion=np.array(_field(info, "d"), np.float64).ravel(),
            distortion_model=str(info.distortion_model),
            rotation=rotation,
            projection=to_image @ projection,
        )

    def check_distortion(self, side: str) -> None:
        """Refuse a distortion that cannot be undone.

        Raises
        ------
        InputError
            If the model is unknown, or D has another length than it needs.
        """
        # Without coefficients these models are a pinhole camera; a fisheye is not.
        if not self.distortion.any() and self.distortion_model != EQUIDISTANT:
            return
        lengths = DISTORTION_COEFFICIENTS.get(self.distortion_model)
        if lengths is None:
            raise InputError(
                f"{side} camera_info has the distortion model {self.distortion_model!r}: "
                f"calibrate with one of {', '.join(DISTORTION_COEFFICIENTS)}"
            )
        if self.distortion.size not in lengths or not np.isfinite(self.distortion).all():
            wanted = " or ".join(str(n) for n in lengths)
            raise InputError(
                f"{side} camera_info has {self.distortion.size} coefficients in D: "
                f"the model {self.distortion_model} needs {wanted}, all finite"
            )


def image_size(info: Any, side: str) -> tuple[int, int]:
    """Return width and height of the images that belong to a CameraInfo, px.

    Raises
    ------
    InputError
        If the message has no size.
    """
    roi = info.roi
    width, height = (roi.width, roi.height) if roi.width and roi.height else (
        info.width, info.height
    )
    _, _, binning_x, binning_y = _window(info)
    size = int(width) // binning_x, int(height) // binning_y
    if min(size) < 1:
        raise InputError(
            f"{side} camera_info has width {info.width} and height {info.height}: "
            "publish the size of the calibrated image"
        )
    return size


def _window(info: Any) -> tuple[int, int, int, int]:
    """Return the image's left and top on the sensor and the binning (0 means 1)."""
    return (
        int(info.roi.x_offset), int(info.roi.y_offset),
        max(1, int(info.binning_x)), max(1, int(info.binning_y)),
    )


def _field(info: Any, name: str) -> Any:
    # ROS 1 wrote the matrices in capitals.
    return getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())


def _matrix(info: Any, name: str, side: str) -> NDArray[np.float64]:
    values = np.asarray(_field(info, name), np.float64).ravel()
    if not np.isfinite(values).all():
        raise InputError(
            f"{side} camera_info has {name.upper()} with values that are not finite: "
            "calibrate the camera and publish K, D, R and P"
        )
    return values


def _check_calibrated(
    camera_matrix: NDArray[np.float64], projection: NDArray[np.float64], side: str
) -> None:
    for name, matrix in (("K", camera_matrix), ("P", projection)):
        if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0):
            raise InputError(
                f"{side} camera_info is not calibrated, {name} has the focal lengths "
                f"{matrix[0, 0]:g} and {matrix[1, 1]:g}: calibrate the camera and publish "
                "K, D, R and P"
            )
