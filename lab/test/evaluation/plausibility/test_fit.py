# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Constants of the check of a depth sensor are found again from series that they made."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from uw_visibility.errors import InputError
from uw_visibility.plausibility.model import Camera
from uw_visibility_lab.evaluation.plausibility.fit import fit, log_likelihood
from uw_visibility_lab.evaluation.plausibility.series import Series

TRUE = Camera(
    constant=1.0, slope=0.1, noise=0.8, fast=1.5, fast_time=3.0, slow=0.5, slow_time=60.0,
    outliers=0.04, outlier=4.0, spread=1.01)


@pytest.mark.parametrize("wrong", [
    {"noise": 2.4, "fast": 4.5}, {"noise": 0.3, "fast": 0.5}, {"slow": 3.0}, {"slow": 0.05},
    {"constant": 0.05}, {"constant": 20.0}, {"slope": 10.0}, {"outliers": 0.3},
    {"outliers": 0.001}, {"outlier": 1.0}, {"fast_time": 0.2}, {"spread": 6.0},
])
def test_constants_that_made_a_series_are_likelier_than_others(
    wrong: dict[str, float], draw: Callable[..., Series]
) -> None:
    series = [draw(TRUE, seed) for seed in range(4)]
    assert log_likelihood(TRUE, series) > 2.0 + log_likelihood(TRUE._replace(**wrong), series)


def test_fit_finds_what_made_the_series(draw: Callable[..., Series]) -> None:
    series = [draw(TRUE, seed, 120) for seed in range(3)]
    start = TRUE._replace(noise=2.0, fast=4.0, outliers=0.1)
    found = fit(series, start, 160)
    assert log_likelihood(found, series) > log_likelihood(start, series) + 10.0
    assert abs(math.log(math.hypot(found.noise, found.fast) / math.hypot(0.8, 1.5))) < 0.5
    assert found == fit(series, start, 160)


def test_frames_without_depth_are_left_out(draw: Callable[..., Series]) -> None:
    series = draw(TRUE, 1, 40)
    gaps = [
        replace(seen, depth=math.nan) if k % 3 else seen for k, seen in enumerate(series)]
    told = [seen for k, seen in enumerate(series) if k % 3 == 0]
    assert log_likelihood(TRUE, [gaps]) == log_likelihood(TRUE, [told])
    assert log_likelihood(TRUE, [[replace(seen, depth=math.nan) for seen in series]]) == 0.0


def test_without_series_there_is_nothing_to_fit_to() -> None:
    with pytest.raises(InputError, match="give one or more"):
        fit([])
