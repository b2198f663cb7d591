# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Step 1 of Fig. 4: coarse disparity of the raw pair, and a first estimate of the water.

Large images are matched on reduced copies: the effect of water varies with range
only, so that a coarse mesh suffices, and averaging reduces the noise of the raw
images. The water is estimated from the images at full size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.matting import refine
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, DisparityMap, Image, PerChannel, Points
from uw_visibility.images.pair import exposure_status
from uw_visibility.images.view import StereoViews, View
from uw_visibility.pipeline.result import StageClock
from uw_visibility.status import Status
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas import FEWEST_SUPPORT_POINTS, SupportPoints
from uw_visibility.stereo.matchers import MATCHER, MATCHERS, disparity_limits
from uw_visibility.stereo.pyramid import Pyramid
from uw_visibility.stereo.radiometry import right_gain
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.foreground import foreground_mask
from uw_visibility.water.lamps.estimation import LampEstimator

# Least width of the reduced images, px.
_LEAST_WIDTH = 300
# Least number of disparities of the reduced images.
_FEWEST_DISPARITIES = 24
# Left and right are exchanged if more than this ratio of the consistent matches, in place or by
# chance, is found with them swapped. It is 2.2 to 120 for exchanged pairs, and below 1.8 for 98 %
# of pairs of different images or with noise on one side.
_EXCHANGED_RATIO = 2.0
# Rows of the images do not correspond if more than this ratio of the matches is found with one
# image moved by so many rows, px, or turned or scaled by as many on average. It is 0.3 to 1.0 for
# real, rendered and Middlebury pairs in clear and turbid water and in noise, 0.6 to 1.3 with rows
# 1 px apart, mostly 1.3 to 3 with 2 px.
_MOVED_RATIO, _ROWS_APART = 1.3, 2
# Support points that cover less than `_SPARSE` of the grid are by chance if as many are consistent
# in wrong places: with images swapped, and with one moved by `_OTHER_ROWS`, px of the reduced
# image. The geometric mean of both ratios is below 0.5 for real, rendered and Middlebury pairs of
# which most matches are right, also of piles and poles, which match in all rows. It is above for
# 99 % of pairs of different images; these cover at most 0.22 of the grid.
_CHANCE_RATIO, _OTHER_ROWS, _SPARSE = 0.5, 12, 0.25
# Standard deviation of a disparity between the mesh's points, px.
_MESH_DEVIATION = 1.0


@dataclass(frozen=True)
class CoarseEstimate:
    """Water and coarse disparity of the raw pair (step 1)."""

    water: WaterEstimate  # attenuation and ambient light
    # ``(N, 3)`` float32: column, row and disparity of the support points, px of the images
    points: Points
    disparity: DisparityMap  # ``(h, w)`` float32, dense, px of the small copies
    rig: StereoRig  # geometry of the small copies
    view: View  # the left view; its valid pixels are those to estimate the water from
    # ``(3,)`` or ``(1,)`` float64, irradiance in the right image over that in the left
    right_gain: PerChannel
    coverage: float  # part of the left image that the mesh covers
    # whether the support points are few and count as matches by chance
    by_chance: bool = False
    # ``(3, R)`` float64, see `LampTables.by_range`; None unless lamps alone light the scene
    lamps: Array | None = None


class Scale:
    """Matcher of small copies of the images, reduced by a factor; buffers preallocated."""

    def __init__(
        self, factor: int, shape: tuple[int, int], rig: StereoRig, config: PipelineConfig,
        workers: Workers, matcher: str = MATCHER,
    ) -> None:
        self.pyramid = Pyramid(factor, shape)
        self.factor, small = self.pyramid.factor, self.pyramid.small
        self.rig = self.pyramid.rig(rig)
        stereo = self.pyramid.settings(config.stereo)
        limits = disparity_limits(stereo, small[1])
        self.matcher = MATCHERS[matcher](small, limits, stereo, workers)
        self.contrast = (
            ContrastNormalizer(small, self.factor), ContrastNormalizer(small, self.factor))

    def downsample(self, views: StereoViews) -> StereoViews:
        """Return the pair at this scale."""
        return StereoViews(*(self.pyramid.downsample_view(view) for view in views))


class FirstStep:
    """Sparse matching, matting and a first estimate of the water; buffers preallocated.

    shape: height and width of the images, px.
    """

    def __init__(
        self, shape: tuple[int, int], rig: StereoRig, config: PipelineConfig,
        estimator: WaterEstimator | LampEstimator, workers: Workers,
    ) -> None:
        self._scale = Scale(reduction_factor(shape, config), shape, rig, config, workers)
        self._pyramid, self._matcher = self._scale.pyramid, self._scale.matcher
        self._rig = rig
        self._support_step = config.stereo.support_step
        self._enhancement = config.enhancement
        self._estimator = estimator
        self._workers = workers

    def run(self, views: StereoViews, clock: StageClock) -> CoarseEstimate:
        """Estimate the water and a coarse disparity from the raw pair.

        Raises `InputError` if the images are dark, saturated or of one colour, exchanged, or the
        same.
        """
        with clock("support points"):
            left, right = self._workers.together(
                lambda: self._pyramid.downsample_view(views.left),
                lambda: self._pyramid.downsample_view(views.right))
            self._matcher.describe_raw(self._scale.contrast, left, right)
            support = self._matcher.support_points()
            by_chance = self._refuse_useless_pair(left.pixels, right.pixels, support)

        def draw_mesh() -> DisparityMap:
            with clock("coarse disparity"):
                return self._matcher.coarse_disparity(support)

        def compare_views() -> tuple[PerChannel, View]:
            with clock("gain and foreground"):
                gain = right_gain(left.pixels, right.pixels, support.points, left.transfer)
                return gain, self._without_foreground(views.left, left.pixels, support)

        def matte() -> DisparityMap:
            with clock("matting"):
                return refine(mesh, left.pixels, self._enhancement)

        def estimate() -> WaterEstimate:
            with clock("visibility estimation 1"):
                return self._estimate(view, mesh, 0 if by_chance else len(support))

        mesh, (gain, view) = self._workers.together(draw_mesh, compare_views)
        disparity, water = self._workers.together(matte, estimate)
        return CoarseEstimate(
            water=water,
            points=self._pyramid.upsample_points(support.points),
            disparity=disparity,
            rig=self._scale.rig,
            view=view,
            right_gain=gain,
            coverage=float(np.count_nonzero(np.isfinite(mesh)) / mesh.size),
            by_chance=by_chance)

    def _without_foreground(self, view: View, small: Image, support: SupportPoints) -> View:
        """Remove unmatched close objects from the valid pixels."""
        if small.ndim == 2:
            return view
        found = foreground_mask(small, support.points, view.transfer)
        return view if found is None else view.without(self._pyramid.repeat(found))

    def _estimate(self, view: View, mesh: DisparityMap, support_points: int) -> WaterEstimate:
        if support_points < FEWEST_SUPPORT_POINTS:
            return WaterEstimate.not_assessable(Status.TOO_FEW_SUPPORT_POINTS)
        if isinstance(self._estimator, LampEstimator):
            # Step 2 would not use the estimate: it matches without one under lamps.
            return WaterEstimate.not_assessable(Status.LEFT_TO_STEP_2)
        ranges = self._rig.range_from_disparity(self._pyramid.upsample_disparity(mesh))
        return self._estimator.estimate_view(
            view, ranges, range_error=self._rig.range_error(_MESH_DEVIATION))

    def _refuse_useless_pair(self, left: Image, right: Image, support: SupportPoints) -> bool:
        """Refuse pairs that cannot be matched for reasons other than the water.

        Exchanged images still have some matches, but all results would be wrong. Returns whether
        the support points are few and count as matches by chance.
        """
        useless = len(support) < FEWEST_SUPPORT_POINTS
        if useless:
            for side, image in (("left", left), ("right", right)):
                reason = exposure_status(image)
                if reason is not Status.OK:
                    raise InputError(f"{side} image: {reason}; nothing can be matched")
        if np.array_equal(left, right):
            raise InputError(
                "left and right image are one and the same: give each side the images of its own "
                "camera")
        grid = left.shape[0] * left.shape[1] / self._support_step**2
        sparse = len(support) < _SPARSE * grid
        swapped = elsewhere = 0.0
        if sparse:
            swapped = self._matcher.swapped_ratio()
            elsewhere = self._matcher.moved_ratio(_OTHER_ROWS, consistent=True)
        least = max(elsewhere, 1.0)
        if swapped > _EXCHANGED_RATIO * least:
            offset = self._rig.offset
            raise InputError(
                "the images match with negative disparities only: exchange left and right" + (
                    f", or calibrate for equal cx, since that of the left is {-offset:g} px "
                    "smaller" if offset < 0 else ""))
        rows = max(_ROWS_APART // self._pyramid.factor, 1)
        if not useless and (
            self._matcher.moved_ratio(rows, consistent=sparse, turned=True) > _MOVED_RATIO * least
        ):
            raise InputError(
                "rows of the left and right image do not correspond: more pixels match with those "
                f"of one moved by {rows * self._pyramid.factor} px on average. Calibrate the pair "
                "again, or rectify it")
        return math.sqrt(swapped * elsewhere) > _CHANCE_RATIO


def reduction_factor(shape: tuple[int, int], config: PipelineConfig) -> int:
    """Return the factor by which step 1 reduces the images."""
    low, high = disparity_limits(config.stereo, shape[1])
    # At least that of step 2.
    factor = Pyramid(config.stereo.reduction, shape).factor
    while (
        shape[1] // (2 * factor) >= _LEAST_WIDTH
        and (high - low) // (2 * factor) >= _FEWEST_DISPARITIES
    ):
        factor *= 2
    return factor
