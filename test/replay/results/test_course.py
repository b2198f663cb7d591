# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A trend and two groups are found where they are, and hardly ever where they are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from uw_visibility.images.arrays import Array
from uw_visibility.replay.results.synopsis import groups, trend

Random = np.random.Generator


def constant(random: Random, n: int) -> Array:
    return 10.0 * np.exp(0.1 * random.normal(size=n))


def correlated(random: Random, n: int) -> Array:
    """Errors of neighbours are alike, as of frames that see the same."""
    error = random.normal(size=n)
    for k in range(1, n):
        error[k] += 0.6 * error[k - 1]
    return 10.0 * np.exp(0.1 * error)


def uniform(random: Random, n: int) -> Array:
    return random.uniform(8.0, 12.0, n)


def ramp(random: Random, n: int) -> Array:
    return np.geomspace(10.0, 15.0, n) * np.exp(0.1 * random.normal(size=n))


def jumping(random: Random, n: int) -> Array:
    return np.where(random.random(n) < 0.4, 9.0, 25.0) * np.exp(0.1 * random.normal(size=n))


def shares(make: Callable[[Random, int], Array], n: int, runs: int = 50) -> tuple[float, float]:
    """Share of series with a trend, and with two groups."""
    random = np.random.default_rng(n)
    found = [
        (bool(trend(series)), bool(groups(series)))
        for series in (make(random, n) for _ in range(runs))]
    return tuple(np.mean(found, axis=0))  # type: ignore[return-value]


@pytest.mark.parametrize("n", [5, 12, 60, pytest.param(300, marks=pytest.mark.long)])
def test_noise_is_neither_a_trend_nor_two_groups(n: int) -> None:
    for make in (constant, uniform):
        rising, jumps = shares(make, n)
        # Two standard deviations are 4.6 %, with what 50 runs leave open.
        assert rising <= 0.11
        assert jumps <= 0.04


def test_errors_that_neighbours_have_in_common_are_hardly_a_trend() -> None:
    # Kendall's test itself, which takes them for independent, says so of 33 %.
    assert shares(correlated, 100)[0] <= 0.2


@pytest.mark.parametrize("n", [30, pytest.param(700, marks=pytest.mark.long)])
def test_a_ramp_is_a_trend_and_has_no_groups(n: int) -> None:
    rising, jumps = shares(ramp, n, 30)
    assert rising >= 0.95
    assert jumps <= 0.04
    first, last = trend(ramp(np.random.default_rng(0), n))
    assert (first, last) == pytest.approx((10.7, 14.0), rel=0.1)
    assert trend(ramp(np.random.default_rng(0), n)[::-1]) == [last, first]


@pytest.mark.parametrize("n", [40, pytest.param(2000, marks=pytest.mark.long)])
def test_jumps_between_two_values_are_two_groups(n: int) -> None:
    assert shares(jumping, n, 30)[1] >= 0.95
    (low, few), (high, many) = groups(jumping(np.random.default_rng(3), n))
    assert (low, high) == pytest.approx((9.0, 25.0), rel=0.1)
    assert few + many == n
    assert few < many


def test_one_frame_that_differs_is_no_group() -> None:
    series = constant(np.random.default_rng(0), 60)
    series[20] = 60.0
    assert groups(series) == []
    series[40] = 60.0
    assert groups(series)[1] == (pytest.approx(60.0), 2)


@pytest.mark.parametrize("series", [[], [3.0], [9.0, 25.0, 9.0, 25.0], [5.0] * 50])
def test_too_few_values_or_one_and_the_same_say_nothing(series: list[float]) -> None:
    assert trend(np.array(series)) == []
    assert groups(np.array(series)) == []
