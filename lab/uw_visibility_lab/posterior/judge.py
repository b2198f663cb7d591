# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""One table for any estimator of water: what it tells, how far off it is, how well it knows.

A case is an image with ranges and, but for frames of the sea, its true attenuation. Each kind of
case is a row, so that no figure stands for a world it was not measured in. The package's own
estimators, by day and under lamps, are among those that are judged.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from uw_visibility.config.lighting import LightingConfig
from uw_visibility.config.schema import PipelineConfig, WaterConfig
from uw_visibility.images.arrays import Array
from uw_visibility.images.view import View
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.daylight import network
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.lamps.estimation import LampEstimator
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility_lab.evaluation.fits import fit_backscatter, fit_plain

# A distance that is longer than the true one by this factor is too long, and so for too short.
FACTOR = 1.2
# A told distance whose 16 and 84 % differ by more than this factor counts as not told.
WIDEST_INTERVAL = 2.5
# Contrast that an observer distinguishes (eq. 11).
CONTRAST = 0.05
# Of each channel, where no distance is told.
NOTHING = np.full(3, np.nan)


@dataclass(frozen=True, eq=False)
class Case:
    """An image, its ranges, and what is told of them; `attenuation` is the truth or None."""

    image: NDArray[Any]
    ranges: NDArray[np.float32]
    range_error: float
    transfer: str
    clear_water: Array
    attenuation: Array | None
    name: str = ""


@dataclass(frozen=True, eq=False)
class LampCase(Case):
    """A case by lamps that are told, through a camera of a focal length, px."""

    lighting: LightingConfig = LightingConfig()
    focal_length: float = math.nan


@dataclass(frozen=True)
class Answer:
    """What an estimator says of a case."""

    status: str  # ``"ok"`` or why not
    # log_attenuation, stddev: (3,); mean and standard deviation of ln β; NaN where not told
    log_attenuation: Array
    stddev: Array
    # log_distance, distance_stddev: of the logarithm of the visibility distance but for a
    # constant: −ln min β
    log_distance: float = math.nan
    distance_stddev: float = math.nan

    @property
    def told(self) -> bool:
        """Whether a distance is told that is known to `WIDEST_INTERVAL`."""
        return (
            self.status == Status.OK.value and math.isfinite(self.log_distance)
            and 2.0 * self.distance_stddev <= math.log(WIDEST_INTERVAL))


Estimator = Callable[[Any], Answer]


@dataclass(frozen=True)
class Row:
    """The table's row of one kind of cases; parts are of those told, 0..1."""

    cases: int  # number
    told: float  # part with a distance
    # error, distance_error: root mean square of the error of ln β (all channels told) and of ln
    # distance
    error: float
    distance_error: float
    score: float  # root mean square of the distance's error over its told deviation: 1 is right
    within: tuple[float, float, float]  # part of the distances within 1, 2, 3 deviations
    beyond: float  # part of the cases with any β or the distance beyond 3 deviations
    too_long: float  # too_long, too_short: part by more than a fifth
    too_short: float
    low_above: float  # part of the intervals (16 to 84 %) whose lower end is above the truth
    crps: float  # mean continuous ranked probability score of ln distance
    milliseconds: float  # median time


@dataclass(frozen=True, eq=False)
class Judged:
    """An estimator's answer to a case, beside the truth."""

    scene: str  # the case's name
    answer: Answer
    attenuation: Array  # (3,); true β, 1/m
    milliseconds: float  # that the estimator took

    @property
    def off(self) -> Array:
        """(3,): errors of ln β, NaN where not told."""
        return np.asarray(self.answer.log_attenuation - np.log(self.attenuation))

    @property
    def clearest(self) -> float:
        """True β of the channel that sees farthest, of those that are told if any is."""
        told = np.isfinite(self.answer.log_attenuation)
        return float(self.attenuation[told | ~told.any()].min())

    @property
    def far(self) -> float:
        """Error of ln distance; NaN where not told."""
        return self.answer.log_distance + math.log(self.clearest)

    @property
    def beyond(self) -> bool:
        """Whether β of any channel or the distance is beyond 3 deviations."""
        errors = np.append(self.off, self.far)
        with np.errstate(divide="ignore", invalid="ignore"):
            scores = errors / np.append(self.answer.stddev, self.answer.distance_stddev)
        return bool((np.abs(scores) > 3.0).any())

    def row(self) -> dict[str, Any]:
        """Return the answer as a row of a table; β in 1/m, distances in m, σ of logarithms."""
        answer, metres = self.answer, visibility_distance(1.0, CONTRAST)
        return {
            "scene": self.scene, "status": answer.status, "told": answer.told,
            "beyond": self.beyond,
            "true.attenuation": tuple(self.attenuation), "true.distance": metres / self.clearest,
            "attenuation": tuple(np.exp(answer.log_attenuation)),
            "attenuation_stddev": tuple(answer.stddev),
            "distance": metres * math.exp(answer.log_distance),
            "distance_stddev": answer.distance_stddev}


def ask(estimator: Estimator, case: Case) -> Judged:
    """Give an estimator a case whose truth is known."""
    assert case.attenuation is not None
    begun = time.perf_counter()
    answer = estimator(case)
    return Judged(case.name, answer, case.attenuation, (time.perf_counter() - begun) * 1e3)


def judge(estimator: Estimator, cases: Iterable[Case]) -> Row:
    """Judge an estimator by cases whose truth is known."""
    return row_of([ask(estimator, case) for case in cases])


def row_of(judged: Sequence[Judged]) -> Row:
    """Return the table's row of an estimator's answers to cases of one kind."""
    cases, milliseconds = len(judged), float(np.median([each.milliseconds for each in judged]))
    told = [each for each in judged if each.answer.told]
    if not told:
        nothing = (math.nan,) * 3
        return Row(cases, 0.0, *nothing, nothing, *(math.nan,) * 5, milliseconds)
    off = np.array([each.off for each in told])
    far = np.array([each.far for each in told])
    width = np.array([each.answer.distance_stddev for each in told])
    scores = far / width
    return Row(
        cases=cases, told=len(told) / cases,
        error=_rms(off[np.isfinite(off)]), distance_error=_rms(far), score=_rms(scores),
        within=tuple(float((np.abs(scores) <= k).mean()) for k in (1, 2, 3)),  # type: ignore[arg-type]
        beyond=float(np.mean([each.beyond for each in told])),
        too_long=float((far > math.log(FACTOR)).mean()),
        too_short=float((far < -math.log(FACTOR)).mean()),
        low_above=float((scores > 1.0).mean()), crps=float(_crps(far, width).mean()),
        milliseconds=milliseconds)


def flips(estimator: Estimator, cases: Sequence[Case]) -> tuple[float, float]:
    """What changes when nothing that matters does: ± 1 code, a row and column cut off, mirrored.

    Returns
    -------
    flips : float
        Part of the changed frames that are told where the frame was not, or the reverse.
    moves : float
        Root mean square of the distance's change, in its told deviations.
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
    return float(np.mean(changed)), _rms(np.array(moves))


def table(rows: Sequence[tuple[str, Row]]) -> str:
    """Return the rows as text."""
    lines = [
        f"{'cases':24} {'n':>5} {'told':>5} {'ln β':>5} {'ln d':>5} {'score':>5} "
        f"{'1 σ':>4} {'2 σ':>4} {'3 σ':>4} {'>3 σ':>5} {'long':>5} {'short':>5} {'low':>4} "
        f"{'crps':>5} {'ms':>6}"]
    for name, row in rows:
        one, two, three = row.within
        lines.append(
            f"{name[:24]:24} {row.cases:5d} {row.told:5.2f} {row.error:5.2f} "
            f"{row.distance_error:5.2f} {row.score:5.2f} {one:4.2f} {two:4.2f} {three:4.2f} "
            f"{row.beyond:5.3f} {row.too_long:5.2f} {row.too_short:5.2f} {row.low_above:4.2f} "
            f"{row.crps:5.2f} {row.milliseconds:6.1f}")
    return "\n".join(lines)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _crps(off: Array, stddev: Array) -> Array:
    """Continuous ranked probability score of normal distributions.

    Gneiting and Raftery 2007, doi:10.1198/016214506000001437, eq. 21.
    """
    z = off / stddev
    density = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    return np.asarray(
        stddev * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / math.sqrt(math.pi)))


def describe(answer: Answer) -> str:
    """Return the visibility distance with its interval, or why there is none."""
    if not math.isfinite(answer.log_distance):
        return answer.status
    middle = visibility_distance(1.0, CONTRAST) * math.exp(answer.log_distance)
    low, high = (middle * math.exp(k * answer.distance_stddev) for k in (-1.0, 1.0))
    return f"{middle:6.1f} ({low:.1f} to {high:.1f}){'' if answer.told else ', ' + answer.status}"


class OnBoard:
    """The package's estimator; with other networks where they are given."""

    def __init__(self, veil: str = "free", weights: Path | None = None) -> None:
        self._config = WaterConfig(veil=veil)
        self._daylight = Assessor(PipelineConfig()).daylight
        self._network = None if weights is None else network.load(weights)

    def __call__(self, case: Case) -> Answer:
        """Estimate the water of a case."""
        estimator = WaterEstimator(
            self._config, case.clear_water, case.transfer, self._daylight, self._network)
        found = estimator.estimate(case.image, case.ranges, range_error=case.range_error)
        return answer_of(found)


def plain(case: Case) -> Answer:
    """Estimate the water of a case by the paper's own fit."""
    return answer_of(fit_plain(case.image, case.ranges, case.clear_water, case.transfer))


def sea_thru(case: Case) -> Answer:
    """Estimate the water of a case by Sea-thru's fit of the backscatter."""
    return answer_of(fit_backscatter(case.image, case.ranges, case.transfer))


def under_lamps(case: LampCase) -> Answer:
    """Estimate the water of a case by the package's estimator under lamps that are told."""
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
