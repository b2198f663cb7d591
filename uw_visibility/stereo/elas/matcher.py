# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo matcher: takes a pair of grey images through the stages of ELAS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.arrays import Array, DisparityMap
from uw_visibility.images.view import View
from uw_visibility.stereo.airlight import AirlightPrior
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.denoising import LEAST_NOISE
from uw_visibility.stereo.elas import dense, mesh, postprocess
from uw_visibility.stereo.elas.confidence import rate
from uw_visibility.stereo.elas.confidence_in_noise import drop_doubtful, rate_in_noise
from uw_visibility.stereo.elas.dense import DenseSearch, DenseSettings
from uw_visibility.stereo.elas.descriptors import SCALE, Descriptors
from uw_visibility.stereo.elas.edges import EdgeVote
from uw_visibility.stereo.elas.evidence import CELL, NoiseFilter
from uw_visibility.stereo.elas.noise_settings import (
    CONFIDENCE_FOR_COLOUR,
    NOISE_RADIUS,
    least_confidence,
    settings_in_noise,
)
from uw_visibility.stereo.elas.semi_global import SemiGlobalSearch, compare_tones
from uw_visibility.stereo.elas.smoothing import AdaptiveMean
from uw_visibility.stereo.elas.support import SupportGrid, SupportPoints, SupportSettings


@dataclass(frozen=True)
class DenseMatch:
    """Disparities of a pair.

    Attributes
    ----------
    disparity : ndarray
        ``(H, W)`` float32, left-referenced, px; NaN where unmatched.
    right : ndarray
        ``(H, W)`` float32, what each pixel of the right view matches best, whole
        px, before the views are compared; NaN where nothing was tried. It tells
        occlusions from mismatches.
    confidence : ndarray or None
        ``(H, W)`` float32, probability that `disparity` is within 1 px of the truth;
        0 where unmatched; None where not asked for.
    with_occlusions : ndarray or None
        ``(H, W)`` float32, `disparity` and that of what something nearer hides from the
        right view, which is taken from its surroundings: no match, but good for colour;
        None for the same as `disparity`.
    """

    disparity: DisparityMap
    right: NDArray[np.float32]
    confidence: NDArray[np.float32] | None
    with_occlusions: DisparityMap | None = None


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
        settings = DenseSettings(
            plane_radius=config.plane_radius,
            plane_deviation=config.plane_deviation,
            outlier=config.prior_outlier,
            airlight=config.airlight_prior,
        )
        self._plane = np.empty(shape, np.float32)
        self._steep = np.empty(shape, np.bool_)
        self._search = DenseSearch(shape, disparities, settings, workers)
        self._search_in_noise = SemiGlobalSearch(shape, disparities, settings, workers)
        self._noise = NoiseFilter(shape, config.noise_ratio)
        self._segments = postprocess.SegmentFilter(shape)
        self._edges = EdgeVote(shape)
        self._left: ContrastNormalizer | None = None
        self._right: ContrastNormalizer | None = None
        self._mean = AdaptiveMean(shape, config.smoothing_difference)

    def describe(self, left: ContrastNormalizer, right: ContrastNormalizer) -> None:
        """Compute the descriptors of a pair, which is not changed until it is matched."""
        self._workers.together(
            lambda: self.describe_view(0, left), lambda: self.describe_view(1, right)
        )

    def describe_view(self, side: int, image: ContrastNormalizer) -> None:
        """Compute the descriptors of one view of a pair: 0 is the left one, 1 the right."""
        if side == 0:
            self._left = image
        else:
            self._right = image
        self._views[side].compute(image.grey, image.gain, self._workers)

    def describe_raw(
        self, contrast: tuple[ContrastNormalizer, ContrastNormalizer], left: View, right: View
    ) -> None:
        """Compute the descriptors of a pair as it is, its contrast stretched.

        Parameters
        ----------
        contrast : tuple of ContrastNormalizer
            Of the left and of the right view; overwritten, and used until the pair is
            matched.
        left, right : View
            The pair.
        """

        def describe(side: int, view: View) -> None:
            contrast[side].stretch(view.pixels, self._workers, view.low_frequency_noise)
            self.describe_view(side, contrast[side])

        self._workers.together(lambda: describe(0, left), lambda: describe(1, right))

    def support_points(
        self,
        airlight: AirlightPrior | None = None,
        earlier: NDArray[np.float32] | None = None,
    ) -> SupportPoints:
        """Find the support points of the described pair; see `SupportGrid.search`."""
        return self._support.search(
            self._views[0].values, self._views[1].values, self._disparities, self._workers,
            airlight, earlier, self._noise_of_grid(),
        )

    def swapped_ratio(self) -> float:
        """Matches of the described pair with its images exchanged, over those in order."""
        return self._support.swapped_ratio(
            self._views[0].values, self._views[1].values, self._disparities, self._workers
        )

    def coarse_disparity(self, support: SupportPoints) -> DisparityMap:
        """Return the mesh of the support points as an image.

        Parameters
        ----------
        support : SupportPoints
            From `support_points`.

        Returns
        -------
        ndarray
            ``(H, W)`` float32, left-referenced, px; NaN outside the mesh.
        """
        coarse = np.empty(self._shape, np.float32)
        vertices = support.points[support.vertices]
        mesh.rasterize(mesh.triangulate(vertices, self._shape), coarse, self._workers)
        return coarse

    def dense_disparity(
        self,
        support: SupportPoints,
        airlight: AirlightPrior | None = None,
        *,
        confidence: bool = True,
        least_for_colour: float = 0.0,
    ) -> DenseMatch:
        """Match every pixel of the described pair.

        Parameters
        ----------
        support : SupportPoints
            From `support_points`.
        airlight : AirlightPrior, optional
            What decides where texture does not.
        confidence : bool
            Whether to rate the matches.
        least_for_colour : float
            Least confidence of what stays in `DenseMatch.with_occlusions`, where matches are
            rated. What noise makes doubtful is no match, but still a guess for colour.

        Returns
        -------
        DenseMatch
        """
        disparity = np.full(self._shape, np.nan, np.float32)
        if len(support) == 0:
            nowhere = np.zeros(self._shape, np.float32) if confidence else None
            return DenseMatch(disparity, disparity.copy(), nowhere)
        descriptors = (self._views[0].values, self._views[1].values)
        config = self._settings()
        self._find_best(config, descriptors, support, airlight, disparity)
        self._postprocess(config, descriptors, disparity)
        with_occlusions = disparity.copy()
        postprocess.remove_occluded(disparity, self._workers)
        best_right = self._search.best[1]
        right = np.empty(self._shape, np.float32)
        self._workers.rows(dense.as_disparity, self._shape[0], best_right, right)
        asked = self._config.min_confidence
        least = 0.0 if self._left is None else least_confidence(self._left.noise)
        rated = None
        if confidence or asked > 0 or least > 0:
            rated = self._rate(disparity, best_right, descriptors)
            for_colour = max(asked, least_for_colour, min(least, CONFIDENCE_FOR_COLOUR))
            if for_colour > 0:
                with_occlusions[(rated > 0) & (rated < for_colour)] = np.nan
            if least > 0:
                drop_doubtful(disparity, rated, least, self._workers)
            if least > 0 or asked > 0:
                disparity[rated < asked] = np.nan
                rated[np.isnan(disparity)] = 0.0
        return DenseMatch(disparity, right, rated, with_occlusions)

    def _find_best(
        self,
        config: StereoConfig,
        descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
        support: SupportPoints,
        airlight: AirlightPrior | None,
        disparity: DisparityMap,
    ) -> None:
        """Write the disparities that both views agree on, at sub-pixel resolution."""
        best, tolerance = self._search.best, config.left_right_tolerance
        if self._left is not None and self._right is not None and self._is_noisy():
            self._draw_mesh(support)
            self._search_in_noise.search(
                descriptors, compare_tones(self._left, self._right, support.points),
                support.points, self._left.noise, self._plane, self._steep,
                config.likelihood_weight, best, disparity)
            postprocess.check(best, tolerance, disparity, self._workers)
            return
        self._workers.together(
            lambda: self._draw_mesh(support),
            lambda: self._search.try_candidates(descriptors, support.points, airlight),
        )
        self._search.try_plane(
            descriptors, self._plane, self._steep, config.likelihood_weight, airlight
        )
        postprocess.check_and_refine(best, descriptors, tolerance, disparity, self._workers)

    def _is_noisy(self) -> bool:
        return self._left is not None and self._left.noise > LEAST_NOISE

    def _rate(
        self,
        disparity: DisparityMap,
        best_right: NDArray[np.int16],
        descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    ) -> NDArray[np.float32]:
        if self._left is None or self._left.noise <= LEAST_NOISE:
            return rate(disparity, best_right, descriptors, self._workers)
        return rate_in_noise(disparity, best_right, descriptors, self._left, self._workers)

    def _noise_of_grid(self) -> Array | None:
        """Noise of the descriptors' bytes at the grid of support points; None without."""
        if self._left is None or self._left.noise <= LEAST_NOISE:
            return None
        return SCALE * self._left.noise_gradient(self._config.support_step)

    def _noise_gradient(self) -> Array:
        """Noise of the descriptors' bytes in each of the noise filter's cells."""
        if self._left is None:
            return np.zeros((-(-self._shape[0] // CELL), -(-self._shape[1] // CELL)))
        cells = SCALE * self._left.noise_gradient(CELL)
        # A cell at the border may end before its middle: it is as the one before.
        rows, columns = (
            np.minimum(np.arange(-(-n // CELL)), m - 1)
            for n, m in zip(self._shape, cells.shape, strict=True))
        return cells[np.ix_(rows, columns)]

    def _settings(self) -> StereoConfig:
        """Settings for the noise of the described pair."""
        return self._config if self._left is None else settings_in_noise(
            self._config, self._left.noise
        )

    def _draw_mesh(self, support: SupportPoints) -> None:
        corners = mesh.with_corners(support.points[support.vertices], self._shape)
        triangles = mesh.triangulate(corners, self._shape)
        mesh.rasterize(triangles, self._plane, self._workers, self._steep)

    def _postprocess(
        self,
        config: StereoConfig,
        descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
        disparity: DisparityMap,
    ) -> None:
        self._noise.remove(descriptors, disparity, self._noise_gradient(), self._workers)
        if self._is_noisy():
            self._mean.smooth(disparity, NOISE_RADIUS, self._workers)
        self._segments.remove(
            disparity, config.segment_size, config.segment_difference, self._workers
        )
        if self._left is not None:
            self._edges.drop(disparity, self._left, self._workers)
        postprocess.fill_small_gaps(
            disparity, config.gap_width, config.gap_difference, self._workers
        )
        self._mean.smooth(disparity, config.smoothing_radius, self._workers)
        if self._left is not None:
            self._edges.move(disparity, self._left, self._workers)
