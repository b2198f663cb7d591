# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images made smaller for matching, and their disparity brought back to full size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.config import StereoConfig
from uw_visibility.kernel_cache import njit
from uw_visibility.pair import MIN_HEIGHT, MIN_WIDTH, read_only
from uw_visibility.parallel import Workers
from uw_visibility.stereo.rig import StereoRig


class Reduction:
    """Takes a pair to a fraction of its size and disparities back.

    A pixel of the small images is the mean of a square of pixels. What does not fill
    a square at the right and lower border is left out of them, and its disparity is
    that of its neighbours.

    Parameters
    ----------
    factor : int
        Side of the squares, px; 1 leaves everything as it is.
    workers : Workers
        Threads.
    """

    def __init__(self, factor: int, workers: Workers) -> None:
        self._factor = factor
        self._workers = workers

    def factor(self, shape: tuple[int, ...]) -> int:
        """Return the factor for a size of image: 1 where the small one would be too small."""
        height, width = shape[0] // self._factor, shape[1] // self._factor
        return self._factor if height >= MIN_HEIGHT and width >= MIN_WIDTH else 1

    def shape(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Return height and width of the small images, px."""
        factor = self.factor(shape)
        return shape[0] // factor, shape[1] // factor

    def image(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the small image, of the same type."""
        factor = self.factor(image.shape)
        if factor == 1:
            return image
        height, width = self.shape(image.shape)
        whole = image[: height * factor, : width * factor]
        return read_only(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))

    def mask(self, mask: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        """Return which of the small pixels have all of theirs in a mask."""
        if mask is None or self.factor(mask.shape) == 1:
            return mask
        factor = self.factor(mask.shape)
        height, width = self.shape(mask.shape)
        squares = mask[: height * factor, : width * factor]
        return np.asarray(squares.reshape(height, factor, width, factor).all(axis=(1, 3)))

    def whole_mask(
        self, mask: NDArray[np.bool_] | None, shape: tuple[int, ...]
    ) -> NDArray[np.bool_] | None:
        """Return which pixels of the full size have their small one in a mask."""
        factor = self.factor(shape)
        if mask is None or factor == 1:
            return mask
        whole = np.zeros(shape[:2], bool)
        height, width = mask.shape[0] * factor, mask.shape[1] * factor
        whole[:height, :width] = mask.repeat(factor, axis=0).repeat(factor, axis=1)
        return whole

    def rig(self, rig: StereoRig, shape: tuple[int, ...]) -> StereoRig:
        """Return the geometry of the small images of a pair of a size."""
        factor = self.factor(shape)

        def moved(point: tuple[float, float]) -> tuple[float, float]:
            # Pixel centres are whole numbers in both images.
            return (point[0] + 0.5) / factor - 0.5, (point[1] + 0.5) / factor - 0.5

        right = rig.principal_point_right
        return StereoRig(
            rig.focal_length / factor, rig.baseline, moved(rig.principal_point),
            None if right is None else moved(right),
        )

    def settings(self, config: StereoConfig, shape: tuple[int, ...]) -> StereoConfig:
        """Return the matcher's parameters for the small images of a pair of a size."""
        factor = self.factor(shape)
        return replace(
            config,
            min_disparity=-(-config.min_disparity // factor),
            max_disparity=config.max_disparity // factor,
        )

    def disparity(
        self, small: NDArray[np.float32], shape: tuple[int, ...]
    ) -> NDArray[np.float32]:
        """Bring a disparity map to full size, in pixels of the full size.

        On a surface it is interpolated; across edges and beside unmatched pixels each
        pixel takes its square's.

        Parameters
        ----------
        small : ndarray
            ``(h, w)`` float32, px of the small images; NaN where unmatched.
        shape : tuple of int
            Height and width of the full images, px.

        Returns
        -------
        ndarray
            ``(H, W)`` float32, px; NaN where unmatched.
        """
        factor = self.factor(shape)
        if factor == 1:
            return small
        full = np.empty(shape[:2], np.float32)
        self._workers.rows(_enlarge, shape[0], small, factor, full)
        return full

    def confidence(
        self, small: NDArray[np.float32], disparity: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Bring confidences to the full size of the disparities made from the same pixels."""
        height, width = disparity.shape
        full = cv2.resize(small, (width, height), interpolation=cv2.INTER_NEAREST)
        full[np.isnan(disparity)] = 0
        return np.asarray(full, np.float32)


@njit(nogil=True)
def _enlarge(start: int, stop: int, small: Any, factor: int, full: Any) -> None:
    height, width = small.shape
    scale = np.float32(factor)
    half = np.float32(0.5)
    # Neighbours that differ by more, in small pixels, are two surfaces.
    edge = np.float32(1)
    for y in range(start, stop):
        v = (np.float32(y) + half) / scale - half
        above = min(max(np.int64(np.floor(v)), 0), height - 1)
        below = min(above + 1, height - 1)
        t = min(max(v - np.float32(above), np.float32(0)), np.float32(1))
        row = min(y // factor, height - 1)
        for x in range(full.shape[1]):
            u = (np.float32(x) + half) / scale - half
            before = min(max(np.int64(np.floor(u)), 0), width - 1)
            after = min(before + 1, width - 1)
            s = min(max(u - np.float32(before), np.float32(0)), np.float32(1))
            a, b = small[above, before], small[above, after]
            c, d = small[below, before], small[below, after]
            # False where one of them is not a number.
            if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) <= edge and (
                a == a and b == b and c == c and d == d
            ):
                upper = a + s * (b - a)
                value = upper + t * (c + s * (d - c) - upper)
            else:
                value = small[row, min(x // factor, width - 1)]
            full[y, x] = scale * value
