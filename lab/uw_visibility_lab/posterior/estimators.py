# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimators that the judge compares."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from uw_visibility.config.schema import PipelineConfig, WaterConfig
from uw_visibility.images.view import View
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.daylight import network
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.lamps.estimation import LampEstimator
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility_lab.posterior.judge import Answer, Case, LampCase

NOTHING = np.full(3, np.nan)


class OnBoard:
    """The package's estimator; with other networks where they are given."""

    def __init__(self, veil: str = "free", weights: Path | None = None) -> None:
        self._config = WaterConfig(veil=veil)
        self._daylight = Assessor.from_config(PipelineConfig()).daylight
        self._network = None if weights is None else network.load(weights)

    def __call__(self, case: Case) -> Answer:
        """Estimate the water of a case."""
        estimator = WaterEstimator(
            self._config, case.clear_water, case.transfer, self._daylight, self._network)
        found = estimator.estimate(case.image, case.ranges, range_error=case.range_error)
        return answer_of(found)


class UnderLamps:
    """The package's estimator by lamps that are told."""

    def __call__(self, case: LampCase) -> Answer:
        """Estimate the water of a case."""
        return answer_of(estimate_by_lamps(case))


def estimate_by_lamps(case: LampCase) -> WaterEstimate:
    """Estimate the water of a case by the lamps that are told."""
    height, width = case.image.shape[:2]
    rig = StereoRig(case.focal_length, 1.0, (0.5 * (width - 1), 0.5 * (height - 1)))
    estimator = LampEstimator(WaterConfig(), case.lighting, case.clear_water, rig.rays_at)
    return estimator.estimate_view(
        View.of(case.image, case.transfer), case.ranges, range_error=case.range_error)


def answer_of(found: WaterEstimate) -> Answer:
    """What an estimate says of a case."""
    attenuation, stddev = found.attenuation, found.attenuation_stddev
    # As the assessment does: a distance needs every channel that has light.
    if not np.isfinite(attenuation).any() or found.refused_in_light.any():
        return Answer(found.status.value, NOTHING, NOTHING)
    best = int(np.nanargmin(attenuation))
    distance, width = -math.log(attenuation[best]), float(stddev[best] / attenuation[best])
    if found.clearest is not None:
        low, distance, high = (float(value) for value in found.clearest)
        width = 0.5 * (high - low)
    return Answer(
        found.status.value, np.log(attenuation), stddev / attenuation, distance, width)
