# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Final enhancement of Fig. 4, from the filled disparity and the water (eq. 8)."""

from __future__ import annotations

from collections.abc import Collection

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.hole_range import bound_by_veil
from uw_visibility.enhancement.restorers import RESTORER, RESTORERS
from uw_visibility.enhancement.white_balance import RestorationWater, restoration_water
from uw_visibility.images.arrays import Image, Mask, PerChannel
from uw_visibility.images.view import StereoViews, View
from uw_visibility.pipeline.result import (
    NOT_LIMITED,
    NOT_WANTED,
    EnhancedImages,
    FilledRanges,
    FilledStereo,
)


class ImageEnhancement:
    """Restoration of both views with their filled ranges."""

    def __init__(self, config: PipelineConfig, workers: Workers) -> None:
        self._workers = workers
        self._transfer = config.camera.transfer
        self._restorer = RESTORERS[RESTORER](config.enhancement, self._transfer, workers)

    def run(
        self, views: StereoViews, filled: FilledStereo, water: RestorationWater,
        right_gain: PerChannel, sides: Collection[str],
    ) -> EnhancedImages:
        """Restore the images of the sides wanted: "left", "right".

        `water` is what the left camera sees, `right_gain` the irradiance in the right image over
        that in the left, (C,). The right view needs ranges where its image is wanted.
        """
        if not sides:
            return EnhancedImages(NOT_WANTED, NOT_WANTED, NOT_LIMITED)
        light = restoration_water(views.left.pixels, *filled.left, water, self._transfer)
        of_right = light._replace(
            ambient_light=right_gain * light.ambient_light,
            scene_light=right_gain * light.scene_light,
            veil_stddev=None if light.veil_stddev is None else right_gain * light.veil_stddev)
        (left, limited), (right, _) = self._workers.together(
            lambda: self._restore(views.left, filled.left if "left" in sides else None, light),
            lambda: self._restore(views.right, filled.right, of_right))
        return EnhancedImages(left, right, limited, light.scene_light, light.balanced)

    def _restore(
        self, view: View, ranges: FilledRanges | None, water: RestorationWater
    ) -> tuple[Image, Mask]:
        if ranges is None:
            return NOT_WANTED, NOT_LIMITED
        bounded = bound_by_veil(*ranges, view.pixels, water, self._transfer, self._workers)
        return self._restorer.restore(view.pixels, bounded, water, view.noise)
