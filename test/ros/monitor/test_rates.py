# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What was counted lately, over a window that slides."""

from __future__ import annotations

from uw_visibility.ros.monitor.rates import RecentCounts


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
