# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimators that the judge compares."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.config.water import WaterConfig
from uw_visibility.images.arrays import Mask
from uw_visibility.images.view import View
from uw_visibility.status import Status
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility_lab.posterior import network
from uw_visibility_lab.posterior.inference import infer
from uw_visibility_lab.posterior.judge import Answer, Case
from uw_visibility_lab.posterior.statistics import summarise

ONE_SIGMA = np.array((0.16, 0.5, 0.84))
NOTHING = np.full(3, np.nan)


class Todays:
    """The package's estimator, with its default parameters."""

    def __init__(self, veil: str = "free") -> None:
        self._config = WaterConfig(veil=veil)
        self._daylight = Assessor.from_config(PipelineConfig()).daylight

    def __call__(self, case: Case) -> Answer:
        """Estimate the water of a case."""
        estimator = WaterEstimator(
            self._config, case.clear_water, case.transfer, self._daylight)
        found = estimator.estimate(case.image, case.ranges, range_error=case.range_error)
        attenuation, stddev = found.attenuation, found.attenuation_stddev
        # As the assessment does: a distance needs every channel that has light.
        if not np.isfinite(attenuation).any() or found.refused_in_light.any():
            return Answer(found.status.value, NOTHING, NOTHING)
        best = int(np.nanargmin(attenuation))
        return Answer(
            found.status.value, np.log(attenuation), stddev / attenuation,
            -math.log(attenuation[best]), float(stddev[best] / attenuation[best]))


class Learnt:
    """A trained posterior; no case is refused but for what is not known of it."""

    def __init__(self, weights: Path) -> None:
        self._network = network.load(weights)

    def __call__(self, case: Case) -> Answer:
        """Infer the water of a case."""
        samples = View.of(case.image, case.transfer).colour
        statistics = None if samples is None else summarise(
            samples, case.ranges, None, case.range_error, case.clear_water)
        if statistics is None:
            return Answer(Status.TOO_FEW_OBSERVATIONS.value, NOTHING, NOTHING)
        posterior = infer(self._network, statistics)
        seen = _lit(statistics.of_channels)
        low, middle, high = posterior.clearest(seen, ONE_SIGMA)
        return Answer(
            Status.OK.value, np.where(seen, posterior.mean[:, 0], np.nan),
            np.where(seen, np.sqrt(np.diag(posterior.covariance)[::3]), np.nan),
            float(middle), float(high - low) / 2.0)


def _lit(of_channels: NDArray[np.float32]) -> Mask:
    """(3,) bool: channels that are black in less than half of their pixels; one at least."""
    black = of_channels[:, 8]
    return np.asarray((black < 0.5) | (black == black.min()))
