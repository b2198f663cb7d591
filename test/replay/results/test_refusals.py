# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What was not assessable is told by quantity, with the frames and the reason."""

from __future__ import annotations

import math
import tempfile
from dataclasses import astuple
from pathlib import Path
from typing import Any

from frame_records import frame_estimate, frame_record, write_table

from uw_visibility.plausibility.comparison import Verdict
from uw_visibility.replay.columns import COLUMNS
from uw_visibility.replay.records import MOST_REASONS, JoinedFrame
from uw_visibility.replay.results.summary import MOST_RUNS, refusals
from uw_visibility.replay.table import read_table
from uw_visibility.status import Status

OK, DARK = Status.OK, Status.TOO_DARK


def frame(
    number: int, water: Status = OK, visibility: Status = OK, depth: Status = OK,
    distance: float = math.nan, verdict: Verdict | None = None, why: str = "",
) -> JoinedFrame:
    estimate = frame_estimate(water, status=visibility, depth_status=depth, distance=distance)
    record = frame_record(frame=number, estimate=estimate)
    return JoinedFrame(record, verdict=verdict, verdict_reason=why)


def failed(number: int, reason: str) -> JoinedFrame:
    return JoinedFrame(
        frame_record(frame=number, reason=reason), verdict=Verdict.NOT_ASSESSABLE,
        verdict_reason="the frame has no result",
    )


def told(*frames: JoinedFrame) -> list[tuple[str, str, int, str]]:
    with tempfile.TemporaryDirectory() as folder:
        return [
            astuple(each)
            for each in refusals(read_table(write_table(Path(folder), frames), COLUMNS))]


def test_each_quantity_has_its_frames_and_reasons() -> None:
    narrow: Any = {"visibility": Status.RANGE_SPREAD_TOO_SMALL}
    assert told(frame(0), frame(1, **narrow), frame(2, **narrow), frame(3), frame(4, **narrow),
                frame(5, depth=Status.AMBIENT_LIGHT_UNBOUNDED)) == [
        ("visibility distance", "range spread too small", 3, "1-2, 4"),
        ("depth by colour", "ambient light unbounded", 1, "5"),
    ]
    # Neighbours are those that were replayed.
    assert told(frame(0, **narrow), frame(10, **narrow))[0][3] == "0-10"
    assert told(frame(0)) == []


def test_quantities_that_fail_together_are_one_line() -> None:
    dark = (DARK, DARK, DARK)
    assert told(frame(0, *dark), frame(1, *dark)) == [
        ("water, visibility distance, depth by colour", "too dark", 2, "0-1")]
    # The distance of the channels that were seen is in the table nevertheless.
    (line, *rest) = told(frame(0, *dark, distance=7.5))
    assert line[0] == "water, visibility distance of all channels, depth by colour"
    assert rest == []
    # The same number of frames is not the same frames.
    assert len(told(frame(0, DARK), frame(1, depth=DARK))) == 2


def test_a_frame_without_result_lacks_nothing_else() -> None:
    assert told(failed(0, "left image is empty")) == [
        ("the whole frame", "left image is empty", 1, "0")]


def test_a_sensor_that_was_not_judged_is_told_with_the_range_of_its_numbers() -> None:
    frames = [
        frame(k, verdict=Verdict.STALE, why=f"no depth_sensor for {9 + k}.5 s") for k in range(3)]
    frames += [frame(3, verdict=Verdict.WARN, why="sensor +2 m from the estimate")]
    assert told(*frames) == [
        ("plausibility of the depth sensor", "no depth_sensor for 9.5 to 11.5 s", 3, "0-2")]
    assert told(*frames[1:2])[0][1] == "no depth_sensor for 10.5 s"


def test_a_long_recording_is_told_briefly() -> None:
    every_other = [frame(k, depth=OK if k % 2 else Status.SATURATED) for k in range(100)]
    ((*_, count, frames),) = told(*every_other)
    assert count == 50
    assert frames == "0, 2, 4, 6, 8, 10, 12, 14 and 42 more"
    assert MOST_RUNS == 8
    lines = told(*(failed(k, f"size {k}") for k in range(MOST_REASONS + 9)))
    assert len(lines) == MOST_REASONS + 1
    assert lines[-1][1:3] == ("further reasons", 9)
