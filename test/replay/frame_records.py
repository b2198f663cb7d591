# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Records of frames, as the stages of a replay hand them on."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.messages.estimates import ImageHeader
from uw_visibility.replay.columns import COLUMNS, FAILED
from uw_visibility.replay.records import FrameEstimate, FrameRecord, JoinedFrame
from uw_visibility.replay.table import TableWriter
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility


def frame_estimate(water_status: Status = Status.OK, /, **visibility: Any) -> FrameEstimate:
    """Make a frame's estimate; what of its visibility is not given is not known."""
    water = WaterEstimate(
        water_status, np.array([0.4, 0.2, math.nan]), np.array([0.1, 1 / 3, math.nan]),
        np.eye(6), 7, 30, (water_status, water_status, Status.TOO_DARK),
    )
    given = {"status": Status.OK, "depth_status": Status.OK} | visibility
    return FrameEstimate(
        water, Visibility(**given), StereoRig(400.0, 0.12, (19.5, 1.5)), 0.1 + 0.2,
        ImageHeader(7, 250, "left_camera"), 90, 0.5, 0.7, 0.0,
    )


def frame_record(time: float = 0.0, frame: int = 0, **changes: Any) -> FrameRecord:
    """Make the record of a frame at a time, s."""
    stamp = round(time * 1e9)
    return FrameRecord(frame, stamp, stamp, stamp, **changes)


def write_table(folder: Path, frames: Iterable[JoinedFrame]) -> Path:
    """Write frames as a replay does; what is derived from their water is as it is given."""
    table = folder / "frames.csv"
    writer = TableWriter(table, tuple(COLUMNS))
    for frame in frames:
        estimate = frame.record.estimate
        row = {name: column.text({**vars(frame), "estimate": estimate})
               for name, column in COLUMNS.items()}
        writer.write(row if estimate is not None else {**row, "status": FAILED})
    writer.close()
    return table
