# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Final enhancement of Fig. 4, from the filled disparity and the water (eq. 8)."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.hole_range import bound_by_veil
from uw_visibility.enhancement.restorers import RESTORER, RESTORERS
from uw_visibility.enhancement.white_balance import RestorationWater, restoration_water
from uw_visibility.images.arrays import DisparityMap, Image, Mask, PerChannel, RangeMap
from uw_visibility.images.view import StereoViews, View
from uw_visibility.pipeline.result import NOT_LIMITED, NOT_WANTED, EnhancedImages
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view


class ChannelWater(NamedTuple):
    """Attenuation, veil and scene light of each channel of an image; NaN = not assessable."""

    attenuation: PerChannel
    ambient_light: PerChannel
    scene_light: PerChannel


class ImageEnhancement:
    """Restoration of both views with the filled disparity of the left one."""

    def __init__(self, rig: StereoRig, config: PipelineConfig, workers: Workers) -> None:
        self._rig = rig
        self._workers = workers
        self._transfer = config.camera.transfer
        self._restorer = RESTORERS[RESTORER](config.enhancement, self._transfer, workers)

    def run(
        self,
        views: StereoViews,
        disparity: DisparityMap,
        filled: DisparityMap,
        water: ChannelWater,
        right_gain: PerChannel,
        sides: Collection[str],
    ) -> tuple[EnhancedImages, RangeMap]:
        """Restore the images that are wanted.

        Parameters
        ----------
        views : StereoViews
            The pair.
        disparity : ndarray
            ``(H, W)`` float32, of the left view, px; NaN where unmatched.
        filled : ndarray
            ``(H, W)`` float32, the same without holes.
        water : ChannelWater
            What the left camera sees of the water.
        right_gain : ndarray
            ``(C,)`` float64, irradiance in the right image over that in the left.
        sides : collection of str
            "left", "right".

        Returns
        -------
        images : EnhancedImages
        range_map : ndarray
            ``(H, W)`` float32, m, of `filled`; infinite where that lies at or beyond infinity.
        """
        range_map = self._rig.range_of_filled(filled)
        if not sides:
            return EnhancedImages(NOT_WANTED, NOT_WANTED, NOT_LIMITED), range_map
        matched = np.isfinite(disparity)
        light = restoration_water(
            views.left.pixels, range_map, matched, water, self._transfer
        )
        of_right = light._replace(
            ambient_light=right_gain * light.ambient_light,
            scene_light=right_gain * light.scene_light,
        )
        (left, limited), right = self._workers.together(
            lambda: self._left(views.left, range_map, matched, light, "left" in sides),
            lambda: self._right(views.right, disparity, filled, of_right, "right" in sides),
        )
        return EnhancedImages(left, right, limited, light.scene_light, light.balanced), range_map

    def _left(
        self, view: View, range_map: RangeMap, matched: Mask, water: RestorationWater, wanted: bool
    ) -> tuple[Image, Mask]:
        if not wanted:
            return NOT_WANTED, NOT_LIMITED
        return self._restore(view, range_map, matched, water)

    def _right(
        self,
        view: View,
        disparity: DisparityMap,
        filled: DisparityMap,
        water: RestorationWater,
        wanted: bool,
    ) -> Image:
        if not wanted:
            return NOT_WANTED
        seen = in_right_view(filled, self._workers)
        matched = seen == in_right_view(disparity, self._workers)
        return self._restore(view, self._rig.range_of_filled(seen), matched, water)[0]

    def _restore(
        self, view: View, range_map: RangeMap, matched: Mask, water: RestorationWater
    ) -> tuple[Image, Mask]:
        bounded = bound_by_veil(
            range_map, matched, view.pixels, water, self._transfer, self._workers
        )
        return self._restorer.restore(view.pixels, bounded, water, view.noise)
