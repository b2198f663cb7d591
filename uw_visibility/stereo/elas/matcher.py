# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The stereo matcher: one object that takes a pair of grey images through ELAS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config import StereoConfig
from uw_visibility.parallel import Workers
from uw_visibility.stereo.contrast import EvenContrast
from uw_visibility.stereo.elas import dense, mesh, postprocess
from uw_visibility.stereo.elas.dense import CellCandidates, DenseSettings
from uw_visibility.stereo.elas.descriptors import Descriptors
from uw_visibility.stereo.elas.evidence import NoiseFilter
from uw_visibility.stereo.elas.smoothing import AdaptiveMean
from uw_visibility.stereo.elas.support import SupportGrid, SupportPoints, SupportSettings

# Disparities move to the left from the left to the right view.
_SIGNS = (1, -1)


@dataclass(frozen=True)
class DenseMatch:
    """Disparities of a pair.

    Attributes
    ----------
    left, right : ndarray
        ``(H, W)`` float32, disparity at the pixels of either view, px; NaN
        where unmatched.
    left_unchecked, right_unchecked : ndarray or None
        The same before the views were compared, whole pixels. They tell
        occlusions from mismatches.
    """

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    left_unchecked: NDArray[np.float32] | None = None
    right_unchecked: NDArray[np.float32] | None = None


class Matcher:
    """ELAS (Geiger, Roser and Urtasun, ACCV 2010), in memory that is allocated once.

    The steps are separate calls, in this order: `describe`, `support_points`,
    `coarse_disparity` (enough for the first estimate of the water), `dense_disparity`.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    disparities : tuple of int
        Smallest and largest disparity, inclusive, px.
    config : StereoConfig
        Thresholds and weights.
    workers : Workers
        Threads.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        disparities: tuple[int, int],
        config: StereoConfig,
        workers: Workers,
    ) -> None:
        self._shape = shape
        self._disparities = disparities
        self._config = config
        self._workers = workers
        self._views = (Descriptors(shape), Descriptors(shape))
        self._support = SupportGrid(
            shape,
            SupportSettings(
                step=config.support_step,
                texture=config.support_texture,
                uniqueness=config.support_uniqueness,
                consistency_cells=config.consistency_cells,
                consistency_disparity=config.consistency_disparity,
                consistency_count=config.consistency_count,
            ),
        )
        self._dense_settings = DenseSettings(
            likelihood=config.likelihood_weight,
            plane_radius=config.plane_radius,
            plane_deviation=config.plane_deviation,
            outlier=config.prior_outlier,
        )
        self._planes = np.empty((2, *shape), np.float32)
        self._candidates = tuple(CellCandidates(shape, disparities[1] + 2) for _ in range(2))
        self._best = np.empty((2, *shape), np.int16)
        self._noise = NoiseFilter(shape, config.noise_ratio)
        self._segments = postprocess.SegmentFilter(shape)
        self._mean = AdaptiveMean(shape, config.smoothing_radius, config.smoothing_difference)

    def describe(self, left: EvenContrast, right: EvenContrast) -> None:
        """Compute the descriptors of a pair."""
        for view, image in zip(self._views, (left, right), strict=True):
            view.compute(image.grey, image.gain, self._workers)

    def support_points(self) -> SupportPoints:
        """Find the support points of the described pair."""
        return self._support.search(
            self._views[0].values, self._views[1].values, self._disparities, self._workers
        )

    def exchanged_ratio(self) -> float:
        """Matches of the described pair with its images exchanged, over those in order."""
        return self._support.exchanged_ratio(
            self._views[0].values, self._views[1].values, self._disparities, self._workers
        )

    def coarse_disparity(self, support: SupportPoints) -> DenseMatch:
        """Return the mesh of the support points as an image of either view.

        Parameters
        ----------
        support : SupportPoints
            From `support_points`.

        Returns
        -------
        DenseMatch
            NaN outside the mesh.
        """
        vertices = support.points[support.vertices]
        coarse = np.empty((2, *self._shape), np.float32)
        self._workers.together(
            lambda: self._rasterize(vertices, coarse[0]),
            lambda: self._rasterize(mesh.in_right_view(vertices), coarse[1]),
        )
        return DenseMatch(coarse[0], coarse[1])

    def dense_disparity(self, support: SupportPoints) -> DenseMatch:
        """Match every pixel of the described pair.

        Parameters
        ----------
        support : SupportPoints
            From `support_points`.

        Returns
        -------
        DenseMatch
        """
        disparity = np.full((2, *self._shape), np.nan, np.float32)
        self._best[:] = -1
        if len(support) > 0:
            vertices = support.points[support.vertices]
            self._workers.together(
                lambda: self._prepare(0, support.points, vertices),
                lambda: self._prepare(
                    1, mesh.in_right_view(support.points), mesh.in_right_view(vertices)
                ),
            )
            for view, sign in enumerate(_SIGNS):
                dense.match(
                    self._views[view].values, self._views[1 - view].values, sign,
                    self._planes[view], self._candidates[view], self._disparities,
                    self._dense_settings, self._best[view], self._workers,
                )
            for view, sign in enumerate(_SIGNS):
                self._postprocess(view, sign, disparity[view])
        unchecked = self._best.astype(np.float32)
        unchecked[unchecked < 0] = np.nan
        return DenseMatch(disparity[0], disparity[1], unchecked[0], unchecked[1])

    def _prepare(
        self, view: int, points: NDArray[np.float32], vertices: NDArray[np.float32]
    ) -> None:
        """Candidates and plane of one view."""
        self._candidates[view].fill(points)
        self._rasterize(mesh.with_corners(vertices, self._shape), self._planes[view])

    def _rasterize(self, vertices: NDArray[np.float32], disparity: NDArray[np.float32]) -> None:
        # One thread a view: this runs inside of the pool already.
        mesh.rasterize(mesh.triangulate(vertices, self._shape), disparity, Workers(1))

    def _postprocess(self, view: int, sign: int, disparity: NDArray[np.float32]) -> None:
        config = self._config
        postprocess.check_and_refine(
            (self._best[view], self._best[1 - view]),
            (self._views[view].values, self._views[1 - view].values),
            sign, config.left_right_tolerance, disparity, self._workers,
        )
        self._noise.remove(
            self._views[view].values, self._views[1 - view].values, sign, disparity, self._workers
        )
        self._segments.remove(disparity, config.segment_size, config.segment_difference)
        postprocess.fill_small_gaps(
            disparity, config.gap_width, config.gap_difference, self._workers
        )
        self._mean.smooth(disparity, self._workers)
