# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The table of the check: shares, alarms, jumps and drifts of series that are known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from uw_visibility.plausibility.model import Camera
from uw_visibility_lab.evaluation.plausibility.judge import HEAD, JUMPS, judge, table
from uw_visibility_lab.evaluation.plausibility.series import Series

CALM = Camera(
    constant=1.0, slope=0.1, fast=0.8, fast_time=2.0, slow=0.01, slow_time=60.0,
    bursts=0.01, burst=2.0, outliers=0.02, outlier=2.0, spread=1.5)


def test_right_sensor_passes_and_wrong_ones_are_found(draw: Callable[..., Series]) -> None:
    judged = judge(draw(CALM, 4, 120), CALM)
    assert 0.0 < judged.beyond < 0.1
    assert (judged.warned, judged.accused) == (0, 0)
    assert all(0.0 < time < 10.0 for size in JUMPS for time in judged.jumps[size])
    assert all(0.0 < way < 1.5 for ways in judged.drifts.values() for way in ways)
    assert judged.absurd < 10


def test_camera_that_jumps_accuses_a_right_sensor(draw: Callable[..., Series]) -> None:
    series = [
        replace(seen, depth=seen.depth + 5.0 * (seen.time > 60.0)) for seen in draw(CALM, 4, 120)]
    assert judge(series, CALM).accused > 10


def test_what_is_never_found_is_a_dash_in_the_table(draw: Callable[..., Series]) -> None:
    judged = judge(draw(CALM, 4, 30), CALM)
    assert math.isinf(max(judged.jumps[3.0]))
    lines = table("judged", {"calm": judged}).splitlines()
    assert len(lines) == 2 and "..–" in lines[1]
    assert all(name in lines[0] for name in HEAD)
