# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Geometry of a stereo rig: rays of pixels, disparity and range."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, DisparityMap, RangeMap
from uw_visibility.stereo.calibration import (
    CameraInfo,
    check_rectified,
    read_pair,
    read_projection,
)

# No camera's lengths, px or m, are beyond this, nor below its inverse. Messages hold them in
# 32 bit, and products of them must be finite.
LARGEST = 1e6

DISPARITY_STDDEV = 0.3
"""Standard deviation of a matched disparity, px."""


@dataclass(frozen=True)
class StereoRig:
    """Rectified pair of cameras.

    Parameters
    ----------
    focal_length : float
        Focal length of the rectified images, px.
    baseline : float
        Distance of the two cameras, m; positive.
    principal_point : tuple of float
        Principal point (cx, cy) of the left image, px.
    principal_point_right : tuple of float, optional
        That of the right image; the left one's where absent.
    focal_length_y : float, optional
        Vertical focal length, px, where pixels are not square.

    Raises
    ------
    InputError
        If a length is not positive, or a number is beyond what any camera has.
    """

    focal_length: float
    baseline: float
    principal_point: tuple[float, float]
    principal_point_right: tuple[float, float] | None = None
    focal_length_y: float | None = None

    def __post_init__(self) -> None:
        _check_positive("focal length", self.focal_length, "px")
        _check_positive("baseline", self.baseline, "m")
        if self.focal_length_y is not None:
            _check_positive("vertical focal length", self.focal_length_y, "px")
        _set_point(self, "principal_point", "principal point")
        if self.principal_point_right is not None:
            _set_point(self, "principal_point_right", "right principal point")

    @classmethod
    def from_camera_info(cls, left: CameraInfo, right: CameraInfo) -> StereoRig:
        """Take the rig from P of a pair of CameraInfo messages.

        Parameters
        ----------
        left, right : object
            CameraInfo of rclpy or rosbags, of ROS 1 or ROS 2. Region of
            interest and binning are taken into account.

        Returns
        -------
        StereoRig

        Raises
        ------
        InputError
            If a camera is not calibrated, the sizes differ, or P is not that
            of a rectified pair with the left camera at the origin.
        """
        calibrations = read_pair(left, right)
        return cls.from_projection(*(c.projection for c in calibrations))

    @classmethod
    def from_projection(cls, left: ArrayLike, right: ArrayLike) -> StereoRig:
        """Take the rig from the projection matrices P1 and P2 of a rectified pair.

        Parameters
        ----------
        left, right : array_like, (3, 4)
            Projection matrices; that of the right camera holds -f T in its
            fourth column.

        Returns
        -------
        StereoRig

        Raises
        ------
        InputError
            If a matrix has another form, or if the pair is not rectified.
        """
        p1, p2 = read_projection(left, "left"), read_projection(right, "right")
        check_rectified(p1, p2)
        square = math.isclose(p1[0, 0], p1[1, 1], rel_tol=1e-9)
        return cls(
            focal_length=float(p1[0, 0]),
            baseline=float(-p2[0, 3] / p2[0, 0]),
            principal_point=(float(p1[0, 2]), float(p1[1, 2])),
            principal_point_right=(float(p2[0, 2]), float(p2[1, 2])),
            focal_length_y=None if square else float(p1[1, 1]),
        )

    @property
    def offset(self) -> float:
        """Disparity of a point at infinity, cx of the left minus cx of the right camera, px."""
        right = self.principal_point_right or self.principal_point
        return self.principal_point[0] - right[0]

    def ray_lengths(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Length of each left pixel's ray up to unit depth.

        Parameters
        ----------
        shape : tuple of int
            Height and width of the image.

        Returns
        -------
        ndarray, (H, W) float32
            Read-only, and the same array for the same shape.
        """
        return _ray_lengths(self, (shape[0], shape[1]))

    def ray_directions(self, shape: tuple[int, ...]) -> Array:
        """Unit direction of each left pixel's ray: right, down, forward.

        Parameters
        ----------
        shape : tuple of int
            Height and width of the image.

        Returns
        -------
        ndarray, (H, W, 3) float64
        """
        return self.rays_at(np.arange(shape[1]), np.arange(shape[0]))

    def rays_at(self, columns: NDArray[Any], rows: NDArray[Any], *, right: bool = False) -> Array:
        """Unit direction of the rays through a grid of points: right, down, forward.

        Parameters
        ----------
        columns, rows : ndarray, (X,), (Y,)
            Points of the image, px.
        right : bool
            Whether of the right image.

        Returns
        -------
        ndarray, (Y, X, 3) float64
        """
        centre = self.principal_point_right if right else None
        cx, cy = centre or self.principal_point
        x = (columns - cx) / self.focal_length
        y = ((rows - cy) / (self.focal_length_y or self.focal_length))[:, np.newaxis]
        rays = np.stack(np.broadcast_arrays(x, y, 1.0), axis=2)
        return np.asarray(rays / np.sqrt(1.0 + x**2 + y**2)[..., np.newaxis])

    def _pinhole(self, shape: tuple[int, ...]) -> tuple[Array, Array]:
        """X of each column, (W,), and Y of each row, (H, 1), at unit depth."""
        x = (np.arange(shape[1], dtype=np.float64) - self.principal_point[0]) / self.focal_length
        focal_length_y = self.focal_length_y or self.focal_length
        y = (np.arange(shape[0], dtype=np.float64) - self.principal_point[1]) / focal_length_y
        return x, y[:, np.newaxis]

    def range_from_disparity(self, disparity: DisparityMap) -> DisparityMap:
        """Range along the line of sight, from x_left - x_right.

        Parameters
        ----------
        disparity : ndarray, (H, W) float32
            Disparity in the left image, px; NaN where unknown.

        Returns
        -------
        ndarray, (H, W) float32
            Range, m; NaN where the disparity is NaN, or not positive once
            the principal points' difference is taken off.
        """
        return self._range(disparity, math.nan)

    def range_of_filled(self, disparity: DisparityMap) -> RangeMap:
        """Range along the line of sight, from a disparity map without gaps.

        Parameters
        ----------
        disparity : ndarray, (H, W) float32
            Disparity in the left image, px.

        Returns
        -------
        ndarray, (H, W) float32
            Range, m; infinite where the disparity lies at or beyond infinity.
        """
        return self._range(disparity, math.inf)

    def _range(self, disparity: DisparityMap, beyond: float) -> NDArray[np.float32]:
        """Range, m; `beyond` where the disparity lies at or beyond infinity."""
        # A new array of one kind, whatever was given: each kind would compile the kernel anew.
        range_map = np.subtract(
            disparity, np.float32(self.offset), dtype=np.float32, order="C")
        _to_range(
            range_map, self.ray_lengths(range_map.shape),
            np.float32(self.focal_length * self.baseline), np.float32(beyond))
        return range_map

    def range_error(self, disparity_stddev: float = DISPARITY_STDDEV) -> float:
        """Standard deviation of range over its square, 1/m, for that of the disparity, px."""
        return disparity_stddev / (self.focal_length * self.baseline)

    def disparity_from_range(self, range_map: RangeMap) -> DisparityMap:
        """Disparity x_left - x_right, from range along the line of sight.

        Parameters
        ----------
        range_map : ndarray, (H, W) float32
            Range, m; NaN where unknown, inf for open water.

        Returns
        -------
        ndarray, (H, W) float32
            Disparity, px; NaN where the range is NaN or not positive.
        """
        known = np.array(range_map, np.float32)
        known[~(known > 0.0)] = np.nan
        scale = np.float32(self.focal_length * self.baseline)
        return self.ray_lengths(known.shape) * (scale / known) + np.float32(self.offset)


@njit(nogil=True, error_model="numpy")
def _to_range(values: Any, ray_lengths: Any, scale: Any, beyond: Any) -> None:
    """Turn disparities into ranges in place, in one pass and without further arrays."""
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            d = values[y, x]
            values[y, x] = (
                ray_lengths[y, x] * (scale / d) if d > 0
                else beyond if d > -np.inf else np.float32(np.nan))


def _check_positive(name: str, value: float, unit: str) -> None:
    if not 1.0 / LARGEST <= value <= LARGEST:
        raise InputError(
            f"{name} is {value:g} {unit}: give a positive number, up to {LARGEST:g}"
        )


def _set_point(rig: StereoRig, field: str, name: str) -> None:
    point = tuple(float(v) for v in getattr(rig, field))
    if len(point) != 2 or not all(abs(v) <= LARGEST for v in point):
        raise InputError(
            f"{name} is {point}: give two numbers of up to {LARGEST:g}, cx and cy in px"
        )
    object.__setattr__(rig, field, point)


# Full size, and those that the two steps match. An array of each calibration that was ever
# seen would be held for ever.
@functools.lru_cache(maxsize=3)
def _ray_lengths(rig: StereoRig, shape: tuple[int, int]) -> NDArray[np.float32]:
    x, y = rig._pinhole(shape)
    lengths = np.sqrt(1.0 + x**2 + y**2).astype(np.float32)
    lengths.flags.writeable = False
    return lengths
