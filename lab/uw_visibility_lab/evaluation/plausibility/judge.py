# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What the check of a depth sensor says of right and of wrong sensors over a series."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from itertools import product

import numpy as np

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.comparison import DepthSample, Report, Verdict
from uw_visibility.plausibility.model import CAMERA, Camera
from uw_visibility.plausibility.monitor import DepthMonitor
from uw_visibility.status import Status
from uw_visibility_lab.evaluation.plausibility.series import Seen, Series, there_and_back
from uw_visibility_lab.evaluation.tables import as_text, number

SENSOR_STDDEV = 0.05
"""Of the sensor that is made for a series, m: a common pressure sensor's."""
JUMPS = (1.5, 3.0)
"""Sizes of a jump, m; each up and down, at three moments, s."""
MOMENTS = (20.0, 60.0, 100.0)
ONSETS = (0.0, 30.0, 50.0)
"""Moments at which a drift begins, s; each up and down."""
DRIFT = 0.5 / 60.0
"""Rate of a drift, m/s."""
ABSURD = 60.0
"""Offset of a sensor that is wrong from the start, m."""

Fault = Callable[[float], float]


@dataclass(frozen=True)
class Judgement:
    """Judgement of the check over a series."""

    # beyond, beyond_back: share of a right sensor's comparisons beyond their gate, over the way
    # there, and there and back
    beyond: float
    beyond_back: float
    warned: int  # warned, accused: frames of a right sensor with a warning or an error, both ways
    accused: int
    jumps: dict[float, list[float]]  # times, s, from a jump of a size, m, to the error; inf: none
    # how far a drift from a moment, s, has come by its error, m; infinite without one
    drifts: dict[float, list[float]]
    absurd: int  # frames up to the error of a sensor that is 60 m off

    def cells(self) -> list[str]:
        """Return the judgement as cells of a table, see `HEAD`."""
        late = [self.jumps[size] for size in JUMPS] + [self.drifts[onset] for onset in ONSETS]
        return [
            number(100.0 * self.beyond, 1), number(100.0 * self.beyond_back, 1),
            str(self.warned), str(self.accused),
            *(f"{number(min(times), 2)}..{number(max(times), 2)}" for times in late),
            str(self.absurd),
        ]


HEAD = [
    "beyond %", "and back", "warned", "accused",
    *(f"{size:g} m, s" for size in JUMPS), *(f"from {onset:g} s, m" for onset in ONSETS),
    f"{ABSURD:g} m, frames",
]


def judge(series: Series, camera: Camera = CAMERA) -> Judgement:
    """Run the check on a series, there and back, with a right sensor and with wrong ones."""
    dive = there_and_back(series)
    first = series[0].time
    # A fault goes on from where the right sensor's check was before it.
    before: dict[float, _Check] = {}
    check, right = _Check(camera), []
    for seen in dive:
        for moment in (*MOMENTS, *ONSETS):
            if moment not in before and seen.time > first + moment:
                before[moment] = deepcopy(check)
        if not before:
            before[0.0] = deepcopy(check)
        right.append(check.take(seen, 0.0))
    verdicts = [report.verdict for report in right]

    def found(moment: float, fault: Fault) -> float:
        check = deepcopy(before.get(moment, _Check(camera)))
        for seen in dive[check.frames:]:
            if check.take(seen, fault(seen.time - first)).verdict is Verdict.ERROR:
                return seen.time - first
        return math.inf

    jumps: dict[float, list[float]] = {}
    for size, sign, moment in product(JUMPS, (1.0, -1.0), MOMENTS):
        time = found(moment, _jump(sign * size, moment))
        jumps.setdefault(size, []).append(time - moment)
    drifts: dict[float, list[float]] = {}
    for onset, sign in product(ONSETS, (1.0, -1.0)):
        drifts.setdefault(onset, []).append(
            DRIFT * (found(onset, _drift(sign * DRIFT, onset)) - onset))
    check = _Check(camera)
    absurd = next(
        (check.frames for seen in dive if check.take(seen, ABSURD).verdict is Verdict.ERROR),
        len(dive) + 1)
    return Judgement(
        _share(right[len(series) - 1]), _share(right[-1]), verdicts.count(Verdict.WARN),
        verdicts.count(Verdict.ERROR), jumps, drifts, absurd)


class _Check:
    """Check of a seeded sensor, frame by frame."""

    def __init__(self, camera: Camera) -> None:
        self._random = np.random.default_rng(0)
        self._monitor = DepthMonitor(PlausibilityConfig(), camera)
        self.frames = 0  # taken so far

    def take(self, seen: Seen, fault: float) -> Report:
        """Take a frame, with the sensor off by so much, m; return the report after it."""
        stamp = round(1e9 * seen.time)
        depth = seen.truth + fault + SENSOR_STDDEV * self._random.standard_normal()
        self._monitor.add_sensor(DepthSample(stamp, depth, SENSOR_STDDEV**2), seen.time)
        self._monitor.add_estimate(
            DepthSample.estimated(stamp, seen.depth, seen.stddev, seen.precision),
            Status.OK if math.isfinite(seen.depth) else Status.FIT_FAILED, seen.time)
        self.frames += 1
        return self._monitor.report(seen.time)


def table(title: str, judged: dict[str, Judgement]) -> str:
    """Return judgements by the names of their series as a table for the terminal."""
    return as_text([title, *HEAD], [[name, *j.cells()] for name, j in judged.items()])


def _jump(size: float, moment: float) -> Fault:
    return lambda time: size if time > moment else 0.0


def _drift(rate: float, onset: float) -> Fault:
    return lambda time: rate * max(time - onset, 0.0)


def _share(report: Report) -> float:
    return report.failed / report.compared if report.compared else math.nan
