# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reasons are logged at once, then rarely, and never grow without bound; counts slide."""

from __future__ import annotations

from uw_visibility.errors import LONGEST_MESSAGE
from uw_visibility.ros.monitor import FURTHER, MAX_LINES, MAX_REASONS, ReasonLog, RecentCounts


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


def test_many_different_reasons_fill_neither_memory_nor_log() -> None:
    lines: list[str] = []
    log = ReasonLog(lines.append, clock=lambda: 0.0)
    for number in range(10 * MAX_REASONS):
        log.add(f"{number} bytes")
    assert len(log.counts) == MAX_REASONS
    assert len(lines) == MAX_LINES
    assert log.total == 10 * MAX_REASONS


def test_latest_and_most_frequent_reasons_are_shown_and_all_are_counted() -> None:
    log = ReasonLog(lambda line: None)
    for number in range(30):
        for _ in range(2 if number == 7 else 1):
            log.add(str(number))
    assert log.problems(3) == {
        f"problem: {reason}": count for reason, count in {
            "27": 1, "28": 1, "29": 1, "7": 2, "0": 1, "1": 1, FURTHER: 24}.items()}
    for number in range(MAX_REASONS):
        log.add(f"new {number}")
    assert sum(log.problems(3).values()) == log.total == 31 + MAX_REASONS


def test_texts_from_outside_cannot_forge_lines_of_the_log() -> None:
    lines: list[str] = []
    ReasonLog(lines.append).add("odd encoding 'a\n[INFO] all is well\x1b[2J'" + 5000 * "x")
    assert len(lines[0]) <= LONGEST_MESSAGE
    assert lines[0].isprintable()


def test_growth_within_the_window() -> None:
    recent = RecentCounts(5.0)
    assert recent.update(0.0, {"left": 7}) == {}
    growths = [recent.update(t, {"left": 7 + 2 * t, "right": 3}) for t in range(1, 20)]
    assert growths[2] == {"left": 6, "right": 3}
    assert growths[-1] == {"left": 10}
    assert recent.duration == 5.0


def test_window_without_updates_reaches_back_to_the_last_one() -> None:
    recent = RecentCounts(5.0)
    recent.update(0.0, {"left": 0})
    recent.update(1.0, {"left": 1})
    assert recent.update(60.0, {"left": 1}) == {}
    assert recent.duration == 59.0
