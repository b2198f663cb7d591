# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A depth sensor against the estimates: honest, jumping, drifting, silent, biased."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.comparison import DepthSample, Report, Verdict, interpolate
from uw_visibility.plausibility.monitor import DepthMonitor
from uw_visibility.status import Status

SECOND = 1_000_000_000
CONFIG = PlausibilityConfig()
RATE = 2.0


def sample(seconds: float, depth: float, stddev: float = 0.1) -> DepthSample:
    return DepthSample(round(seconds * SECOND), depth, stddev**2)


def run(
    config: PlausibilityConfig = CONFIG, frames: int = 500, stddev: float = 0.2, bias: float = 0.0,
    seed: int = 0, fault: Callable[[float], float] = lambda time: 0.0,
) -> list[Report]:
    """Swim down and up again at 2 Hz with a sensor at 10 Hz; return the report of each frame."""
    random = np.random.default_rng(seed)
    monitor, reports = DepthMonitor(config), []

    def depth(time: float) -> float:
        return 6.0 - 4.0 * math.cos(0.02 * time)

    for index in range(frames):
        time = 0.03 + index / RATE
        for tick in range(5):
            moment = time + (tick - 4) * 0.1 + 0.05
            value = depth(moment) + fault(moment)
            monitor.add_sensor(sample(moment, value + 0.05 * random.standard_normal(), 0.05), time)
        estimate = depth(time) + bias + stddev * random.standard_normal()
        monitor.add_estimate(sample(time, estimate, stddev), Status.OK, time)
        reports.append(monitor.report(time))
    return reports


def first(reports: list[Report], verdict: Verdict) -> int:
    return next(i for i, report in enumerate(reports) if report.verdict is verdict)


@pytest.mark.parametrize("seed", range(5))
def test_honest_sensor_is_never_accused(seed: int) -> None:
    # The estimate's own deviation is all that there is, the worst case.
    reports = run(replace(CONFIG, model_stddev=0.0), seed=seed)
    assert {report.verdict for report in reports} <= {Verdict.OK, Verdict.WARN}
    assert reports[-1].compared == 500
    assert sum(report.verdict is Verdict.WARN for report in reports) < 5


def test_nis_follows_chi_squared() -> None:
    reports = run(replace(CONFIG, model_stddev=0.0), frames=2000)
    nis = np.array([report.last.nis for report in reports if report.last])
    # Mean 1 and variance 2 of chi squared with one degree of freedom.
    assert nis.mean() == pytest.approx(1.0, abs=4 * math.sqrt(2 / nis.size))
    assert reports[-1].failed / reports[-1].compared == pytest.approx(0.05, abs=0.02)


@pytest.mark.parametrize("size", [1.5, -1.5])
def test_jump_is_an_error_within_ten_frames(size: float) -> None:
    reports = run(fault=lambda time: size if time > 50.0 else 0.0, frames=140)
    before = [report.verdict for report in reports[:100]]
    assert set(before) == {Verdict.OK}
    assert first(reports, Verdict.WARN) <= 100 + 5
    assert first(reports, Verdict.ERROR) <= 100 + 10
    assert reports[-1].last is not None
    assert reports[-1].last.innovation == pytest.approx(size, abs=1.0)
    assert "in a row beyond their gate" in reports[-1].reason


def test_slow_drift_is_an_error_soon_after_a_metre_and_a_half() -> None:
    # 1 cm/s from 50 s on: 1.5 m at 200 s, the 400th frame.
    reports = run(fault=lambda time: 0.01 * max(time - 50.0, 0.0))
    assert {report.verdict for report in reports[:100]} == {Verdict.OK}
    assert first(reports, Verdict.ERROR) <= 400 + 10


def test_recovered_sensor_is_believed_again() -> None:
    reports = run(fault=lambda time: 3.0 if 20.0 < time < 40.0 else 0.0, frames=160)
    assert reports[70].verdict is Verdict.ERROR
    assert reports[-1].verdict is Verdict.OK


def test_uncertain_estimate_proves_nothing_and_does_not_clear_the_sensor() -> None:
    monitor = DepthMonitor(CONFIG)
    for index in range(10):
        monitor.add_sensor(sample(index, 8.0), index)
        monitor.add_estimate(sample(index, 5.0, 0.1), Status.OK, index)
    assert monitor.report(9).verdict is Verdict.ERROR
    monitor.add_sensor(sample(10, 8.0), 10)
    (comparison,) = monitor.add_estimate(sample(10, 7.9, 2.0), Status.OK, 10)
    assert comparison.passed and not comparison.conclusive
    report = monitor.report(10)
    assert (report.verdict, report.consecutive, report.inconclusive) == (Verdict.ERROR, 10, 1)
    for index in (11, 12, 13):
        monitor.add_sensor(sample(index, 8.0), index)
        monitor.add_estimate(sample(index, 7.9, 2.0), Status.OK, index)
    report = monitor.report(13)
    assert report.verdict is Verdict.NOT_ASSESSABLE
    assert "too uncertain" in report.reason


def test_estimate_that_is_not_assessable_says_why() -> None:
    monitor = DepthMonitor(CONFIG)
    monitor.add_sensor(sample(1.0, 5.0), 1.0)
    monitor.add_estimate(DepthSample(SECOND, math.nan, math.nan), Status.NO_COLOUR, 1.0)
    report = monitor.report(1.0)
    assert (report.verdict, report.compared) == (Verdict.NOT_ASSESSABLE, 0)
    assert report.reason == "the depth is not assessable: no colour"


@pytest.mark.parametrize(("sensor", "estimate", "reason"), [
    (None, 10.0, "no depth_sensor yet"),
    (10.0, None, "no estimate yet"),
    (7.0, 10.0, "no depth_sensor for 3.0 s"),
    (10.0, 7.0, "no estimate for 3.0 s"),
])
def test_silence_of_either_side_is_stale(
    sensor: float | None, estimate: float | None, reason: str
) -> None:
    monitor = DepthMonitor(CONFIG)
    if sensor is not None:
        monitor.add_sensor(sample(sensor, 5.0), sensor)
    if estimate is not None:
        monitor.add_estimate(sample(estimate, 5.0), Status.OK, estimate)
    report = monitor.report(10.0)
    assert (report.verdict, report.reason) == (Verdict.STALE, reason)


def test_sensor_of_another_clock_is_stale_and_waiting_estimates_are_bounded() -> None:
    monitor = DepthMonitor(CONFIG)
    for index in range(1000):
        monitor.add_sensor(sample(index / 10, 5.0), index / 10)
        monitor.add_estimate(sample(1e6 + index / 10, 5.0), Status.OK, index / 10)
    report = monitor.report(99.9)
    assert report.verdict is Verdict.STALE
    assert "are both on one clock?" in report.reason
    assert report.unmatched > 900


def test_estimate_waits_for_the_sensor() -> None:
    monitor = DepthMonitor(CONFIG)
    monitor.add_sensor(sample(1.0, 4.0), 1.0)
    assert monitor.add_estimate(sample(1.25, 5.0), Status.OK, 1.3) == []
    (comparison,) = monitor.add_sensor(sample(1.5, 6.0), 1.5)
    assert comparison.sensor.depth == pytest.approx(5.0)
    assert comparison.innovation == pytest.approx(0.0)
    assert comparison.variance == pytest.approx(0.01 + 0.01 + CONFIG.model_stddev**2)


def test_learned_bias_is_taken_off_and_reported_with_its_uncertainty() -> None:
    config = replace(CONFIG, bias_window=40)
    reports = run(config, bias=-2.0, frames=200)
    assert {report.verdict for report in reports[:39]} == {Verdict.LEARNING}
    assert math.isnan(reports[38].bias)
    assert "nothing is judged yet" in reports[38].reason
    assert reports[-1].bias == pytest.approx(2.0, abs=4 * reports[-1].bias_stddev)
    assert 0.0 < reports[-1].bias_stddev < 0.1
    assert {report.verdict for report in reports[39:]} == {Verdict.OK}
    assert "after a learned bias of +" in reports[-1].reason
    # Without learning the same sensor is an error: the bias is not simply ignored.
    assert run(bias=-2.0, frames=60)[-1].verdict is Verdict.ERROR


def test_jump_after_learning_is_still_seen() -> None:
    config = replace(CONFIG, bias_window=40)
    reports = run(
        config, frames=140, bias=1.0, fault=lambda time: 1.5 if time > 50.0 else 0.0
    )
    assert first(reports, Verdict.ERROR) <= 100 + 10


def test_reset_forgets_all() -> None:
    monitor = DepthMonitor(CONFIG)
    monitor.add_sensor(sample(1.0, 4.0), 1.0)
    monitor.add_estimate(sample(1.0, 9.0), Status.OK, 1.0)
    monitor.reset()
    report = monitor.report(1.0)
    assert (report.compared, report.last, report.verdict) == (0, None, Verdict.STALE)


def test_recording_that_starts_again_is_followed() -> None:
    monitor = DepthMonitor(CONFIG)
    for start in (0.0, 100.0):
        for index in range(20):
            monitor.add_sensor(sample(index, 5.0), start + index)
            monitor.add_estimate(sample(index, 5.0), Status.OK, start + index)
    assert monitor.report(119.0).compared == 40


@pytest.mark.parametrize(("seconds", "depth"), [
    (1.0, 2.0), (1.5, 3.0), (2.0, 4.0), (2.75, 1.0), (0.9, None), (3.1, None), (6.0, None),
])
def test_interpolation(seconds: float, depth: float | None) -> None:
    series = [sample(1.0, 2.0), sample(2.0, 4.0), sample(3.0, 0.0)]
    found = interpolate(series, round(seconds * SECOND), 2.0)
    assert (found.depth if found else None) == depth


def test_gap_in_the_sensor_is_not_bridged() -> None:
    assert interpolate([sample(1.0, 2.0), sample(4.0, 4.0)], 2 * SECOND, 2.0) is None
