# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The judge's figures for estimators whose faults are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr

from uw_visibility_lab.evaluation.judging import HEAD, WIDEST_INTERVAL, Answer, Row, line_of, row_of
from uw_visibility_lab.posterior.judge import (
    Case,
    Estimator,
    ask,
    describe,
    flips,
    plain,
    sea_thru,
)

NUMBER = 3000


def cases(number: int = NUMBER) -> list[Case]:
    rng = np.random.default_rng(0)
    return [
        Case(np.zeros((4, 6, 3), np.uint8), np.ones((4, 6), np.float32), 0.0, "linear",
             np.full(3, 0.05), rng.uniform(0.05, 0.5, 3), str(i)) for i in range(number)]


def judge(estimator: Estimator, cases: list[Case]) -> Row:
    return row_of([ask(estimator, case) for case in cases])


class Faulty:
    """Errs by a bias and a deviation in all channels, and tells another deviation."""

    def __init__(self, bias: float = 0.0, stddev: float = 0.1, told: float = 0.1) -> None:
        self._rng = np.random.default_rng(1)
        self._bias, self._stddev, self._told = bias, stddev, told

    def __call__(self, case: Case) -> Answer:
        assert case.attenuation is not None
        log = np.log(case.attenuation) + self._bias + self._stddev * self._rng.normal()
        return Answer("ok", log, np.full(3, self._told), float(-log.min()), self._told)


def test_an_estimator_that_knows_its_errors_scores_one() -> None:
    row = judge(Faulty(), cases())
    assert row.told == 1.0
    assert row.error == pytest.approx(0.1, rel=0.1) == row.distance_error
    assert row.score == pytest.approx(1.0, abs=0.1)
    assert row.within[0] == pytest.approx(0.68, abs=0.06)
    assert row.low_above == pytest.approx(0.16, abs=0.05)
    assert row.beyond < 0.02


def test_a_bias_shows_as_too_long_or_too_short() -> None:
    # Attenuation that is too low is a distance that is too long.
    assert judge(Faulty(bias=-0.4), cases()).too_long > 0.95
    assert judge(Faulty(bias=0.4), cases()).too_short > 0.95


def test_overconfidence_shows_in_score_and_coverage() -> None:
    row = judge(Faulty(told=0.025), cases())
    assert row.score == pytest.approx(4.0, rel=0.1)
    assert row.beyond > 0.4 and row.within[0] < 0.3
    assert row.crps > judge(Faulty(), cases()).crps


def test_crps_is_that_of_the_normal_distribution() -> None:
    row = judge(Faulty(bias=-0.05, stddev=0.0, told=0.1), cases(1))
    expected = quad(lambda x: (ndtr((x - 0.05) / 0.1) - (x > 0)) ** 2, -1, 1, points=[0.0])[0]
    assert row.crps == pytest.approx(expected, rel=1e-4)


def test_wide_intervals_and_refusals_are_not_told() -> None:
    wide = math.log(WIDEST_INTERVAL) / 2.0
    assert judge(Faulty(told=1.01 * wide), cases(4)).told == 0.0
    assert judge(Faulty(told=0.99 * wide), cases(4)).told == 1.0
    nothing = np.full(3, np.nan)
    assert judge(lambda case: Answer("too dark", nothing, nothing), cases(4)).told == 0.0


def test_a_channel_that_is_not_told_does_not_count() -> None:
    def without_red(case: Case) -> Answer:
        assert case.attenuation is not None
        log = np.log(case.attenuation)
        log[0] = np.nan
        return Answer("ok", log, np.full(3, 0.1), float(-np.nanmin(log)), 0.1)

    row = judge(without_red, cases(20))
    assert row.error == row.beyond == 0.0
    # Two logarithms of one value, whose last bit depends on the processor.
    assert row.distance_error == pytest.approx(0.0, abs=1e-12)


def test_published_fits_are_estimators_that_tell_their_own_water() -> None:
    ranges = np.tile(np.linspace(1.0, 8.0, 240, dtype=np.float32), (160, 1))
    beta, dark = np.array([0.6, 0.35, 0.3]), np.random.default_rng(2).random((160, 240)) < 0.1
    light = np.exp(-beta * ranges[..., np.newaxis])
    image = np.round(65535 * 0.9 * (1.0 - np.where(dark[..., np.newaxis], 1.0, 0.6) * light))
    case = Case(
        image.astype(np.uint16), ranges, 0.0, "linear", np.array([0.23, 0.07, 0.02]), beta)
    for estimator in (plain, sea_thru):
        judged = ask(estimator, case)
        assert judged.answer.told
        assert np.abs(judged.off).max() < 0.05 and abs(judged.far) < 0.05
        assert judged.row()["distance"] == pytest.approx(judged.row()["true.distance"], rel=0.05)


def test_flips_and_moves_of_a_nervous_estimator() -> None:
    def calm(case: Case) -> Answer:
        return Answer("ok", np.zeros(3), np.full(3, 0.1), 1.0, 0.1)

    def nervous(case: Case) -> Answer:
        odd = case.image.shape[0] % 2
        return Answer("too dark" if odd else "ok", np.zeros(3), np.full(3, 0.1), 1.0, 0.1)

    def moving(case: Case) -> Answer:
        return Answer("ok", np.zeros(3), np.full(3, 0.1), 1.0 + 0.1 * case.image.shape[0], 0.1)

    assert flips(calm, cases(5)) == (0.0, 0.0)
    # One of the three changes cuts a row off.
    assert flips(nervous, cases(5))[0] == pytest.approx(1 / 3)
    assert flips(moving, cases(5)) == (0.0, pytest.approx(math.sqrt(1 / 3)))


def test_the_table_has_a_line_for_each_row() -> None:
    line = line_of("plain", judge(Faulty(), cases(10)))
    assert line.split()[0] == "plain" and line.split()[1] == "10"
    assert len(line) == len(HEAD)


def test_a_distance_is_described_with_its_interval() -> None:
    told = Answer("ok", np.zeros(3), np.zeros(3), math.log(10.0), 0.1)
    assert describe(told).split() == ["23.5", "(21.3", "to", "26.0)"]
    assert describe(Answer("too dark", np.zeros(3), np.zeros(3))) == "too dark"
