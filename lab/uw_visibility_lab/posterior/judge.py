# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimators that are judged, and the cases that they are tested with.

A case is an image with ranges and, except for frames of the sea, its true attenuation. Each kind
of case has its own row of the table, since results for one kind do not hold for others. The
package's estimators, for daylight and for lamps, are among those that are judged.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.lighting import LightingConfig
from uw_visibility.config.schema import PipelineConfig, WaterConfig
from uw_visibility.images.arrays import Array
from uw_visibility.images.view import View
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.daylight import network
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.lamps.estimation import LampEstimator
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility_lab.evaluation.fits import fit_backscatter, fit_plain
from uw_visibility_lab.evaluation.judging import CONTRAST, Answer, Judged, rms

# Values of the channels if no distance is reported.
NOTHING = np.full(3, np.nan)


@dataclass(frozen=True, eq=False)
class Case:
    """An image, its ranges, and declared parameters; `attenuation` is the truth or None."""

    image: NDArray[Any]
    ranges: NDArray[np.float32]
    range_error: float
    transfer: str
    clear_water: Array
    attenuation: Array | None
    name: str = ""


@dataclass(frozen=True, eq=False)
class LampCase(Case):
    """A case under declared lamps; the camera's focal length is in px."""

    lighting: LightingConfig = LightingConfig()
    focal_length: float = math.nan


Estimator = Callable[[Any], Answer]


def ask(estimator: Estimator, case: Case) -> Judged:
    """Run an estimator on a case with known truth."""
    assert case.attenuation is not None
    begun = time.perf_counter()
    answer = estimator(case)
    return Judged(case.name, answer, case.attenuation, (time.perf_counter() - begun) * 1e3)


def flips(estimator: Estimator, cases: Sequence[Case]) -> tuple[float, float]:
    """Effect of irrelevant changes: noise of ± 1 code, a row and column cut off, mirroring.

    Returns the part of the changed frames with a distance where the original has none, or the
    reverse, and the root mean square change of ln distance, in the reported deviations.
    """
    changed, moves = [], []
    for index, case in enumerate(cases):
        first = estimator(case)
        rng = np.random.default_rng((0, index))
        top = np.iinfo(case.image.dtype).max
        noise = rng.integers(-1, 2, case.image.shape) * (1 if top == 255 else 257)
        noisy = np.clip(case.image.astype(np.int64) + noise, 0, top).astype(case.image.dtype)
        for other in (
            replace(case, image=noisy),
            replace(case, image=np.ascontiguousarray(case.image[1:, 1:]),
                    ranges=np.ascontiguousarray(case.ranges[1:, 1:])),
            replace(case, image=np.ascontiguousarray(case.image[:, ::-1]),
                    ranges=np.ascontiguousarray(case.ranges[:, ::-1])),
        ):
            second = estimator(other)
            changed.append(first.told != second.told)
            if first.told and second.told:
                moves.append((second.log_distance - first.log_distance) / first.distance_stddev)
    return float(np.mean(changed)), rms(np.array(moves))


def describe(answer: Answer) -> str:
    """Return the visibility distance with its interval, or the reason why there is none."""
    if not math.isfinite(answer.log_distance):
        return answer.status
    middle = visibility_distance(1.0, CONTRAST) * math.exp(answer.log_distance)
    low, high = (middle * math.exp(k * answer.distance_stddev) for k in (-1.0, 1.0))
    return f"{middle:6.1f} ({low:.1f} to {high:.1f}){'' if answer.told else ', ' + answer.status}"


class OnBoard:
    """The package's estimator for daylight; `weights` is a file of other networks."""

    def __init__(self, veil: str = "free", weights: Path | None = None) -> None:
        self._config = WaterConfig(veil=veil)
        self._daylight = Assessor(PipelineConfig()).daylight
        self._network = None if weights is None else network.load(weights)

    def __call__(self, case: Case) -> Answer:
        """Estimate the water of a case."""
        estimator = WaterEstimator(
            self._config, case.clear_water, self._daylight, self._network)
        found = estimator.estimate_view(
            View.of(case.image, case.transfer), case.ranges, range_error=case.range_error)
        return answer_of(found)


def plain(case: Case) -> Answer:
    """Estimate the water of a case by the paper's own fit."""
    return answer_of(fit_plain(case.image, case.ranges, case.clear_water, case.transfer))


def sea_thru(case: Case) -> Answer:
    """Estimate the water of a case by Sea-thru's fit of the backscatter."""
    return answer_of(fit_backscatter(case.image, case.ranges, case.transfer))


def under_lamps(case: LampCase) -> Answer:
    """Estimate the water of a case by the package's estimator for declared lamps."""
    return answer_of(estimate_by_lamps(case))


def estimate_by_lamps(case: LampCase) -> WaterEstimate:
    """Estimate the water of a case with its declared lamps."""
    height, width = case.image.shape[:2]
    rig = StereoRig(case.focal_length, 1.0, (0.5 * (width - 1), 0.5 * (height - 1)))
    estimator = LampEstimator(WaterConfig(), case.lighting, case.clear_water, rig.rays_at)
    return estimator.estimate_view(
        View.of(case.image, case.transfer), case.ranges, range_error=case.range_error)


def answer_of(found: WaterEstimate) -> Answer:
    """Convert an estimate to an answer."""
    attenuation, stddev = found.attenuation, found.attenuation_stddev
    # As in the assessment, a distance needs every channel that has light.
    if not np.isfinite(attenuation).any() or found.refused_in_light.any():
        return Answer(found.status.value, NOTHING, NOTHING)
    best = int(np.nanargmin(attenuation))
    distance, width = -math.log(attenuation[best]), float(stddev[best] / attenuation[best])
    if found.clearest is not None:
        low, distance, high = (float(value) for value in found.clearest)
        width = 0.5 * (high - low)
    return Answer(
        found.status.value, np.log(attenuation), stddev / attenuation, distance, width)
