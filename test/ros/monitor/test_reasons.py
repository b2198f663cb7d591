# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reasons are logged at once, then rarely, and never grow without bound."""

from __future__ import annotations

from uw_visibility.ros.monitor.reasons import MAX_REASONS, ReasonLog


def test_reason_is_logged_at_once_and_then_with_its_count() -> None:
    lines: list[str] = []
    now = [0.0]
    log = ReasonLog(lines.append, period=5.0, clock=lambda: now[0])
    for _ in range(3):
        log.add("too dark", "\ndetails")
    log.add("other")
    now[0] = 5.0
    log.add("too dark", "\ndetails")
    assert lines == ["too dark\ndetails", "other", "too dark (4 times so far)"]
    assert (log.total, log.counts) == (5, {"too dark": 4, "other": 1})


def test_many_different_reasons_do_not_fill_the_memory() -> None:
    lines: list[str] = []
    log = ReasonLog(lines.append, clock=lambda: 0.0)
    for number in range(10 * MAX_REASONS):
        log.add(f"{number} bytes")
    assert len(log.counts) == MAX_REASONS + 1
    assert len(lines) == MAX_REASONS + 1
    assert log.total == 10 * MAX_REASONS
