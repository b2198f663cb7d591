# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense, edge-preserving disparity from a coarse map and the image (section II-E)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.guided_filter import GuidedFilter
from uw_visibility.errors import InputError


@dataclass(frozen=True)
class Matte:
    """Dense disparity map with confidence.

    Attributes
    ----------
    disparity : (H, W) float32 ndarray
        px; finite everywhere where `ok`, else NaN everywhere.
    confidence : (H, W) float32 ndarray
        0..1: how much of it rests on disparities nearby, and how sure those were.
    ok : bool
        Whether there was any disparity to start from.
    """

    disparity: NDArray[np.float32]
    confidence: NDArray[np.float32]
    ok: bool


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
        self,
        coarse: NDArray[np.float32],
        confidence: NDArray[np.float32] | None,
        guide: NDArray[np.generic],
    ) -> Matte:
        """Refine a coarse disparity map, and make it dense.

        Parameters
        ----------
        coarse : (H, W) float32 ndarray
            Disparity, px; NaN where unknown. A mesh or single points.
        confidence : (H, W) float32 ndarray or None
            Weight of each, 0..1; None gives all the same. 0 leaves a pixel out.
        guide : (H, W, 3) or (H, W) ndarray of uint8 or uint16
            Image of the same view.

        Returns
        -------
        Matte
            Values lie between the smallest and the largest given.

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
        if confidence is None:
            confidence = np.ones(coarse.shape, np.float32)
        guided = self._filter_for(coarse.shape)
        disparity = np.empty(coarse.shape, np.float32)
        dense_confidence = np.empty(coarse.shape, np.float32)
        ok = guided.run(coarse, confidence, image, disparity, dense_confidence)
        if not ok:
            disparity[:] = np.nan
            dense_confidence[:] = 0
        return Matte(disparity, dense_confidence, ok)

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
