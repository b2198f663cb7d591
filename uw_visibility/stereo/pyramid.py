# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image pyramid: downsampled images for matching, upsampled disparity."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.arrays import DisparityMap, Image, Points
from uw_visibility.images.cells import means
from uw_visibility.images.pair import MIN_HEIGHT, MIN_WIDTH, read_only
from uw_visibility.images.view import View
from uw_visibility.stereo.denoising import ROUNDING
from uw_visibility.stereo.rig import StereoRig

# Codes of 16 bits per code of 8 bits: white stays white.
_CODE_16_BIT = 257
# Largest difference of neighbouring disparities on one surface, px of the small image.
_SURFACE = np.float32(1)


class Pyramid:
    """Two-level image pyramid: reduces a pair, and brings its disparities back to full size.

    A pixel of the small images is the mean of a square of `factor` by `factor` pixels. Incomplete
    squares at the right and lower border are left out, and take their neighbours' values.

    shape, small: height and width of the images, and of the small ones, px.
    factor: 1 if the small images would be too small.
    """

    def __init__(self, factor: int, shape: tuple[int, int]) -> None:
        height, width = shape[0] // factor, shape[1] // factor
        self.factor = factor if height >= MIN_HEIGHT and width >= MIN_WIDTH else 1
        self.shape = shape
        self.small = shape[0] // self.factor, shape[1] // self.factor

    def downsample(self, image: Image) -> NDArray[Any]:
        """Return the small image, of the same type."""
        return image if self.factor == 1 else read_only(means(image, self.factor))

    def downsample_view(self, view: View) -> View:
        """Return the small view; all of its pixels are valid.

        A noisy view gets 16 bits, since means of noisy pixels are finer than 8 bits, and far away
        in turbid water all contrast is a code or two. Its noise is measured anew, and limited to
        the large view's over `factor`: detail of one pixel in the small view looks like noise.
        """
        if self.factor == 1:
            return view
        pixels, limit = view.pixels, view.low_frequency_noise / self.factor
        if pixels.dtype == np.uint8 and np.max(view.low_frequency_noise) > ROUNDING:
            pixels = np.multiply(pixels, np.uint16(_CODE_16_BIT), dtype=np.uint16)
            limit = _CODE_16_BIT * limit
        small = View.of(self.downsample(pixels), view.transfer).with_noise_below(limit)
        if np.any(view.low_frequency_noise > view.noise):
            # It cannot be measured in the small view, which does not show JPEG's blocks.
            small = replace(small, low_frequency_noise=limit)
        return small

    def rig(self, rig: StereoRig) -> StereoRig:
        """Return the geometry of the small images."""
        factor = self.factor

        def moved(point: tuple[float, float]) -> tuple[float, float]:
            # Pixel centres are whole numbers in both images.
            return (point[0] + 0.5) / factor - 0.5, (point[1] + 0.5) / factor - 0.5

        right, vertical = rig.principal_point_right, rig.focal_length_y
        return StereoRig(
            rig.focal_length / factor, rig.baseline, moved(rig.principal_point),
            None if right is None else moved(right),
            None if vertical is None else vertical / factor,
        )

    def settings(self, config: StereoConfig) -> StereoConfig:
        """Return the matcher's parameters for the small images.

        The least disparity is rounded down, to find the farthest surfaces: they would get a larger
        disparity instead.
        """
        return replace(
            config,
            min_disparity=config.min_disparity // self.factor,
            max_disparity=config.max_disparity // self.factor,
        )

    def downsample_points(self, points: Points) -> NDArray[np.float32]:
        """Return points (N, 3), column, row and disparity, px, as those of the small images."""
        return _scaled(points, 1.0 / self.factor)

    def upsample_points(self, points: Points) -> NDArray[np.float32]:
        """Return points (N, 3) of the small images, column, row and disparity, px, at full size."""
        return _scaled(points, self.factor)

    def upsample_disparity(self, small: DisparityMap) -> DisparityMap:
        """Upsample a disparity map (h, w) to full size, px; NaN where unmatched.

        Within a surface it is interpolated; across edges and beside unmatched pixels each pixel
        takes the value of its square.
        """
        if self.factor == 1:
            return small
        factor, (height, width) = self.factor, small.shape
        size = width * factor, height * factor
        full = cv2.resize(small, size, interpolation=cv2.INTER_NEAREST)
        smooth = cv2.resize(small, size, interpolation=cv2.INTER_LINEAR)
        # Each pixel lies between the centres of four small pixels.
        beside = np.pad(small, 1, mode="edge")
        corners = beside[:-1, :-1], beside[:-1, 1:], beside[1:, :-1], beside[1:, 1:]
        # False where one of them is NaN.
        even = np.maximum.reduce(corners) - np.minimum.reduce(corners) <= _SURFACE
        between = cv2.resize(
            even.astype(np.uint8), (size[0] + factor, size[1] + factor),
            interpolation=cv2.INTER_NEAREST)
        first = (factor + 1) // 2
        np.copyto(
            full, smooth,
            where=between[first : first + size[1], first : first + size[0]].view(np.bool_))
        full *= np.float32(factor)
        return self._pad(full)

    def upsample_confidence(
        self, small: NDArray[np.float32], disparity: DisparityMap
    ) -> NDArray[np.float32]:
        """Upsample confidences to the size of a disparity map; 0 where it is NaN."""
        return np.where(np.isnan(disparity), np.float32(0), self.repeat(small))

    def repeat(self, small: NDArray[Any]) -> NDArray[Any]:
        """Values of the squares of small pixels at full size."""
        return self._pad(small.repeat(self.factor, axis=0).repeat(self.factor, axis=1))

    def _pad(self, whole: NDArray[Any]) -> NDArray[Any]:
        """Add incomplete squares, which take their neighbours' values."""
        left_over = [(0, n - m) for n, m in zip(self.shape, whole.shape, strict=True)]
        return np.pad(whole, left_over, mode="edge") if any(map(any, left_over)) else whole


def _scaled(points: Points, scale: float) -> NDArray[np.float32]:
    # Pixel centres are whole numbers before and after.
    shift = np.array([0.5, 0.5, 0.0])
    return ((points + shift) * scale - shift).astype(np.float32)
