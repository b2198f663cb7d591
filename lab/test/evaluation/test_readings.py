# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Readings beside the truth, as the table of estimators counts them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uw_visibility_lab.evaluation.judging import row_of
from uw_visibility_lab.evaluation.readings import Reading, Truth, judged, reasons_text

TRUTH = Truth.of_water([0.33, 0.17, 0.12], [0.5] * 3, [0.23, 0.07, 0.02], 2.0, 0.05)


def reading(factor: float, stddev: float = 0.1) -> Reading:
    """Return a reading whose β is off by a factor, with a relative standard deviation."""
    beta = factor * np.array(TRUTH.attenuation)
    distance = TRUTH.distance / factor
    return replace(
        Reading.refused("none"), status="ok", distance_status="ok", attenuation=tuple(beta),
        attenuation_stddev=tuple(stddev * beta), distance=distance,
        distance_stddev=stddev * distance)


def test_errors_are_those_of_logarithms() -> None:
    row = row_of([judged(TRUTH, reading(factor)) for factor in (0.8, 1.25)])
    assert row.cases == 2 and row.told == 1.0
    assert row.error == pytest.approx(math.log(1.25))
    assert row.distance_error == pytest.approx(math.log(1.25))
    assert row.score == pytest.approx(10.0 * math.log(1.25))
    assert (row.too_long, row.too_short, row.beyond) == (0.5, 0.5, 0.0)


def test_any_channel_beyond_three_deviations_counts() -> None:
    beta = list(TRUTH.attenuation)
    beta[0] *= 1.5
    off = replace(reading(1.0), attenuation=tuple(beta))
    assert [row_of([judged(TRUTH, each)]).beyond for each in (reading(1.0), off)] == [0.0, 1.0]


def test_refusals_are_not_told_and_counted_by_reason() -> None:
    refused = [Reading.refused("too dark"), Reading.refused("no texture (give more)")]
    row = row_of([judged(TRUTH, each) for each in (reading(1.0), *refused, refused[0])])
    assert (row.cases, row.told) == (4, 0.25)
    assert reasons_text("ours", [reading(1.0), *refused, refused[0]]) == [
        "  ours: too dark: 2; no texture: 1"]
    assert reasons_text("ours", [reading(1.0)]) == []
    assert math.isnan(row_of([judged(TRUTH, refused[0])]).error)
