# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stereo matcher: takes a pair of grey images through the stages of ELAS."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.images.view import View
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.denoising import LEAST_NOISE
from uw_visibility.stereo.elas import mesh, postprocess, semi_global
from uw_visibility.stereo.elas.confidence import drop_doubtful, rate
from uw_visibility.stereo.elas.dense import DenseSearch
from uw_visibility.stereo.elas.descriptors import BYTES, SCALE, Descriptors
from uw_visibility.stereo.elas.edges import move_edges
from uw_visibility.stereo.elas.evidence import CELL, remove_noise
from uw_visibility.stereo.elas.support import SupportGrid, SupportPoints

NOISE_RADIUS = 2
"""Neighbours to each side of a first mean in noise, px, which smooths surfaces but not matches by
chance."""

# Restored noise, in 8-bit levels of normalised contrast, from which on the settings are fully those
# of noisy images.
_FULL_NOISE = 6.0
# Additional neighbours to each side in the last mean of the disparity map: noise moves disparities
# by a pixel or two, which averages out on a surface.
_MORE_RADIUS = 5
# Additional width of gaps that are bridged, px: in noise most are mismatches.
_MORE_GAP = 15
# Factors on the steps within a segment, which the first mean reduces on surfaces, but not between
# matches by chance, and on the size of a segment, which may be smaller then.
_SEGMENT_DIFFERENCE, _SEGMENT_SIZE = 0.5, 0.5
# Largest difference of the two views in noise, px: most matches by chance differ by two pixels.
_TOLERANCE = 1
CONFIDENCE_FOR_COLOUR = 0.4
"""Least confidence of matches for colour and for the estimate of the water, which less certain ones
would bias."""

# Least confidence of published matches in noise, which are more likely right than wrong, and its
# growth per level of restored noise, so that it begins gradually.
_CONFIDENCE, _CONFIDENCE_RISE = 0.51, 0.14


def settings_in_noise(config: StereoConfig, noise: float) -> StereoConfig:
    """Adapt the matcher's settings to noise; below `LEAST_NOISE` they are the configured ones.

    `noise` is the restored noise of the median pixel, in 8-bit levels of normalised contrast; see
    `uw_visibility.stereo.contrast`.
    """
    share = min(max((noise - LEAST_NOISE) / (_FULL_NOISE - LEAST_NOISE), 0.0), 1.0)
    if share == 0.0:
        return config
    return replace(
        config,
        smoothing_radius=config.smoothing_radius and (
            config.smoothing_radius + round(share * _MORE_RADIUS)
        ),
        gap_width=config.gap_width and config.gap_width + round(share * _MORE_GAP),
        segment_difference=config.segment_difference * (1.0 - share * (1.0 - _SEGMENT_DIFFERENCE)),
        segment_size=round(config.segment_size * (1.0 - share * (1.0 - _SEGMENT_SIZE))),
        left_right_tolerance=min(config.left_right_tolerance, _TOLERANCE)
        if share > 0.5 else config.left_right_tolerance,
    )


def least_confidence(noise: float) -> float:
    """Least confidence of published matches; 0 up to a noise of `LEAST_NOISE`."""
    if noise <= LEAST_NOISE:
        return 0.0
    return min(_CONFIDENCE_RISE * noise, _CONFIDENCE)


@dataclass(frozen=True)
class DenseMatch:
    """Disparities of a pair."""

    disparity: DisparityMap  # (H, W) float32, left-referenced, px; NaN where unmatched
    # (H, W), probability that `disparity` is within 1 px of the truth; 0 where unmatched; None if
    # it was not computed
    confidence: NDArray[np.float32] | None
    # (H, W) float32, disparity for colour: also of pixels that the right view does not show, filled
    # from their surroundings, and of doubtful matches in noise
    with_occlusions: DisparityMap
    # standard deviation of matches, px of the matched images; None if it was not measured
    stddev: float | None = None


class Matcher:
    """ELAS (Geiger, Roser and Urtasun, ACCV 2010), in memory that is allocated once.

    The steps are separate calls, in this order: `describe_raw`, `support_points`,
    `coarse_disparity` (enough for the first estimate of the water), `dense_disparity`.
    `shape` is height and width of the images, `disparities` the smallest and the largest one,
    inclusive, px.
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
        self._descriptors = (self._views[0].values, self._views[1].values)
        self._support = SupportGrid(shape, disparities, config, workers)
        self._plane = np.empty(shape, np.float32)
        self._steep = np.empty(shape, np.bool_)
        self._search = DenseSearch(shape, disparities, config, workers)
        # The described pair.
        self._images: dict[int, ContrastNormalizer] = {}

    def describe_view(self, side: int, image: ContrastNormalizer) -> None:
        """Compute the descriptors of a view, 0 left, 1 right; `image` is used until matching."""
        self._images[side] = image
        self._views[side].compute(image.grey, image.gain, self._workers)

    def describe_raw(
        self, contrast: tuple[ContrastNormalizer, ContrastNormalizer], left: View, right: View
    ) -> None:
        """Compute the descriptors of a raw pair with its contrast stretched.

        `contrast`, of the left and of the right view, is overwritten, and used until the pair is
        matched.
        """

        def describe(side: int, view: View) -> None:
            contrast[side].stretch(view.pixels, self._workers, view.low_frequency_noise)
            self.describe_view(side, contrast[side])

        self._workers.together(lambda: describe(0, left), lambda: describe(1, right))

    def support_points(self, earlier: NDArray[np.float32] | None = None) -> SupportPoints:
        """Find the support points of the described pair; see `SupportGrid.search`."""
        # Noise of the descriptors' bytes at the points of the grid.
        noise = SCALE * self._left.noise_gradient(self._config.support_step)
        return self._support.search(*self._descriptors, noise, earlier)

    def swapped_ratio(self) -> float:
        """Consistent matches of the described pair with its images swapped, over those in order."""
        return self._support.ratio(*self._descriptors[::-1], consistent=True)

    def moved_ratio(self, rows: int, *, consistent: bool, turned: bool = False) -> float:
        """Matches of the described pair with one image moved by rows, over those in place.

        That of the direction in which more match; `consistent`: see `SupportGrid.ratio`. If
        `turned`, the image is also turned and scaled, so that its rows move as far on average.
        """
        height, width = self._shape
        at = np.arange(height)[:, np.newaxis]
        moves = [np.full((1, 1), rows, np.intp)]
        if turned:
            moves += [
                np.rint(np.linspace(-2 * rows, 2 * rows, n)).astype(np.intp).reshape(shape)
                for n, shape in ((width, (1, -1)), (height, (-1, 1)))]
        left, right = self._descriptors
        # One item for each pixel.
        pixels = right.view(f"V{BYTES}").reshape(self._shape)

        def ratio(move: NDArray[np.intp]) -> float:
            source = (at + move) % height
            whole = source.shape[1] == 1
            moved = pixels[source[:, 0]] if whole else np.take_along_axis(pixels, source, axis=0)
            return self._support.ratio(
                left, moved.reshape(-1).view(np.uint8), consistent=consistent)

        return max(ratio(move) for each in moves for move in (-each, each))

    def coarse_disparity(self, support: SupportPoints) -> DisparityMap:
        """Return the mesh of the support points as an image, px; NaN outside the mesh."""
        coarse = np.empty(self._shape, np.float32)
        vertices = support.points[support.vertices]
        mesh.rasterize(mesh.triangulate(vertices, self._shape), coarse, self._workers)
        return coarse

    def dense_disparity(
        self,
        support: SupportPoints,
        *,
        confidence: bool = True,
        least_for_colour: float = 0.0,
    ) -> DenseMatch:
        """Match every pixel of the described pair; with `confidence` rate the matches.

        Matches of at least the confidence `least_for_colour` are in `DenseMatch.with_occlusions`:
        those that are doubtful in noise are not published, but are still used for colour.
        """
        disparity = np.full(self._shape, np.nan, np.float32)
        if len(support) == 0:
            nowhere = np.zeros(self._shape, np.float32) if confidence else None
            return DenseMatch(disparity, nowhere, disparity)
        config = settings_in_noise(self._config, self._left.noise)
        self._find_best(config, support, disparity)
        self._postprocess(config, disparity)
        with_occlusions = disparity.copy()
        postprocess.remove_occluded(disparity, self._workers)
        asked = self._config.min_confidence
        least = least_confidence(self._left.noise)
        rated = None
        if confidence or asked > 0 or least > 0:
            rated = rate(
                disparity, self._search.best[1], self._descriptors, self._left, self._workers)
            for_colour = max(asked, least_for_colour, min(least, CONFIDENCE_FOR_COLOUR))
            if for_colour > 0:
                with_occlusions[(rated > 0) & (rated < for_colour)] = np.nan
            if least > 0:
                drop_doubtful(disparity, rated, least, self._workers)
            if least > 0 or asked > 0:
                disparity[rated < asked] = np.nan
                rated[np.isnan(disparity)] = 0.0
        return DenseMatch(disparity, rated, with_occlusions)

    def _find_best(
        self, config: StereoConfig, support: SupportPoints, disparity: DisparityMap
    ) -> None:
        """Write the disparities that both views agree on, at sub-pixel resolution."""
        best = self._search.best
        if self._is_noisy():
            self._draw_mesh(support)
            semi_global.search(
                config, self._disparities, self._left, self._images[1], self._views,
                support.points, self._plane, self._steep, best, disparity, self._workers)
        else:
            self._workers.together(
                lambda: self._draw_mesh(support),
                lambda: self._search.try_candidates(self._descriptors, support.points))
            self._search.try_plane(self._descriptors, self._plane, self._steep, disparity)
        postprocess.check(best, config.left_right_tolerance, disparity, self._workers)

    @property
    def _left(self) -> ContrastNormalizer:
        return self._images[0]

    def _is_noisy(self) -> bool:
        return self._left.noise > LEAST_NOISE

    def _remove_noise(self, disparity: DisparityMap) -> None:
        """Set matches that are no better than noise, as in open water, to NaN."""
        # Noise of the descriptors' bytes in each of the noise filter's cells.
        cells = SCALE * self._left.noise_gradient(CELL)
        # A cell that ends before its middle, at the border, has the noise of the one before.
        rows, columns = (
            np.minimum(np.arange(-(-n // CELL)), m - 1)
            for n, m in zip(self._shape, cells.shape, strict=True))
        remove_noise(
            self._descriptors, disparity, cells[np.ix_(rows, columns)], self._config.noise_ratio,
            self._workers)

    def _draw_mesh(self, support: SupportPoints) -> None:
        corners = mesh.with_corners(support.points[support.vertices], self._shape)
        triangles = mesh.triangulate(corners, self._shape)
        mesh.rasterize(triangles, self._plane, self._workers, self._steep)

    def _postprocess(self, config: StereoConfig, disparity: DisparityMap) -> None:
        widest = config.smoothing_difference
        self._remove_noise(disparity)
        if self._is_noisy():
            postprocess.smooth(disparity, NOISE_RADIUS, widest, self._workers)
        postprocess.remove_segments(disparity, config.segment_size, config.segment_difference)
        move_edges(disparity, self._left, self._workers, drop=True)
        postprocess.fill_small_gaps(
            disparity, config.gap_width, config.gap_difference, self._workers
        )
        postprocess.smooth(disparity, config.smoothing_radius, widest, self._workers)
        move_edges(disparity, self._left, self._workers)
