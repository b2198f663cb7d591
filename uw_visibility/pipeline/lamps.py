# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimators of the water by daylight and under lamps, and restoration under lamps."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.special import expit

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.enhancement.known_range import known_range
from uw_visibility.enhancement.lamp_radiance import LampRestorer
from uw_visibility.images.arrays import Array, Image, Mask, PerChannel, RangeMap
from uw_visibility.images.view import StereoViews, View
from uw_visibility.optics.lamps import LEFT_EYE, tabulate
from uw_visibility.pipeline.result import (
    NOT_LIMITED,
    NOT_WANTED,
    EnhancedImages,
    FilledRanges,
    FilledStereo,
)
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.daylight.inference import DECLARED, MOST_LAMPS
from uw_visibility.water.estimate import LampLight, WaterEstimate
from uw_visibility.water.lamps.estimation import LampEstimator
from uw_visibility.water.meaning.assessment import Assessor

# Attenuation by particles that is assumed in matching, 1/m; gains depend little on it.
USUAL_PARTICLES = 0.1


class Estimators:
    """Estimators of the water by `lighting.model`.

    `by_daylight` is None if lamps light the scene, `by_lamps` if none do.
    """

    def __init__(self, config: PipelineConfig, assessor: Assessor, rig: StereoRig) -> None:
        self._model = config.lighting.model
        self._clear_water = assessor.clear_water_attenuation
        self.by_daylight = self.by_lamps = None
        if self._model in ("daylight", "auto"):
            self.by_daylight = WaterEstimator(
                config.water, self._clear_water, assessor.daylight)
        if self._model != "daylight":
            self.by_lamps = LampEstimator(
                config.water, config.lighting, self._clear_water, rig.rays_at)

    @property
    def first(self) -> WaterEstimator | LampEstimator:
        """Estimator of step 1; by daylight it also gives the log odds of lamps."""
        found = self.by_daylight or self.by_lamps
        assert found is not None
        return found

    def lamps(self, first: WaterEstimate) -> float:
        """Probability that lamps light a view, by its first estimate."""
        if self._model != "auto":
            return float(self.by_lamps is not None)
        # A view with unknown odds is estimated by daylight, and refused with the reason.
        return float(np.nan_to_num(expit(first.lamps_log_odds + DECLARED)))

    def lit_by_lamps(self, first: WaterEstimate) -> bool:
        """Whether lamps are more probable than daylight."""
        return self.lamps(first) > 0.5

    def light_by_range(self, shape: tuple[int, int]) -> Array | None:
        """Direct light of the lamps over range; None unless they may light the scene alone."""
        if self.by_lamps is None or self._model == "both":
            return None
        return self.by_lamps.tables(shape).by_range(self._clear_water + USUAL_PARTICLES)

    def estimate(
        self, view: View, range_map: RangeMap, range_error: float, first: WaterEstimate
    ) -> WaterEstimate:
        """Estimate by daylight or under lamps, whichever is certain; refuse if neither is."""
        lamps = self.lamps(first)
        if self.by_daylight is None or lamps >= 1.0 - MOST_LAMPS:
            assert self.by_lamps is not None
            water = self.by_lamps.estimate_view(view, range_map, range_error=range_error)
        elif lamps <= MOST_LAMPS:
            water = self.by_daylight.estimate_view(view, range_map, range_error=range_error)
        else:
            water = WaterEstimate.not_assessable(Status.LIGHT_UNCERTAIN)
        if self.by_daylight is None or self.by_lamps is None:
            return water
        if math.isnan(first.lamps_log_odds) or water.status is Status.LIGHT_UNCERTAIN:
            # Other frames may show that lamps light it, and then a survey uses its nodes. Without
            # an attenuation, the frame alone is not restored by light that it may not have.
            lit = self.by_lamps.estimate_view(view, range_map, range_error=range_error).lamps
            if lit is not None:
                water = replace(water, lamps=replace(lit, attenuation=np.full(3, np.nan)))
        return replace(water, lamps_log_odds=first.lamps_log_odds + DECLARED)


class LampEnhancement:
    """Restoration of both views under lamps."""

    def __init__(self, rig: StereoRig, config: PipelineConfig, workers: Workers) -> None:
        self._lamps = tuple(config.lighting.lamps())
        self._rays = rig.rays_at, partial(rig.rays_at, right=True)
        self._eyes = LEFT_EYE, (rig.baseline, 0.0, 0.0)
        self._range_error, self._max_gap = rig.range_error(), config.enhancement.max_gap
        self._workers = workers
        self._restorer = LampRestorer(config.enhancement, config.camera.transfer, workers)

    def warm_up(self, image: Image) -> None:
        """Compile kernels for colour images of a type."""
        view = View.of(image)
        one, none = np.ones(3), np.zeros(3)
        light = LampLight(0.2 * one, one, 0.1 * one, none, none)
        ranges = FilledRanges(np.full(view.shape, 2.0, np.float32), np.ones(view.shape, np.bool_))
        self._restore(view, ranges, light, False)

    def run(
        self, views: StereoViews, filled: FilledStereo, light: LampLight | None,
        right_gain: PerChannel, sides: Collection[str],
    ) -> EnhancedImages:
        """Restore as `ImageEnhancement.run`; without `light` the images stay as they are."""
        left, limited, right = NOT_WANTED, NOT_LIMITED, NOT_WANTED
        power = None if light is None else light.power
        if "left" in sides:
            left, limited = self._restore(views.left, filled.left, light, False)
        if filled.right is not None:
            if light is not None and views.right.colour is not None:
                light = replace(
                    light, power=light.power * right_gain,
                    scattering=light.scattering * right_gain,
                    daylight=light.daylight * right_gain, veil=light.veil * right_gain)
            right, _ = self._restore(views.right, filled.right, light, True)
        return EnhancedImages(left, right, limited, power)

    def _restore(
        self, view: View, ranges: FilledRanges, light: LampLight | None, right: bool
    ) -> tuple[Image, Mask]:
        # Restoring only some of the channels would give a colour cast.
        if light is None or view.colour is None or not np.isfinite(light.attenuation).all():
            return view.pixels.copy(), np.zeros(view.shape, np.bool_)
        tables = tabulate(self._rays[right], view.shape, self._lamps, self._eyes[right])
        field = tables.field(
            light.attenuation, light.power, light.scattering, light.daylight, light.veil)
        known = known_range(
            view.pixels, *ranges, view.low_frequency_noise, light.attenuation, self._range_error,
            self._max_gap)
        return self._restorer.restore(
            view.pixels, known.range_map, field, view.noise, known.known)
