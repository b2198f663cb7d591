# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Constants of the check of a depth sensor are found again from series that they made."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from uw_visibility.plausibility.model import Camera
from uw_visibility_lab.evaluation.plausibility.fit import TIMES, fit, log_likelihood
from uw_visibility_lab.evaluation.plausibility.series import Series

TRUE = Camera(
    constant=1.0, slope=0.1, fast=1.5, fast_time=3.0, slow=0.1, slow_time=60.0,
    bursts=0.04, burst=6.0, outliers=0.1, outlier=3.0, spread=1.01)


@pytest.mark.parametrize("wrong", [
    {"fast": 6.0}, {"fast": 0.3}, {"slow": 1.0}, {"slow": 0.001}, {"constant": 0.05},
    {"constant": 20.0}, {"slope": 10.0}, {"bursts": 1.0}, {"bursts": 1e-4}, {"burst": 1.0},
    {"outliers": 0.6}, {"outliers": 0.001}, {"outlier": 0.5}, {"spread": 6.0},
])
def test_constants_that_made_a_series_are_likelier_than_others(
    wrong: dict[str, float], draw: Callable[..., Series]
) -> None:
    series = [draw(TRUE, seed) for seed in range(4)]
    assert log_likelihood(TRUE, series) > 2.0 + log_likelihood(TRUE._replace(**wrong), series)


def test_fit_finds_what_made_the_series(draw: Callable[..., Series]) -> None:
    series = [draw(TRUE, seed, 80) for seed in range(2)]
    start = TRUE._replace(fast=5.0, outliers=0.4)
    found = fit(series, start, 4)
    assert log_likelihood(found, series) > log_likelihood(start, series) + 10.0
    assert abs(math.log(found.fast / TRUE.fast)) < math.log(5.0 / TRUE.fast) - 0.3
    assert all(low <= getattr(found, name) * 1.001 and getattr(found, name) <= high * 1.001
               for name, (low, high) in TIMES.items())


def test_frames_without_depth_are_left_out(draw: Callable[..., Series]) -> None:
    series = draw(TRUE, 1, 40)
    gaps = [
        replace(seen, depth=math.nan) if k % 3 else seen for k, seen in enumerate(series)]
    told = [seen for k, seen in enumerate(series) if k % 3 == 0]
    assert log_likelihood(TRUE, [gaps]) == log_likelihood(TRUE, [told])
    assert log_likelihood(TRUE, [[replace(seen, depth=math.nan) for seen in series]]) == 0.0
