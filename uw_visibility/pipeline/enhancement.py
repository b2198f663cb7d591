# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The final enhanced images of Fig. 4, from the filled disparity and the water (eq. 8)."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.radiance import Restorer
from uw_visibility.images.arrays import DisparityMap, Image, Mask, PerChannel, RangeMap
from uw_visibility.images.view import StereoViews, View
from uw_visibility.pipeline.result import EnhancedImages
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view

# Stands for an image that nobody asked for.
_NOT_WANTED: Image = np.empty((0, 0), np.uint8)


class ChannelWater(NamedTuple):
    """Attenuation and ambient light of each channel of an image."""

    attenuation: PerChannel
    ambient_light: PerChannel


class ImageEnhancement:
    """Restoration of both views with the filled disparity of the left one.

    Parameters
    ----------
    rig : StereoRig
        Geometry of the pair.
    config : PipelineConfig
        Parameters.
    workers : Workers
        Threads.
    """

    def __init__(self, rig: StereoRig, config: PipelineConfig, workers: Workers) -> None:
        self._rig = rig
        self._workers = workers
        self._restorer = Restorer(config.enhancement, config.camera.transfer, workers)

    def run(
        self,
        views: StereoViews,
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
        filled : ndarray
            ``(H, W)`` float32, disparity of the left view without holes, px.
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
        of_right = ChannelWater(water.attenuation, right_gain * water.ambient_light)
        (range_map, left, limited), right = self._workers.together(
            lambda: self._left(views.left, filled, water, "left" in sides),
            lambda: self._right(views.right, filled, of_right, "right" in sides),
        )
        return EnhancedImages(left, right, limited), range_map

    def _left(
        self, view: View, filled: DisparityMap, water: ChannelWater, wanted: bool
    ) -> tuple[RangeMap, Image, Mask]:
        range_map = self._range(filled)
        if not wanted:
            return range_map, _NOT_WANTED, _NOT_WANTED.astype(bool)
        return range_map, *self._restorer.restore(view.pixels, range_map, water, view.noise)

    def _right(
        self, view: View, filled: DisparityMap, water: ChannelWater, wanted: bool
    ) -> Image:
        if not wanted:
            return _NOT_WANTED
        range_map = self._range(in_right_view(filled, self._workers))
        restored, _ = self._restorer.restore(view.pixels, range_map, water, view.noise)
        return restored

    def _range(self, disparity: DisparityMap) -> RangeMap:
        """Range of a filled map: at or beyond infinity it is infinite."""
        range_map = self._rig.range_from_disparity(disparity)
        range_map[np.isnan(range_map) & np.isfinite(disparity)] = np.inf
        return range_map
