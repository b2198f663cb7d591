# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Step 1 of Fig. 4: a first look at the water, through a coarse map of the raw pair.

The map of large images is made from small copies of them: water varies with range
only, so that their mesh tells as much of it, and averaging takes noise off the raw
images. The water itself is read from the images as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.matting import Matting
from uw_visibility.errors import InputError
from uw_visibility.images.pair import blindness
from uw_visibility.images.view import View
from uw_visibility.pipeline.second_step import (
    FEWEST_SUPPORT_POINTS,
    describe_raw,
    disparity_limits,
    range_error,
)
from uw_visibility.pipeline.timing import StageClock
from uw_visibility.status import Status
from uw_visibility.stereo.contrast import EvenContrast
from uw_visibility.stereo.elas import Matcher, SupportPoints
from uw_visibility.stereo.interpolation import fill_plane
from uw_visibility.stereo.pyramid import Reduction
from uw_visibility.stereo.radiometry import right_gain
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimation import WaterEstimate, WaterEstimator
from uw_visibility.water.foreground import foreground_mask

# Images are halved as long as their small copy keeps this width, px,
_LEAST_WIDTH = 300
# and this many disparities.
_FEWEST_DISPARITIES = 24
# So many times the matches with the images exchanged mean that they are.
_EXCHANGED_RATIO = 1.5
# Deviation of a disparity between the mesh's points, px.
_MESH_DEVIATION = 1.0

@dataclass(frozen=True)
class FirstLook:
    """What step 1 says of a pair.

    Attributes
    ----------
    water : WaterEstimate
        Attenuation and ambient light.
    points : ndarray
        ``(N, 3)`` float32: column, row and disparity of the support points, px of the
        images.
    disparity : ndarray
        ``(h, w)`` float32, dense, px of the small copies.
    rig : StereoRig
        Geometry of the small copies.
    view : View
        The left view, with the pixels that may tell of the water as its valid ones.
    right_gain : ndarray
        ``(3,)`` or ``(1,)`` float64, irradiance in the right image over that in the left.
    coverage : float
        Part of the left image that the mesh covers.
    """

    water: WaterEstimate
    points: NDArray[np.float32]
    disparity: NDArray[np.float32]
    rig: StereoRig
    view: View
    right_gain: NDArray[np.float64]
    coverage: float

    def whole_disparity(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return `disparity` at the images' size, height and width, px."""
        reduction = Reduction(shape[1] // self.disparity.shape[1], Workers(1))
        return reduction.disparity(self.disparity, shape)


class FirstStep:
    """Step 1 for one size of image, in memory that is allocated once.

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
    """

    def __init__(
        self, shape: tuple[int, int], rig: StereoRig, config: PipelineConfig, workers: Workers
    ) -> None:
        self._reduction = Reduction(_reduction_factor(shape, config), workers)
        self._rig = rig
        self._small_rig = self._reduction.rig(rig, shape)
        small = self._reduction.shape(shape)
        stereo = self._reduction.settings(config.stereo, shape)
        limits = disparity_limits(replace(config, stereo=stereo), small[1])
        self._matcher = Matcher(small, limits, stereo, workers)
        self._contrast = (EvenContrast(small), EvenContrast(small))
        self._matting = Matting(config.enhancement, workers)
        self._workers = workers

    def look(
        self,
        left: View,
        right: View,
        estimator: WaterEstimator,
        clock: StageClock,
    ) -> FirstLook:
        """Take a first look at a pair.

        Parameters
        ----------
        left, right : View
            The pair.
        estimator : WaterEstimator
            What reads the water.
        clock : StageClock
            Times the stages.

        Returns
        -------
        FirstLook

        Raises
        ------
        InputError
            If the images are dark, saturated or of one colour, or exchanged.
        """
        with clock("support points"):
            small = self._workers.together(
                lambda: self._reduction.image(left.pixels),
                lambda: self._reduction.image(right.pixels),
            )
            describe_raw(self._matcher, self._contrast, small, self._workers)
            support = self._matcher.support_points()
            self._refuse_useless_pair(*small, support)

        def unlike_the_scene() -> tuple[NDArray[np.float64], View]:
            with clock("gain and foreign things"):
                gain = right_gain(*small, support.points, left.transfer)
                return gain, self._without_foreground(left, small[0], support)

        def draw_mesh() -> NDArray[np.float32]:
            with clock("coarse disparity"):
                return self._matcher.coarse_disparity(support)

        mesh, (gain, counted) = self._workers.together(draw_mesh, unlike_the_scene)

        def refine() -> NDArray[np.float32]:
            with clock("matting"):
                # A thin mesh is helped by the dominant plane.
                filled, _ = fill_plane(mesh, support.points)
                return self._matting.refine(filled, None, small[0]).disparity

        def estimate() -> WaterEstimate:
            with clock("visibility estimation 1"):
                return self._estimate(counted, mesh, support, estimator)

        disparity, water = self._workers.together(refine, estimate)
        return FirstLook(
            water, self._reduction.whole_points(support.points, left.shape), disparity,
            self._small_rig, counted, gain,
            float(np.count_nonzero(np.isfinite(mesh)) / mesh.size),
        )

    def _without_foreground(
        self, view: View, small: NDArray[Any], support: SupportPoints
    ) -> View:
        """Leave a diver's hand and the like out of the pixels that tell the water."""
        if small.ndim == 2:
            return view
        found = foreground_mask(small, support.points, view.transfer)
        return view.without(self._reduction.whole_mask(found, view.shape))

    def _estimate(
        self,
        view: View,
        mesh: NDArray[np.float32],
        support: SupportPoints,
        estimator: WaterEstimator,
    ) -> WaterEstimate:
        if len(support) < FEWEST_SUPPORT_POINTS:
            return WaterEstimate.not_assessable(Status.TOO_FEW_SUPPORT_POINTS)
        ranges = self._rig.range_from_disparity(self._reduction.disparity(mesh, view.shape))
        return estimator.estimate_view(
            view, ranges, range_error=range_error(self._rig, _MESH_DEVIATION), coarse=True,
        )

    def _refuse_useless_pair(
        self, left: NDArray[Any], right: NDArray[Any], support: SupportPoints
    ) -> None:
        """Raise where few support points have a cause that no water explains.

        Exchanged images still match here and there, and what follows from that
        would be invented.
        """
        if len(support) < FEWEST_SUPPORT_POINTS:
            for side, image in (("left", left), ("right", right)):
                reason = blindness(image)
                if reason is not Status.OK:
                    raise InputError(f"{side} image: {reason}; nothing can be matched")
        if self._matcher.exchanged_ratio() > _EXCHANGED_RATIO:
            raise InputError(
                "the images match with negative disparities only: exchange left and right"
            )


def _reduction_factor(shape: tuple[int, int], config: PipelineConfig) -> int:
    low, high = disparity_limits(config, shape[1])
    # At least as small as what step 2 matches.
    factor = Reduction(config.stereo.reduction, Workers(1)).factor(shape)
    while (
        shape[1] // (2 * factor) >= _LEAST_WIDTH
        and (high - low) // (2 * factor) >= _FEWEST_DISPARITIES
    ):
        factor *= 2
    return factor

