# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Means, worst cases and reasons of estimates whose errors are chosen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.evaluation.studies import grouped, statistics

KAPPA = np.array([0.23, 0.07, 0.02])


def place(alpha, error, stddev=0.01, depth=2.0, distance_factor=1.0, depth_error=0.0):
    truth = Truth.of_clear_water_and_particles(alpha, depth, KAPPA, 0.05)
    beta = tuple(value + error for value in truth.attenuation)
    reading = Reading(
        "ok", "ok", "ok", beta, (stddev,) * 3, truth.ambient_light, (stddev,) * 3,
        alpha + error, stddev, truth.distance * distance_factor, 0.1, depth + depth_error, 0.1)
    return truth, reading


def test_errors_have_mean_and_worst():
    found = statistics([
        place(0.1, 0.01, distance_factor=1.1, depth_error=-0.3), place(0.2, -0.03),
        place(0.3, 0.02, distance_factor=0.7)])
    assert found["mean_attenuation_error"] == pytest.approx(0.02)
    assert found["mean_attenuation_worst"] == pytest.approx(0.03)
    assert found["depth_error"] == pytest.approx(0.1)
    assert (found["cases"], found["refused"], found["right"]) == (3, 0.0, pytest.approx(2 / 3))


def test_every_channel_has_to_be_within_three_deviations():
    pairs = [place(0.1, 0.005), place(0.1, 0.025), place(0.1, 0.035)]
    assert statistics(pairs)["beyond"]["attenuation"] == pytest.approx(1 / 3)


def test_what_is_not_assessed_is_counted_by_reason():
    truth, reading = place(0.1, 0.0)
    near = replace(reading, distance=math.nan, distance_status="range spread too small")
    found = statistics([(truth, reading), (truth, near), (truth, Reading.refused("no texture"))])
    assert found["reasons"] == {"range spread too small": 1, "no texture": 1}
    assert found["reasons_depth"] == {"no texture": 1}
    assert found["refused"] == pytest.approx(2 / 3)
    assert found["mean_attenuation_error"] == pytest.approx(0.0)
    nothing = statistics([(truth, Reading.refused("no texture"))])
    assert math.isnan(nothing["mean_attenuation_error"])
    assert math.isnan(nothing["mean_attenuation_worst"])


def test_shares_and_ratio_are_of_all_cases():
    truth, right = place(0.1, 0.01)
    right = replace(right, distance_stddev=1.0)
    found = statistics([
        (truth, right),
        # 5 σ of β; 4 σ of visibility, and half as long again.
        (truth, replace(
            right, attenuation=tuple(b - 0.1 for b in truth.attenuation),
            attenuation_stddev=(0.02,) * 3, distance=1.5 * truth.distance,
            distance_stddev=0.1 * truth.distance)),
        # Within σ, yet a quarter too long.
        (truth, replace(right, distance=1.25 * truth.distance, distance_stddev=4.0)),
        (truth, Reading.refused("too dark")),
    ])
    assert found["refused"] == found["right"] == 0.25
    assert found["beyond"] == {"attenuation": 0.25, "visibility": 0.25, "depth": 0.0}
    assert found["beyond_any"] == 0.25
    assert found["too_long"] == 0.5
    assert found["ratio"] == pytest.approx(1.25)
    assert found["attenuation_error"] == pytest.approx((0.01 + 0.10 + 0.01) / 3)
    assert math.isfinite(found["depth_error"])


def test_groups_are_in_the_order_of_their_first():
    assert grouped([3, 1, 2, 5, 4], lambda n: n % 2) == {1: [3, 1, 5], 0: [2, 4]}
