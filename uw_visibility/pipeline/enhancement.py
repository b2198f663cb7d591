# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Final enhancement of Fig. 4, from the matched disparity and the water (eq. 8)."""

from __future__ import annotations

from collections.abc import Collection

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.known_range import KnownRange, known_range
from uw_visibility.enhancement.radiance import RestorationWater
from uw_visibility.enhancement.restorers import RESTORER, RESTORERS
from uw_visibility.enhancement.white_balance import restoration_water
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Image, Mask, PerChannel
from uw_visibility.images.view import StereoViews, View
from uw_visibility.pipeline.result import (
    NOT_LIMITED,
    NOT_WANTED,
    EnhancedImages,
    FilledRanges,
    FilledStereo,
)

# Least `KnownRange.known` of pixels from which veil and light are corrected.
_KNOWN = 0.5


class ImageEnhancement:
    """Restoration of both views; `range_error` is the inverse range's standard deviation, 1/m."""

    def __init__(self, config: PipelineConfig, range_error: float, workers: Workers) -> None:
        self._workers = workers
        self._max_gap = config.enhancement.max_gap
        self._range_error = range_error
        self._transfer = config.camera.transfer
        name = config.enhancement.restorer
        if name not in RESTORERS:
            raise InputError(
                f"parameter enhancement.restorer is {name!r}: give one of {', '.join(RESTORERS)}")
        if name != RESTORER and config.lighting.model != "daylight":
            raise InputError(
                f"enhancement.restorer is {name}, which does not support lamps (lighting.model): "
                f"give {RESTORER}")
        self._restorer = RESTORERS[name](config.enhancement, self._transfer, workers)

    def run(
        self, views: StereoViews, filled: FilledStereo, water: RestorationWater,
        right_gain: PerChannel, sides: Collection[str],
    ) -> EnhancedImages:
        """Restore the images of the given sides: "left", "right".

        `water` is that of the left image, `right_gain` the irradiance in the right image over that
        in the left, (C,). The right image needs `filled.right`.
        """
        if not sides:
            return EnhancedImages(NOT_WANTED, NOT_WANTED, NOT_LIMITED)
        of_left, of_right = self._workers.together(
            lambda: self._known(views.left, filled.left, water),
            lambda: filled.right and self._known(views.right, filled.right, water))
        reliable = filled.left.matched & (of_left.known > _KNOWN)
        light = restoration_water(
            views.left.pixels, filled.left.range_map, reliable, water, self._transfer)
        right_light = light._replace(
            exposure=right_gain, ambient_light=right_gain * light.ambient_light,
            scene_light=right_gain * light.scene_light,
            veil_stddev=None if light.veil_stddev is None else right_gain * light.veil_stddev)
        (left, limited), (right, _) = self._workers.together(
            lambda: self._restore(views.left, of_left if "left" in sides else None, light),
            lambda: self._restore(views.right, of_right, right_light))
        return EnhancedImages(left, right, limited, light.scene_light, light.balanced)

    def _known(self, view: View, ranges: FilledRanges, water: RestorationWater) -> KnownRange:
        # Cells of many pixels have the noise of low frequencies.
        return known_range(
            view.pixels, *ranges, view.low_frequency_noise, water.attenuation, self._range_error,
            self._max_gap)

    def _restore(
        self, view: View, ranges: KnownRange | None, water: RestorationWater
    ) -> tuple[Image, Mask]:
        if ranges is None:
            return NOT_WANTED, NOT_LIMITED
        return self._restorer.restore(
            view.pixels, ranges.range_map, water, view.noise, ranges.known)
