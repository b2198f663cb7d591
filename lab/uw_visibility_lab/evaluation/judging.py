# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""One table for any estimator of water: how often it reports, its errors, its calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr

from uw_visibility.images.arrays import Array
from uw_visibility.optics.light_model import visibility_distance
from uw_visibility.status import Status
from uw_visibility_lab.evaluation.tables import number

# Ratio to the true distance beyond which a distance is too long; too short by its inverse.
FACTOR = 1.2
# Largest ratio of the 84 % to the 16 % quantile of a distance; with more it counts as not told.
WIDEST_INTERVAL = 2.5
# Contrast threshold of an observer (eq. 11).
CONTRAST = 0.05


@dataclass(frozen=True)
class Answer:
    """An estimator's answer to a case."""

    status: str  # ``"ok"`` or the reason for no distance
    # log_attenuation, stddev: (3,); mean and standard deviation of ln β; NaN if not estimated
    log_attenuation: Array
    stddev: Array
    # log_distance, distance_stddev: mean and standard deviation of the logarithm of the
    # visibility distance, up to a constant: −ln min β
    log_distance: float = math.nan
    distance_stddev: float = math.nan

    @property
    def told(self) -> bool:
        """Whether there is a distance, and its interval is at most `WIDEST_INTERVAL`."""
        return (
            self.status == Status.OK.value and math.isfinite(self.log_distance)
            and 2.0 * self.distance_stddev <= math.log(WIDEST_INTERVAL))


@dataclass(frozen=True)
class Row:
    """The table's row of one kind of cases; parts, 0..1, are of the cases that are told."""

    cases: int  # number
    told: float  # part of all cases, see `Answer.told`
    # error, distance_error: root mean square of the error of ln β (all estimated channels) and of
    # ln distance
    error: float
    distance_error: float
    score: float  # root mean square of the distance's error over its deviation: 1 is calibrated
    within: tuple[float, float, float]  # part of the distances within 1, 2, 3 deviations
    beyond: float  # part of the cases with any β or the distance beyond 3 deviations
    too_long: float  # too_long, too_short: part of the distances, see `FACTOR`
    too_short: float
    low_above: float  # part of the intervals (16 to 84 %) whose lower end is above the truth
    crps: float  # mean continuous ranked probability score of ln distance
    milliseconds: float  # median time


@dataclass(frozen=True, eq=False)
class Judged:
    """An estimator's answer to a case, and the truth."""

    scene: str  # the case's name
    answer: Answer
    attenuation: Array  # (3,); true β, 1/m
    milliseconds: float  # time of the estimator

    @property
    def off(self) -> Array:
        """Errors of ln β, (3,); NaN if not estimated."""
        return np.asarray(self.answer.log_attenuation - np.log(self.attenuation))

    @property
    def clearest(self) -> float:
        """True β of the clearest channel, of the estimated ones if there are any."""
        told = np.isfinite(self.answer.log_attenuation)
        return float(self.attenuation[told | ~told.any()].min())

    @property
    def far(self) -> float:
        """Error of ln distance; NaN if not estimated."""
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
        error=rms(off[np.isfinite(off)]), distance_error=rms(far), score=rms(scores),
        within=tuple(float((np.abs(scores) <= k).mean()) for k in (1, 2, 3)),  # type: ignore[arg-type]
        beyond=float(np.mean([each.beyond for each in told])),
        too_long=float((far > math.log(FACTOR)).mean()),
        too_short=float((far < -math.log(FACTOR)).mean()),
        low_above=float((scores > 1.0).mean()), crps=float(_crps(far, width).mean()),
        milliseconds=milliseconds)


HEAD = (
    f"{'cases':24} {'n':>5} {'told':>5} {'ln β':>5} {'ln d':>5} {'score':>5} {'1 σ':>4} {'2 σ':>4} "
    f"{'3 σ':>4} {'>3 σ':>5} {'long':>5} {'short':>5} {'low':>4} {'crps':>5} {'ms':>6}")


def line_of(name: str, row: Row) -> str:
    """Return a row as a line below `HEAD`."""
    one, two, three = row.within
    # Peers' σ may be near 0.
    score = ">99.9" if row.score > 99.9 else f"{row.score:5.2f}"
    return (
        f"{name[:24]:24} {row.cases:5d} {row.told:5.2f} {row.error:5.2f} "
        f"{row.distance_error:5.2f} {score} {one:4.2f} {two:4.2f} {three:4.2f} "
        f"{row.beyond:5.3f} {row.too_long:5.2f} {row.too_short:5.2f} {row.low_above:4.2f} "
        f"{row.crps:5.2f} {number(row.milliseconds, 1):>6}")


def rms(values: Array) -> float:
    """Return the root mean square; NaN without values."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _crps(off: Array, stddev: Array) -> Array:
    """Continuous ranked probability score of normal distributions.

    Gneiting and Raftery 2007, doi:10.1198/016214506000001437, eq. 21.
    """
    z = off / stddev
    density = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    return np.asarray(
        stddev * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / math.sqrt(math.pi)))
