# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What was not assessable is told by quantity, with the frames and the reason."""

from __future__ import annotations

import json
from typing import Any

from uw_visibility.replay.results.refusals import MOST_REASONS, MOST_RUNS, Refusals


def row(frame: int, **columns: str) -> dict[str, str]:
    good = {"frame": str(frame), "status": "ok", "visibility_status": "ok", "depth_status": "ok",
            "visibility_distance": "", "plausibility": "", "plausibility_reason": "",
            "reason": ""}
    return good | columns


def told(*rows: dict[str, str]) -> list[tuple[str, str, int, str]]:
    refusals = Refusals()
    for each in rows:
        refusals.count(each)
    again = Refusals.of_state(json.loads(json.dumps(refusals.state())))
    assert again.together() == refusals.together()
    return [(r.what, r.why, r.count, r.frames) for r in refusals.together()]


def test_each_quantity_has_its_frames_and_reasons() -> None:
    narrow: Any = {"visibility_status": "range spread too small"}
    assert told(row(0), row(1, **narrow), row(2, **narrow), row(3), row(4, **narrow),
                row(5, depth_status="ambient light unbounded")) == [
        ("visibility distance", "range spread too small", 3, "1-2, 4"),
        ("depth by colour", "ambient light unbounded", 1, "5"),
    ]
    # Neighbours are those that were replayed.
    assert told(row(0, **narrow), row(10, **narrow))[0][3] == "0-10"
    assert told(row(0)) == []


def test_quantities_that_fail_together_are_one_line() -> None:
    dark = dict.fromkeys(("status", "visibility_status", "depth_status"), "too dark")
    assert told(row(0, **dark), row(1, **dark)) == [
        ("water, visibility distance, depth by colour", "too dark", 2, "0-1")]
    # The distance of the channels that were seen is in the table nevertheless.
    (line, *rest) = told(row(0, **dark, visibility_distance="7.5"))
    assert line[0] == "water, visibility distance of all channels, depth by colour"
    assert rest == []
    # The same number of frames is not the same frames.
    assert len(told(row(0, status="too dark"), row(1, depth_status="too dark"))) == 2


def test_a_frame_without_result_lacks_nothing_else() -> None:
    assert told(row(0, status="unusable", reason="left image is empty", visibility_status="",
                    depth_status="", plausibility="not assessable")) == [
        ("the whole frame", "left image is empty", 1, "0")]


def test_a_sensor_that_was_not_judged_is_told_without_the_numbers_that_differ() -> None:
    rows = [row(k, plausibility="stale", plausibility_reason=f"no depth_sensor for {k}.5 s")
            for k in range(3)]
    rows += [row(3, plausibility="warning", plausibility_reason="sensor +2 m from the estimate")]
    assert told(*rows) == [
        ("plausibility of the depth sensor", "no depth_sensor for … s", 3, "0-2")]


def test_a_long_recording_is_told_briefly() -> None:
    every_other = [row(k, **({} if k % 2 else {"depth_status": "saturated"})) for k in range(100)]
    ((*_, count, frames),) = told(*every_other)
    assert count == 50
    assert frames == "0, 2, 4, 6, 8, 10, 12, 14 and 42 more"
    assert MOST_RUNS == 8
    reasons = [row(k, status="unusable", reason=f"size {k}") for k in range(MOST_REASONS + 9)]
    lines = told(*reasons)
    assert len(lines) == MOST_REASONS + 1
    assert lines[-1][1:3] == ("further reasons", 9)
