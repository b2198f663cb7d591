# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Constants of the check of a depth sensor are found again from series that they made."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.model import Camera
from uw_visibility_lab.evaluation.plausibility import (
    FITTED,
    LEFT_OUT,
    TIMES,
    Seen,
    Series,
    fit,
    log_likelihood,
    render_series,
)
from uw_visibility_lab.simulation.camera import StereoCamera

CONSTANT, PRECISION = 2.0, 0.1


def draw(camera: Camera, seed: int, frames: int = 240, rate: float = 1.0) -> Series:
    """Draw a series as a `Camera` of one scale errs."""
    random, stddev = np.random.default_rng(seed), PlausibilityConfig().model_stddev
    constant = camera.constant * CONSTANT * random.standard_normal()
    told = math.hypot(CONSTANT, PRECISION)
    sizes = np.array((camera.fast * PRECISION, camera.slow * CONSTANT))
    kept = np.exp(-1.0 / rate / np.array((camera.fast_time, camera.slow_time)))
    wander = sizes * random.standard_normal(2)
    series = []
    for index in range(frames):
        wander = kept * wander + sizes * np.sqrt(1.0 - kept**2) * random.standard_normal(2)
        if random.random() < -math.expm1(-camera.bursts / rate):
            wander[0] += camera.burst * stddev * random.standard_normal()
        noise = camera.outlier * stddev * random.standard_normal() * (
            random.random() < camera.outliers)
        truth = 6.0 - 3.0 * math.cos(0.02 * index / rate)
        error = constant + float(wander.sum()) + noise
        series.append(Seen(
            index / rate, truth, truth - error, told, PRECISION))
    return series


@functools.cache
def true_series() -> tuple[list[Series], float]:
    """Some series, and their likelihood by what they were drawn with."""
    series = [draw(TRUE, seed) for seed in range(3)]
    return series, log_likelihood(TRUE, series)


TRUE = Camera(
    constant=1.0, slope=0.1, fast=1.5, fast_time=3.0, slow=0.1, slow_time=60.0,
    bursts=0.04, burst=6.0, outliers=0.1, outlier=3.0, spread=1.01)


@pytest.mark.parametrize("wrong", [
    {"fast": 6.0}, {"fast": 0.3}, {"slow": 1.0}, {"slow": 0.001}, {"constant": 0.05},
    {"constant": 20.0}, {"slope": 10.0}, {"bursts": 1.0}, {"bursts": 1e-4}, {"burst": 1.0},
    {"outliers": 0.6}, {"outliers": 0.001}, {"outlier": 0.5}, {"spread": 6.0},
])
def test_constants_that_made_a_series_are_likelier_than_others(
    wrong: dict[str, float]
) -> None:
    series, likelihood = true_series()
    assert likelihood > 2.0 + log_likelihood(TRUE._replace(**wrong), series)


def test_fit_finds_what_made_the_series() -> None:
    series = [draw(TRUE, seed, 80) for seed in range(2)]
    start = TRUE._replace(fast=5.0, outliers=0.4)
    found = fit(series, start, 4)
    assert log_likelihood(found, series) > log_likelihood(start, series) + 10.0
    assert abs(math.log(found.fast / TRUE.fast)) < math.log(5.0 / TRUE.fast) - 0.3
    assert all(low <= getattr(found, name) * 1.001 and getattr(found, name) <= high * 1.001
               for name, (low, high) in TIMES.items())


def test_frames_without_depth_are_left_out() -> None:
    series = draw(TRUE, 1, 40)
    gaps = [
        replace(seen, depth=math.nan) if k % 3 else seen for k, seen in enumerate(series)]
    told = [seen for k, seen in enumerate(series) if k % 3 == 0]
    assert log_likelihood(TRUE, [gaps]) == log_likelihood(TRUE, [told])
    assert log_likelihood(TRUE, [[replace(seen, depth=math.nan) for seen in series]]) == 0.0


def test_a_series_has_the_true_depth_of_each_frame() -> None:
    way = replace(
        FITTED["1 grey, 2 to 6 m"], frames=2, camera=StereoCamera(96, 72, 90.0, 0.12), seed=3)
    series = render_series(way, Workers(1))
    assert [(seen.time, seen.truth) for seen in series] == [(0.0, 2.0), (0.5, 6.0)]


def test_no_way_that_is_left_out_was_fitted_to() -> None:
    assert not {t.seed for t in FITTED.values()} & {t.seed for t in LEFT_OUT.values()}
    assert not FITTED.keys() & LEFT_OUT.keys()
