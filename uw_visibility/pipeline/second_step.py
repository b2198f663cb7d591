# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Step 2 of Fig. 4: dense matching of the pair with its contrast restored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.arrays import DisparityMap, PerChannel, Points
from uw_visibility.images.view import StereoViews, View
from uw_visibility.optics.lamps import DirectLight
from uw_visibility.pipeline.first_step import CoarseEstimate
from uw_visibility.pipeline.timing import StageClock
from uw_visibility.stereo.airlight import Airlight, AirlightPrior
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas import DenseMatch
from uw_visibility.stereo.interpolation import GapFiller, inpaint
from uw_visibility.stereo.matchers import MATCHER, MATCHERS
from uw_visibility.stereo.pyramid import Pyramid
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.search_range import disparity_limits
from uw_visibility.stereo.views import in_right_view


@dataclass(frozen=True)
class ImprovedDisparity:
    """Disparity matched in step 2.

    Attributes
    ----------
    disparity : ndarray
        ``(H, W)`` float32, left-referenced, px; NaN where unmatched.
    confidence : ndarray or None
        ``(H, W)`` float32, probability that `disparity` is within 1 px of the truth;
        0 where unmatched; None where not asked for.
    with_occlusions : ndarray
        ``(H, W)`` float32, `disparity` with what the right view does not show; see
        `DenseMatch`.
    original : ndarray or None
        ``(H, W)`` float32, px; the raw pair matched alone, where asked for.
    match : DenseMatch
        Both views, at the size at which they were matched.
    support_points : int
        Support points of the restored pair.
    """

    disparity: DisparityMap
    confidence: DisparityMap | None
    with_occlusions: DisparityMap
    original: DisparityMap | None
    match: DenseMatch
    support_points: int


class SecondStep:
    """Dense matching of the restored pair; buffers preallocated for one size of image.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    rig : StereoRig
        Geometry of the pair.
    config : PipelineConfig
        Parameters, for images of this size.
    workers : Workers
        Threads.
    lamps : DirectLight, optional
        How the light of lamps falls with range, where they alone light the scene.

    Raises
    ------
    InputError
        If the limits of the disparity leave nothing to search.
    """

    def __init__(
        self, shape: tuple[int, int], rig: StereoRig, config: PipelineConfig, workers: Workers,
        lamps: DirectLight | None = None,
    ) -> None:
        self._shape = shape
        self._workers = workers
        self._lamps = lamps
        self._pyramid = Pyramid(config.stereo.reduction, workers)
        stereo = self._pyramid.settings(config.stereo, shape)
        small = self._pyramid.shape(shape)
        limits = disparity_limits(stereo, small[1])
        self._matcher = MATCHERS[MATCHER](small, limits, stereo, workers)
        self._contrast = (ContrastNormalizer(small), ContrastNormalizer(small))
        self._airlight = Airlight(
            small, self._pyramid.rig(rig, shape), limits[1] + 2, config.camera.transfer, workers
        )
        self._airlight_used = config.stereo.airlight_prior > 0
        self._gaps = GapFiller(small, config.enhancement.max_gap, workers)

    def run(
        self,
        views: StereoViews,
        coarse: CoarseEstimate,
        clock: StageClock,
        *,
        match_original: bool = False,
        confidence: bool = True,
    ) -> ImprovedDisparity:
        """Match a pair densely, its contrast restored with what step 1 says.

        Parameters
        ----------
        views : StereoViews
            The pair.
        coarse : CoarseEstimate
            Of step 1.
        clock : StageClock
            Times the stages.
        match_original : bool
            Whether to match the raw pair too, for comparison.
        confidence : bool
            Whether to rate the disparities.

        Returns
        -------
        ImprovedDisparity
        """
        left, right = self._downsample(views, clock)
        original = None
        if match_original:
            with clock("original disparity"):
                original = self._match_raw(left, right)
        with clock("image enhancement 1"):
            self._describe_restored(left, right, coarse)
            points = self._pyramid.downsample_points(coarse.points, self._shape)
            airlight = self._airlight_prior(left, coarse, points)
        with clock("improved disparity"):
            support = self._matcher.support_points(airlight, points)
            match = self._matcher.dense_disparity(support, airlight, confidence=confidence)
        return self._upsample(match, original, len(support), clock)

    def fill(self, improved: ImprovedDisparity) -> DisparityMap:
        """Fill gaps of the left view's disparity, then large areas; at the images' size, px."""
        match = improved.match
        filled = inpaint(self._gaps.fill(_whole(match), match.right), self._workers)
        return self._pyramid.upsample_disparity(filled, self._shape)

    def coarse_disparity(self, left: View, right: View) -> DisparityMap:
        """Return the mesh of a raw pair's support points, at the size that is matched, px."""
        self._matcher.describe_raw(self._contrast, left, right)
        return self._matcher.coarse_disparity(self._matcher.support_points())

    def support_points(self, left: View, right: View) -> Points:
        """Return the support points of a raw pair, at the size that is matched, px."""
        self._matcher.describe_raw(self._contrast, left, right)
        return self._matcher.support_points().points

    def _downsample(self, views: StereoViews, clock: StageClock) -> StereoViews:
        if self._pyramid.factor(self._shape) == 1:
            return views
        with clock("reduction"):
            return StereoViews(*(self._pyramid.downsample_view(view) for view in views))

    def _match_raw(self, left: View, right: View) -> DisparityMap:
        self._matcher.describe_raw(self._contrast, left, right)
        support = self._matcher.support_points()
        return self._matcher.dense_disparity(support, confidence=False).disparity

    def _describe_restored(self, left: View, right: View, coarse: CoarseEstimate) -> None:
        """Describe the pair with its contrast restored; without estimate as it is.

        Under lamps it is their known light that falls with range, whatever the water is.
        By daylight channels that are too dark are left out. One that is refused for another reason
        still shows the scene: without it less is left than of the image as it is.
        """
        water, lamps = coarse.water, self._lamps
        known = np.isfinite(water.attenuation).any() and not water.refused_in_light.any()
        if left.colour is None or (lamps is None and not known):
            self._matcher.describe_raw(self._contrast, left, right)
            return

        def describe(side: int, view: View, disparity: DisparityMap, gain: PerChannel) -> None:
            ranges = coarse.rig.range_from_disparity(disparity)
            if lamps is None:
                self._contrast[side].restore(
                    view.pixels, ranges, water.attenuation, gain * water.ambient_light,
                    self._workers, view.noise)
            else:
                self._contrast[side].restore_lit(
                    view.pixels, ranges, *lamps, self._workers, view.noise)
            self._matcher.describe_view(side, self._contrast[side])

        self._workers.together(
            lambda: describe(0, left, coarse.disparity, np.ones(3)),
            lambda: describe(
                1, right, in_right_view(coarse.disparity, self._workers), coarse.right_gain),
        )

    def _airlight_prior(
        self, left: View, coarse: CoarseEstimate, points: Points
    ) -> AirlightPrior | None:
        """Bound ranges by the light that the water adds, as far as matches agree."""
        if left.colour is None or not self._airlight_used:
            return None
        return self._airlight.prior(left.pixels, coarse.water, points, left.noise)

    def _upsample(
        self,
        match: DenseMatch,
        original: DisparityMap | None,
        support_points: int,
        clock: StageClock,
    ) -> ImprovedDisparity:
        """Bring what was matched to the size of the images."""
        disparity, confidence = match.disparity, match.confidence
        whole = _whole(match)
        if self._pyramid.factor(self._shape) > 1:
            with clock("full size"):
                disparity = self._pyramid.upsample_disparity(disparity, self._shape)
                whole = self._pyramid.upsample_disparity(whole, self._shape)
                if confidence is not None:
                    confidence = self._pyramid.upsample_confidence(confidence, disparity)
                if original is not None:
                    original = self._pyramid.upsample_disparity(original, self._shape)
        return ImprovedDisparity(
            disparity, confidence, whole, original, match, support_points)


def _whole(match: DenseMatch) -> DisparityMap:
    return match.disparity if match.with_occlusions is None else match.with_occlusions
