# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Means, worst cases and shares of estimates whose errors are chosen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uw_visibility_lab.evaluation.readings import Reading, Truth
from uw_visibility_lab.evaluation.summary import water_errors

KAPPA = np.array([0.23, 0.07, 0.02])


def place(alpha, error, stddev=0.01, depth=2.0, distance_factor=1.0, depth_error=0.0):
    truth = Truth.of_clear_water_and_particles(alpha, depth, KAPPA, 0.05)
    beta = tuple(value + error for value in truth.attenuation)
    reading = Reading(
        "ok", "ok", "ok", beta, (stddev,) * 3, truth.ambient_light, (stddev,) * 3,
        alpha + error, stddev, truth.distance * distance_factor, 0.1, depth + depth_error, 0.1)
    return truth, reading, f"α = {alpha:g}"


def test_errors_have_mean_worst_and_its_place():
    errors = water_errors([
        place(0.1, 0.01, distance_factor=1.1, depth_error=-0.3), place(0.2, -0.03),
        place(0.3, 0.02, distance_factor=0.7)])
    assert errors["mean_attenuation_error"]["mean"] == pytest.approx(0.02)
    assert errors["mean_attenuation_error"]["worst"] == pytest.approx(0.03)
    assert errors["mean_attenuation_error"]["worst_at"] == "α = 0.2"
    assert errors["distance_relative_error"]["worst"] == pytest.approx(0.3)
    assert errors["depth_error"]["worst"] == pytest.approx(0.3)
    assert errors["depth_error"]["mean"] == pytest.approx(0.1)


def test_distances_in_clear_water_do_not_count_as_turbid():
    errors = water_errors([place(0.0, 0.0, distance_factor=3.0), place(0.05, 0.0)])
    assert errors["distance_relative_error"]["worst"] == pytest.approx(2.0)
    assert errors["distance_relative_error_turbid"]["worst"] == pytest.approx(0.0)
    assert errors["distance_relative_error_turbid"]["of"] == 1


def test_normalised_errors_count_every_channel():
    errors = water_errors([place(0.1, 0.005), place(0.1, 0.015), place(0.1, 0.025)])
    within = errors["attenuation_within"]
    assert (within["1_sigma"], within["2_sigma"], within["3_sigma"]) == (
        pytest.approx(1 / 3), pytest.approx(2 / 3), 1.0)
    assert within["of"] == 9
    assert errors["mean_attenuation_within"]["of"] == 3


def test_what_is_not_assessed_is_counted_by_reason():
    truth, reading, _ = place(0.1, 0.0)
    near = replace(reading, distance=math.nan, distance_status="range spread too small")
    errors = water_errors([
        (truth, reading, "a"), (truth, near, "b"), (truth, Reading.refused("no texture"), "c")])
    assert errors["not_assessed"] == {"no texture": ["c"]}
    assert errors["distance_not_assessed"] == {
        "range spread too small": ["b"], "no texture": ["c"]}
    assert errors["mean_attenuation_error"]["assessed"] == 2
    assert errors["distance_relative_error"]["assessed"] == 1
    assert errors["mean_attenuation_error"]["of"] == 3
