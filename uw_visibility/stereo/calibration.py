# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Camera calibration from CameraInfo messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array

# Largest differences by rounding: calibration tools write the matrices with few digits.
RELATIVE_TOLERANCE = 1e-3
PIXEL_TOLERANCE = 0.5

EQUIDISTANT = "equidistant"
DISTORTION_COEFFICIENTS = {
    "plumb_bob": (4, 5),
    "rational_polynomial": (8, 12, 14),
    EQUIDISTANT: (4,),
}


CameraInfo: TypeAlias = Any
"""``sensor_msgs/CameraInfo`` of rclpy or rosbags, of ROS 1 or ROS 2; see `matrix_of`."""


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """Calibration of one camera: K, D, R and P for the pixels of its images.

    A CameraInfo describes the sensor's full resolution. Region of interest and binning are applied
    to K and P here. `size` is width and height of the image, px; D is empty or 0 without
    distortion.
    """

    size: tuple[int, int]
    camera_matrix: Array
    distortion: Array
    distortion_model: str
    rotation: Array
    projection: Array

    @classmethod
    def from_camera_info(cls, info: CameraInfo, side: str) -> CameraCalibration:
        """Read a CameraInfo; errors name its `side`."""
        camera_matrix = _matrix(info, "k", side).reshape(3, 3)
        projection = _matrix(info, "p", side).reshape(3, 4)
        rotation = _matrix(info, "r", side).reshape(3, 3)
        for name, matrix in (("K", camera_matrix), ("P", projection)):
            if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0):
                raise InputError(
                    f"{side} camera_info is not calibrated, {name} has the focal lengths "
                    f"{matrix[0, 0]:g} and {matrix[1, 1]:g}: calibrate the camera and publish "
                    "K, D, R and P"
                )
        if not rotation.any():
            rotation = np.eye(3)
        left, top, binning_x, binning_y = _window(info)
        # The region of interest shifts pixels, then binning scales them; image_geometry changes K
        # and P in the same way.
        to_image = np.array([
            [1.0 / binning_x, 0.0, -left / binning_x],
            [0.0, 1.0 / binning_y, -top / binning_y],
            [0.0, 0.0, 1.0],
        ])
        return cls(
            size=image_size(info, side),
            camera_matrix=to_image @ camera_matrix,
            distortion=matrix_of(info, "d"),
            distortion_model=str(info.distortion_model),
            rotation=rotation,
            projection=to_image @ projection,
        )

    @property
    def is_of_rectified(self) -> bool:
        """Whether images need no rectification: no distortion, no rotation, and K as in P."""
        return not self.distortion.any() and np.allclose(self.rotation, np.eye(3)) and np.allclose(
            self.camera_matrix, self.projection[:, :3], RELATIVE_TOLERANCE, PIXEL_TOLERANCE)

    def check_distortion(self, side: str) -> None:
        """Refuse an unknown distortion model, or a wrong number of coefficients."""
        # Without coefficients, or with zeros, all but the equidistant model are a pinhole camera.
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


def image_size(info: CameraInfo, side: str) -> tuple[int, int]:
    """Return width and height of the images that belong to a CameraInfo, px."""
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


def doubt(info: CameraInfo, calibration: CameraCalibration, side: str) -> str:
    """Return why a CameraInfo seems to be that of images of another size, or "".

    The principal point of P is then nearer to the border than to the middle, in x and in y; in a
    region of interest it may be anywhere. `calibration` is that of the CameraInfo.
    """
    centre, size = calibration.projection[:2, 2], calibration.size
    near = any(abs(2.0 * c + 1.0 - n) <= n / 2.0 for c, n in zip(centre, size, strict=True))
    if near or (info.roi.width and info.roi.height):
        return ""
    return (
        f"{side} camera_info has the principal point {centre[0]:g} {centre[1]:g}, far from the "
        f"middle of {size[0]}x{size[1]} pixels: are K and P those of images of another size?")


def read_pair(left: CameraInfo, right: CameraInfo) -> tuple[CameraCalibration, CameraCalibration]:
    """Read the CameraInfo messages of a pair, whose images must have the same size."""
    pair = (
        CameraCalibration.from_camera_info(left, "left"),
        CameraCalibration.from_camera_info(right, "right"),
    )
    if pair[0].size != pair[1].size:
        sizes = " and ".join(f"{w}x{h}" for w, h in (pair[0].size, pair[1].size))
        raise InputError(
            f"left and right camera_info differ in size, {sizes} pixels: "
            "both cameras must send images of one size"
        )
    return pair


def read_projection(matrix: ArrayLike, side: str) -> Array:
    """Return a projection matrix as (3, 4) float64."""
    try:
        p = np.asarray(matrix, np.float64).reshape(3, 4)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"projection matrix P of the {side} camera does not have 3 by 4 numbers: "
            "give P1 and P2 of the stereo calibration"
        ) from error
    if not np.isfinite(p).all():
        raise InputError(
            f"projection matrix P of the {side} camera is not finite: "
            "give P1 and P2 of the stereo calibration"
        )
    if not (p[0, 0] > 0.0 and p[1, 1] > 0.0):
        raise InputError(
            f"projection matrix P of the {side} camera has the focal lengths {p[0, 0]:g} and "
            f"{p[1, 1]:g}: give P1 and P2 of the stereo calibration"
        )
    return p


def check_rectified(p1: Array, p2: Array) -> None:
    """Refuse projection matrices of a pair that is not rectified, or whose sides are swapped."""
    if p2[0, 3] > 0.0 or p1[0, 3] < 0.0:
        raise InputError(
            f"P[0, 3] is {p1[0, 3]:g} for the left and {p2[0, 3]:g} for the right camera, expected "
            "are 0 and a negative number: are left and right swapped?"
        )
    if p1[0, 3] != 0.0:
        raise InputError(
            f"P[0, 3] of the left camera is {p1[0, 3]:g}, expected is 0: give the left camera of "
            "the pair"
        )
    if abs(p2[1, 3]) > RELATIVE_TOLERANCE * abs(p2[0, 3]):
        raise InputError(
            f"P[1, 3] of the right camera is {p2[1, 3]:g}, a vertical pair: "
            "only horizontal pairs can be used"
        )
    if p2[0, 3] == 0.0:
        raise InputError(
            "P[0, 3] of the right camera is 0, so the baseline is 0: "
            "calibrate the two cameras as a stereo pair"
        )
    same_focal_length = np.allclose(
        p1[[0, 1], [0, 1]], p2[[0, 1], [0, 1]], rtol=RELATIVE_TOLERANCE, atol=0.0
    )
    if not same_focal_length or abs(p1[1, 2] - p2[1, 2]) > PIXEL_TOLERANCE:
        raise InputError(
            "P of the left and right camera differ in focal length or in cy, so the pair is not "
            "rectified: calibrate the two cameras as a stereo pair"
        )


def _window(info: CameraInfo) -> tuple[int, int, int, int]:
    """Return the image's left and top on the sensor, px, and its binning (0 means 1)."""
    return (
        int(info.roi.x_offset), int(info.roi.y_offset),
        max(1, int(info.binning_x)), max(1, int(info.binning_y)),
    )


def matrix_of(info: CameraInfo, name: str) -> Array:
    """Return ``d``, ``k``, ``r`` or ``p`` of a CameraInfo of ROS 1 or ROS 2, flat, row by row."""
    # In ROS 1 the names are in capitals.
    values = getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())
    return np.array(values, np.float64).ravel()


def _matrix(info: CameraInfo, name: str, side: str) -> Array:
    values = matrix_of(info, name)
    if not np.isfinite(values).all():
        raise InputError(
            f"{side} camera_info has {name.upper()} with values that are not finite: "
            "calibrate the camera and publish K, D, R and P"
        )
    return values
