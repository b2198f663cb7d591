# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense, edge-preserving disparity from a coarse map and the image (section II-E)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.guided_filter import GuidedFilter
from uw_visibility.errors import InputError


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

    def refine(
        self, coarse: NDArray[np.float32], guide: NDArray[np.generic]
    ) -> NDArray[np.float32]:
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
