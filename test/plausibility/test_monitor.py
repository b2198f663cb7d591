# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A depth sensor against the estimates: right, jumping, drifting, silent, biased."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.comparison import DepthSample, Report, Verdict, interpolate
from uw_visibility.plausibility.model import CAMERA
from uw_visibility.plausibility.monitor import DepthMonitor
from uw_visibility.status import Status

SECOND = 1_000_000_000
CONFIG = PlausibilityConfig()
RATE = 2.0


def sample(seconds: float, depth: float, stddev: float = 0.1) -> DepthSample:
    return DepthSample(round(seconds * SECOND), depth, stddev**2)


def run(
    frames: int = 240, seed: int = 0, rate: float = RATE, constant: float = 2.5,
    fault: Callable[[float], float] = lambda time: 0.0,
) -> list[Report]:
    """Swim down and up with a sensor at 10 Hz; return the report of each frame.

    The camera is off by a constant, by what wanders, by noise, and in episodes of a few
    seconds by more. Frames that are closer than half a second see the same and err alike.
    """
    random = np.random.default_rng(seed)
    monitor, reports = DepthMonitor(CONFIG), []

    def depth(time: float) -> float:
        return 6.0 - 4.0 * math.cos(0.02 * time)

    offset, wander, episode, noise, scene = constant * random.standard_normal(), 0.0, 0.0, 0.0, -1
    for index in range(frames):
        time = 0.03 + index / rate
        if int(2.0 * time) != scene:
            scene = int(2.0 * time)
            wander = 0.95 * wander + math.sqrt(1.0 - 0.95**2) * 0.1 * random.standard_normal()
            if random.random() < 0.5:
                episode = 0.5 * random.standard_normal() * (random.random() < 0.15)
            noise = 0.1 * random.standard_normal()
        for tick in range(round(10 / rate)):
            moment = time + 0.05 - 0.1 * (round(10 / rate) - 1 - tick)
            value = depth(moment) + fault(moment) + 0.05 * random.standard_normal()
            monitor.add_sensor(sample(moment, value, 0.05), time)
        estimate = DepthSample.estimated(
            round(time * SECOND), depth(time) + offset + wander + episode + noise,
            math.hypot(constant, 0.15), 0.15)
        monitor.add_estimate(estimate, Status.OK, time)
        reports.append(monitor.report(time))
    return reports


def first(reports: list[Report], verdict: Verdict) -> int:
    return next((i for i, r in enumerate(reports) if r.verdict is verdict), len(reports))


@pytest.mark.parametrize("rate", [2.0, 10.0])
def test_right_sensor_is_never_accused_and_its_innovations_pass_as_they_say(rate: float) -> None:
    runs = [run(round(120 * rate), seed, rate) for seed in range(4 if rate < 5.0 else 2)]
    found = [report.verdict for reports in runs for report in reports]
    assert Verdict.ERROR not in found
    assert found.count(Verdict.WARN) < 0.01 * len(found)
    failed = sum(reports[-1].failed for reports in runs)
    assert 0.02 < failed / sum(reports[-1].compared for reports in runs) < 0.07
    # The camera's constant, of 2.5 m, is learned at once, up to what wanders with the water.
    assert found.count(Verdict.OK) > 0.95 * len(found)
    assert max(reports[-1].bias_stddev for reports in runs) < 0.5


@pytest.mark.parametrize(("seed", "size", "rate"), [(0, 3.0, 10.0), (1, -3.0, 1.0), (2, 3.0, 1.0)])
def test_jump_is_an_error_within_five_seconds(seed: int, size: float, rate: float) -> None:
    reports = run(round(70 * rate), seed, rate, fault=lambda time: size if time > 60.0 else 0.0)
    assert 60 * rate <= first(reports, Verdict.ERROR) <= 65 * rate
    assert "a correct sensor shows as much at most once in 100 h" in reports[-1].reason


@pytest.mark.parametrize(("seed", "rate"), [(0, 0.5), (1, -0.5)])
def test_drift_is_an_error_before_a_metre_and_a_half(seed: int, rate: float) -> None:
    reports = run(480, seed, fault=lambda time: rate / 60.0 * max(time - 60.0, 0.0))
    assert 120 <= first(reports, Verdict.ERROR) <= 2 * (60 + 180)


def test_recovered_sensor_is_believed_again() -> None:
    reports = run(160, fault=lambda time: 3.0 if 20.0 < time < 40.0 else 0.0)
    assert reports[70].verdict is Verdict.ERROR
    assert reports[-1].verdict is Verdict.OK


def test_camera_that_jumps_while_the_sensor_does_not_is_in_doubt_first() -> None:
    # As where a near surface fills the view: the sensor's own depths show no jump.
    def found(of_camera: float, of_sensor: float) -> list[float]:
        monitor = DepthMonitor(CONFIG)
        random, evidence = np.random.default_rng(0), []
        for index in range(80):
            time = index + 1.0
            off = 2.0 * (60.0 < time <= 62.0)
            depth, noise = 6.0 - 2.0 * math.cos(0.02 * time), 0.05 * random.standard_normal(2)
            monitor.add_sensor(sample(time, depth + of_sensor * off + noise[0], 0.05), time)
            monitor.add_estimate(
                sample(time, depth - of_camera * off + noise[1]), Status.OK, time)
            evidence.append(monitor.report(time).evidence)
        return evidence

    camera, sensor = max(found(1.0, 0.0)), max(found(0.0, 1.0))
    assert camera < 0.02 * sensor


def test_sensor_far_beyond_a_wide_gate_is_an_error_from_the_start() -> None:
    assert run(10, fault=lambda time: 60.0)[-1].verdict is Verdict.ERROR


def test_wrong_sensor_of_a_camera_that_knows_its_constant_is_an_error() -> None:
    # Within what the camera's constant may be it cannot be told from that.
    assert first(run(20, constant=0.2, fault=lambda time: 2.0), Verdict.ERROR) < 16
    assert first(run(20, constant=2.5, fault=lambda time: 2.0), Verdict.ERROR) == 20


def test_false_alarms_are_as_rare_as_they_are_said_to_be() -> None:
    # In the model's own world, with limits so low that alarms come.
    hours, alarms = 0.02, 0
    config = replace(CONFIG, error_interval=hours, warn_interval=hours)
    random, monitor = np.random.default_rng(3), DepthMonitor(config)
    frames, stddev, precision = 1_500, CONFIG.model_stddev, 0.1
    sizes = np.array((CAMERA.fast * precision, CAMERA.slow * stddev))
    wander = sizes * random.standard_normal(2)
    for index in range(frames):
        time = index / RATE
        # Frames are taken every second: noise of those between is as they say.
        if index % 2 == 0:
            kept = np.exp(-1.0 / np.array((CAMERA.fast_time, CAMERA.slow_time)))
            wander = kept * wander + np.sqrt(1.0 - kept**2) * sizes * random.standard_normal(2)
            begun = random.random() < 1.0 - math.exp(-CAMERA.bursts)
            wander[0] += CAMERA.burst * stddev * random.standard_normal() * begun
            alone = CAMERA.outlier * stddev * random.standard_normal()
            off = alone * (random.random() < CAMERA.outliers)
        monitor.add_sensor(sample(time, 5.0, 0.0), time)
        monitor.add_estimate(sample(time, 5.0 + float(wander.sum()) + off), Status.OK, time)
        if monitor.report(time).verdict is Verdict.ERROR:
            alarms += 1
            monitor.reset()
    assert alarms <= frames / RATE / 3600.0 / hours


def test_first_difference_proves_nothing_where_the_constant_is_unknown() -> None:
    report = run(1)[-1]
    assert (report.verdict, report.inconclusive) == (Verdict.NOT_ASSESSABLE, 1)
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


def test_values_with_a_repeated_or_older_stamp_are_counted_and_not_used() -> None:
    monitor = DepthMonitor(CONFIG)
    for seconds in (1.0, 1.5, 1.5, 1.2, 2.0):
        monitor.add_sensor(sample(seconds, 4.0), seconds)
    assert monitor.report(2.0).repeated == 2
    (comparison,) = monitor.add_estimate(sample(1.75, 4.0), Status.OK, 2.0)
    assert comparison.sensor.depth == 4.0


def test_estimate_waits_for_the_sensor() -> None:
    monitor = DepthMonitor(CONFIG)
    monitor.add_sensor(sample(1.0, 4.0), 1.0)
    assert monitor.add_estimate(sample(1.25, 5.0), Status.OK, 1.3) == []
    (comparison,) = monitor.add_sensor(sample(1.5, 6.0), 1.5)
    assert comparison.sensor.depth == pytest.approx(5.0)
    assert comparison.innovation == pytest.approx(0.0)
    # Of sensor and estimate, and more of the model.
    assert comparison.variance > 0.01 + 0.01 + CONFIG.model_stddev**2


def test_learned_bias_is_taken_off_and_reported_with_its_uncertainty() -> None:
    monitor = DepthMonitor(CONFIG)
    for index in range(40):
        monitor.add_sensor(sample(index, 7.0), index)
        monitor.add_estimate(DepthSample.estimated(index * SECOND, 5.0, 2.5, 0.1), Status.OK, index)
    report = monitor.report(39)
    assert report.bias == pytest.approx(2.0, abs=0.05)
    assert 0.0 < report.bias_stddev < 0.2
    assert f"after a learned bias of {report.bias:+.2f} ± " in report.reason


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
