# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense, edge-preserving disparity from a coarse map and the image (section II-E).

By a weighted guided filter on a pyramid of coarse grids. Guided filter: He, Sun and Tang,
doi 10.1109/TPAMI.2012.213; its coefficients on a coarse grid: He and Sun, arXiv 1505.00996;
filling from coarser scales where data are thin: Gortler et al., doi 10.1145/237170.237200
(push-pull).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement import guided_kernels as kernels
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import DisparityMap

# Pixels of the image per cell of the finest grid, in either direction.
CELL = 4
# Variance of position (px²) added to that of the data, so that data in one row, or
# one pixel, which have no slope across it, get none.
SLOPE_PRIOR = 1.0
NO_PLANE = (0.0, 0.0, 0.0)


class Level:
    """One grid of the pyramid, with its buffers.

    Attributes
    ----------
    guide : (h, w, 3) float32 ndarray
        Mean of the guide, centred on 0.
    value, weight : (h, w) float32 ndarray
        Disparity above the base plane, and its weight.
    place : (h, w, 2) float32 ndarray
        x and y, px, that `value` stands for; of the finest grid only.
    prior : (h, w) float32 ndarray
        What the next coarser level says about `value`.
    moments, solved : (h, n, w) float32 ndarray
        Sums along rows.
    coefficients : (h, 4, w) float32 ndarray
        Slopes for the three channels, offset.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        height, width = shape
        self.guide = np.empty((height, width, 3), np.float32)
        self.value = np.empty(shape, np.float32)
        self.weight = np.empty(shape, np.float32)
        self.prior = np.zeros(shape, np.float32)
        self.place = np.empty((height, width, 2), np.float32)
        self.moments = np.empty((height, kernels.MOMENTS, width), np.float32)
        self.solved = np.empty((height, kernels.SOLVED, width), np.float32)
        self.coefficients = np.empty((height, 4, width), np.float32)


class GuidedFilter:
    """Dense disparity from a coarse one and an image, for one size of image.

    Disparity is taken as a linear function of the image's colours within each
    window, over a plane fitted to all data. What has no data nearby follows
    the next coarser grid, up to the whole image. Holds its buffers: one call
    at a time.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the image.
    radius : int
        Half the width of the filter's windows, px.
    smoothness : float
        Regularisation ε of the slopes, variance of a guide of 0..1.
    workers : Workers
        Threads.
    """

    def __init__(
        self, shape: tuple[int, int], radius: int, smoothness: float, workers: Workers
    ) -> None:
        self.shape = shape
        self._radius = max(1, round(radius / CELL))
        self.smoothness = smoothness
        self._workers = workers
        size = (-(-shape[0] // CELL), -(-shape[1] // CELL))
        self.levels = [Level(size)]
        while max(size) > 2 * self._radius + 1:
            size = (-(-size[0] // 2), -(-size[1] // 2))
            self.levels.append(Level(size))
        self._extremes = np.empty((self.levels[0].value.shape[0], 2), np.float32)

    def run(
        self,
        coarse: DisparityMap,
        guide: NDArray[np.generic],
        disparity: DisparityMap,
    ) -> bool:
        """Filter ``coarse`` into ``disparity``.

        Parameters
        ----------
        coarse : (H, W) float32 ndarray
            Disparity, px; NaN where unknown.
        guide : (H, W, 3) ndarray of uint8 or uint16
            Image whose edges the result follows.
        disparity : (H, W) float32 ndarray
            Written: the dense map.

        Returns
        -------
        bool
            Whether there was any disparity to start from; without, nothing is written.
        """
        low, high = self.reduce(coarse, guide)
        if not low <= high:
            return False
        finest = self.levels[0]
        plane = kernels.fit_plane(finest.value, finest.weight, finest.place, SLOPE_PRIOR)
        kernels.subtract_plane(finest.value, finest.weight, finest.place, plane)
        self._fill()
        self.apply(guide, plane, (low, high), disparity)
        return True

    def reduce(self, coarse: DisparityMap, guide: NDArray[np.generic]) -> tuple[float, float]:
        """Average the input over the cells of the finest grid.

        Returns
        -------
        low, high : float
            Extremes of the disparities that count; inf and -inf without any.
        """
        finest = self.levels[0]
        self._workers.rows(
            kernels.reduce_image, finest.value.shape[0], coarse, guide,
            _scale(guide), CELL, finest.guide, finest.value, finest.weight, finest.place,
            self._extremes,
        )
        return float(self._extremes[:, 0].min()), float(self._extremes[:, 1].max())

    def _fill(self) -> None:
        for fine, small in zip(self.levels[:-1], self.levels[1:], strict=True):
            kernels.pull(
                fine.guide, fine.value, fine.weight, small.guide, small.value, small.weight
            )
        for fine, small in zip(self.levels[-2::-1], self.levels[:0:-1], strict=True):
            self._regress(small, self._radius, _at_once)
            kernels.apply_coefficients(
                0, fine.value.shape[0], small.coefficients, fine.guide,
                np.float32(1), np.float32(0), 2, NO_PLANE,
                np.float32(-math.inf), np.float32(math.inf), fine.prior,
            )
        self.regress()

    def regress(self, radius: int | None = None) -> None:
        """Regress the finest grid's `value` on its guide, over windows of `radius` cells."""
        self._regress(self.levels[0], radius or self._radius, self._workers.rows)

    def apply(
        self,
        guide: NDArray[np.generic],
        plane: tuple[float, float, float],
        limits: tuple[float, float],
        disparity: DisparityMap,
    ) -> None:
        """Evaluate the finest grid's coefficients on the image itself."""
        self._workers.rows(
            kernels.apply_coefficients, self.shape[0], self.levels[0].coefficients, guide,
            _scale(guide), np.float32(0.5), CELL, plane,
            np.float32(limits[0]), np.float32(limits[1]), disparity,
        )

    def _regress(self, level: Level, radius: int, rows: Callable[..., None]) -> None:
        height = level.value.shape[0]
        rows(
            kernels.moments, height,
            level.guide, level.value, level.weight, level.prior, radius, level.moments,
        )
        rows(kernels.solve, height, level.moments, radius, self.smoothness, level.solved)
        rows(kernels.average, height, level.solved, radius, level.coefficients)


def _at_once(kernel: Callable[..., None], count: int, *arguments: object) -> None:
    """Run a kernel over all rows in this thread: small grids are not worth a second one."""
    kernel(0, count, *arguments)


def _scale(guide: NDArray[np.generic]) -> np.float32:
    return np.float32(1 / (255 if guide.dtype == np.uint8 else 65535))


class Matting:
    """Matting of coarse disparity maps: refined against the image and extended to all pixels.

    Keeps its buffers for the last size of image: one call at a time.

    Parameters
    ----------
    config : EnhancementConfig
        `matting_radius` and `matting_smoothness` tell the filter's reach.
    workers : Workers, optional
        Threads; one by default.
    """

    def __init__(
        self, config: EnhancementConfig | None = None, workers: Workers | None = None
    ) -> None:
        self._config = config or EnhancementConfig()
        self._workers = workers or Workers(1)
        self._filter: GuidedFilter | None = None

    def refine(self, coarse: DisparityMap, guide: NDArray[np.generic]) -> NDArray[np.float32]:
        """Refine a coarse disparity map, and make it dense.

        Parameters
        ----------
        coarse : (H, W) float32 ndarray
            Disparity, px; NaN where unknown. A mesh or single points.
        guide : (H, W, 3) or (H, W) ndarray of uint8 or uint16
            Image of the same view.

        Returns
        -------
        (H, W) float32 ndarray
            Disparity, px, between the smallest and the largest given; NaN everywhere where
            there is none.

        Raises
        ------
        InputError
            If the shapes differ or the guide is neither 8- nor 16-bit.
        """
        image = _colour(guide)
        if image.shape[:2] != coarse.shape:
            raise InputError(
                f"image of {image.shape[1]}x{image.shape[0]} px does not fit a disparity map of "
                f"{coarse.shape[1]}x{coarse.shape[0]} px: give both of the same view"
            )
        disparity = np.full(coarse.shape, np.nan, np.float32)
        self._filter_for(coarse.shape).run(coarse, image, disparity)
        return disparity

    def _filter_for(self, shape: tuple[int, ...]) -> GuidedFilter:
        size = (shape[0], shape[1])
        if self._filter is None or self._filter.shape != size:
            self._filter = GuidedFilter(
                size, self._config.matting_radius, self._config.matting_smoothness, self._workers
            )
        return self._filter


def _colour(guide: NDArray[np.generic]) -> NDArray[np.generic]:
    if guide.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise InputError(f"image of type {guide.dtype} cannot guide matting: give 8 or 16 bit")
    if guide.ndim == 2:
        return np.broadcast_to(guide[:, :, np.newaxis], (*guide.shape, 3))
    return guide
