# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Geometry of a stereo rig: rays of pixels, disparity and range."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, DisparityMap, RangeMap
from uw_visibility.stereo.calibration import CameraInfo, check_rectified, read_pair, read_projection

# Largest length of a camera, px or m; the smallest is its inverse. Messages hold lengths in 32
# bits, and their products must be finite.
LARGEST = 1e6

# Tangent of 85 degrees: a rectified image does not show as much beside its principal point. A
# smaller focal length is probably in mm.
WIDEST = 11.4
# Largest baseline, m; a larger number is probably in mm.
LARGEST_BASELINE = 10.0
# Smallest baseline, m; no lenses are closer. A smaller number is probably over the focal length.
SMALLEST_BASELINE = 0.001

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
        Principal point of the right image, px; by default that of the left one.
    focal_length_y : float, optional
        Vertical focal length, px, if pixels are not square.

    Raises
    ------
    InputError
        If a length is not a positive number, or a number is too large for a camera.
    """

    focal_length: float
    baseline: float
    principal_point: tuple[float, float]
    principal_point_right: tuple[float, float] | None = None
    focal_length_y: float | None = None

    def __post_init__(self) -> None:
        _check_positive("focal length", self.focal_length, "px")
        _check_positive("baseline", self.baseline, "m")
        if self.baseline > LARGEST_BASELINE:
            raise InputError(
                f"baseline is {self.baseline:g} m, probably {self.baseline:g} mm: give it in m, up "
                f"to {LARGEST_BASELINE:g}"
            )
        if self.baseline < SMALLEST_BASELINE:
            raise InputError(
                f"baseline is {self.baseline:g} m, too small for two cameras: give it in m; "
                "P[0, 3] of the right camera is -f * baseline, f in px"
            )
        if self.focal_length_y is not None:
            _check_positive("vertical focal length", self.focal_length_y, "px")
        _set_point(self, "principal_point", "principal point")
        if self.principal_point[0] > WIDEST * self.focal_length:
            raise InputError(
                f"focal length is {self.focal_length:g} px, probably {self.focal_length:g} mm: "
                "give it in px, which is that in mm over the width of a pixel in mm")
        if self.principal_point_right is not None:
            _set_point(self, "principal_point_right", "right principal point")

    @classmethod
    def from_camera_info(cls, left: CameraInfo, right: CameraInfo) -> StereoRig:
        """Make the rig from P of a pair of CameraInfo messages.

        Parameters
        ----------
        left, right : object
            CameraInfo of rclpy or rosbags, of ROS 1 or ROS 2. Region of interest and binning are
            applied.

        Raises
        ------
        InputError
            If a camera is not calibrated, the image sizes differ, or P is not that of a rectified
            pair with the left camera at the origin.
        """
        calibrations = read_pair(left, right)
        return cls.from_projection(*(c.projection for c in calibrations))

    @classmethod
    def from_projection(cls, left: ArrayLike, right: ArrayLike) -> StereoRig:
        """Make the rig from the projection matrices P1 and P2 of a rectified pair.

        Parameters
        ----------
        left, right : (3, 4) array_like
            Projection matrices; that of the right camera holds -f T in its fourth column.

        Raises
        ------
        InputError
            If a matrix is not a (3, 4) projection matrix, or the pair is not rectified.
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
        """Length of each left pixel's ray up to unit depth, (H, W) float32, read-only."""
        return _ray_lengths(self, (shape[0], shape[1]))

    def ray_directions(self, shape: tuple[int, ...]) -> Array:
        """Unit direction of each left pixel's ray, (H, W, 3): right, down, forward."""
        return self.rays_at(np.arange(shape[1]), np.arange(shape[0]))

    def rays_at(self, columns: NDArray[Any], rows: NDArray[Any], *, right: bool = False) -> Array:
        """Unit direction (Y, X, 3) of the rays through a grid of columns (X,) and rows (Y,), px."""
        x, y = self._at_unit_depth(columns, rows, right)
        rays = np.stack(np.broadcast_arrays(x, y, 1.0), axis=2)
        return np.asarray(rays / np.sqrt(1.0 + x**2 + y**2)[..., np.newaxis])

    def _at_unit_depth(
        self, columns: NDArray[Any], rows: NDArray[Any], right: bool
    ) -> tuple[Array, Array]:
        """X of columns, (X,), and Y of rows, (Y, 1), at unit depth."""
        centre = self.principal_point_right if right else None
        cx, cy = centre or self.principal_point
        y = (rows - cy) / (self.focal_length_y or self.focal_length)
        return (columns - cx) / self.focal_length, y[:, np.newaxis]

    def range_from_disparity(self, disparity: DisparityMap) -> DisparityMap:
        """Range along the line of sight, from x_left - x_right.

        Parameters
        ----------
        disparity : (H, W) float32 ndarray
            Disparity in the left image, px; NaN where unknown.

        Returns
        -------
        (H, W) float32 ndarray
            Range, m; NaN where the disparity is NaN, or not larger than `offset`.
        """
        return self._range(disparity, math.nan)

    def range_of_filled(self, disparity: DisparityMap) -> RangeMap:
        """Range, m, of a disparity map without gaps; infinite where it is at most `offset`."""
        return self._range(disparity, math.inf)

    def _range(self, disparity: DisparityMap, beyond: float) -> NDArray[np.float32]:
        """Range, m; `beyond` where the disparity is at most that of a point at infinity."""
        # Always float32 in C order: the kernel would be compiled anew for each other kind of array.
        range_map = np.subtract(disparity, np.float32(self.offset), dtype=np.float32, order="C")
        _to_range(
            range_map, self.ray_lengths(range_map.shape),
            np.float32(self.focal_length * self.baseline), np.float32(beyond))
        return range_map

    def range_error(self, disparity_stddev: float = DISPARITY_STDDEV) -> float:
        """Standard deviation of range over squared range, 1/m, from that of the disparity, px."""
        return disparity_stddev / (self.focal_length * self.baseline)

    def disparity_from_range(self, range_map: RangeMap) -> DisparityMap:
        """Disparity x_left - x_right, from range along the line of sight.

        Parameters
        ----------
        range_map : (H, W) float32 ndarray
            Range, m; NaN where unknown, inf for open water.

        Returns
        -------
        (H, W) float32 ndarray
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
    if not _is_number(value) or not 1.0 / LARGEST <= value <= LARGEST:
        raise InputError(
            f"{name} is {_shown(value)} {unit}: give a positive number, up to {LARGEST:g}"
        )


def _set_point(rig: StereoRig, field: str, name: str) -> None:
    given = getattr(rig, field)
    try:
        point = tuple(given)
    except TypeError:
        point = ()
    if len(point) != 2 or not all(_is_number(v) and abs(v) <= LARGEST for v in point):
        raise InputError(
            f"{name} is {_shown(given)}: give two numbers of up to {LARGEST:g}, cx and cy in px"
        )
    object.__setattr__(rig, field, tuple(float(v) for v in point))


def _is_number(value: object) -> bool:
    """Whether a value is a single real number, and not a string, bool or array."""
    return isinstance(value, Real) and not isinstance(value, (bool, np.bool_))


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else repr(value)


# Sizes: full, and those that the two steps match. Without a limit, arrays of all earlier
# calibrations would be kept.
@functools.lru_cache(maxsize=3)
def _ray_lengths(rig: StereoRig, shape: tuple[int, int]) -> NDArray[np.float32]:
    x, y = rig._at_unit_depth(np.arange(shape[1]), np.arange(shape[0]), False)
    lengths = np.sqrt(1.0 + x**2 + y**2).astype(np.float32)
    lengths.flags.writeable = False
    return lengths
