# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frame-by-frame writer of a replay: table, messages, timings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uw_visibility.messages.estimates import (
    ESTIMATES,
    NIS_TOPICS,
    Estimate,
    ImageHeader,
    nis_messages,
)
from uw_visibility.messages.images import MessageFactory
from uw_visibility.messages.outputs import FILTERED, all_topics
from uw_visibility.replay.bags.decoder import jazzy_types
from uw_visibility.replay.bags.storage import Channel, Recorded
from uw_visibility.replay.bags.writer import BagWriter
from uw_visibility.replay.columns import COLUMNS, FAILED, TURBIDITY, Column, joined_column
from uw_visibility.replay.frame_log import NAME as LOG
from uw_visibility.replay.frame_log import line_of
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.topics import COMPRESSED, Selection
from uw_visibility.replay.records import FrameEstimate, JoinedFrame
from uw_visibility.replay.results.folder import MESSAGES, TABLE
from uw_visibility.replay.results.provenance import texts_of
from uw_visibility.replay.table import TableWriter, write_dictionary
from uw_visibility.replay.work import FrameAnswer
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.meaning.derived import DerivedModel
from uw_visibility.water.series.filter import FilteredWater, WaterFilter

DIAGNOSTICS = "/diagnostics"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"


def columns_of(options: ReplayOptions) -> dict[str, Column]:
    """Return the columns of the table that a replay writes."""
    return {
        **COLUMNS, **(TURBIDITY if options.turbidity else {}),
        **{join.column: joined_column(str(join), k, join.unit)
           for k, join in enumerate(options.joins)},
    }


def frame_topics(options: ReplayOptions) -> list[str]:
    """Return the topics that depend on a single frame: all except those filtered over frames."""
    filtered = ESTIMATES if options.pipeline.tracking.enabled else ()
    return [t for t in all_topics(options.node) if t not in {f"{FILTERED}/{n}" for n in filtered}]


def copied_topics(
    selection: Selection, channels: Mapping[str, Channel]
) -> dict[str, tuple[str, str]]:
    """Return name and type in the results of each input topic that is copied."""
    names = {selection.left: "/left/image_rect", selection.left_info: "/left/camera_info"}
    if channels[selection.left].type == COMPRESSED:
        names[selection.left] += "/compressed"
    if selection.rectify:
        names = {topic: topic for topic in names if topic is not None}
    names[selection.depth] = "/depth_sensor"
    return {
        topic: (name, channels[topic].type) for topic, name in names.items() if topic is not None}


def diagnostics(make: MessageFactory, joined: JoinedFrame) -> Any:
    """Make a DiagnosticArray of a frame: statuses of its quantities."""
    estimate, reason = joined.record.estimate, joined.record.reason
    states = {"pipeline": reason or "ok"}
    if estimate is not None:
        states |= {
            "water": str(estimate.water.status), "visibility": str(estimate.visibility.status),
            "depth": str(estimate.visibility.depth_status),
        }
    if joined.verdict is not None:
        states["depth plausibility"] = joined.verdict_reason or "ok"
    status = [
        make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=0 if message == str(Status.OK) else 1, name=f"uw_visibility: {name}",
            message=message, hardware_id="", values=[],
        )
        for name, message in states.items()
    ]
    header = ImageHeader.at(joined.record.stamp)
    return make(DIAGNOSTICS_TYPE, header=header.message(make), status=status)


class FrameRecorder:
    """Writer of rows and messages of frames, with the filter over frames.

    copied: name and type of the copy in results.mcap, by recorded topic.
    filter: filter over the frames in their order, independent of processes.
    baselines: baselines of the rigs of frames, m.
    recalibrated: frames whose calibration is not that of the frame before.
    """

    def __init__(
        self,
        folder: Path,
        options: ReplayOptions,
        copied: Mapping[str, tuple[str, str]],
    ) -> None:
        self.resumed = 0
        self.baselines: set[float] = set()
        self.recalibrated: list[int] = []
        self._rig: StereoRig | None = None
        self._folder, self._options = folder, options
        self._copied = copied
        self.columns = columns_of(options)
        self._model = DerivedModel(options.pipeline)
        self._table = TableWriter(folder / TABLE, tuple(self.columns))
        write_dictionary(folder / TABLE, self.columns)
        self._timings: TableWriter | None = None
        topics = {**all_topics(options.node), **NIS_TOPICS}
        absolute = {f"/{topic}": name for topic, name in topics.items()} | dict(copied.values())
        if options.all_topics:
            absolute[DIAGNOSTICS] = DIAGNOSTICS_TYPE
        self._bag = BagWriter(folder / "results", absolute, compress=True)
        self.filter = WaterFilter(options.pipeline)
        # Only for a resumed replay; each line is written at once.
        self._log = (folder / LOG).open("w", encoding="ascii", buffering=1)

    def write_frame(self, answer: FrameAnswer) -> FilteredWater | None:
        """Write the messages of a frame, also filtered ones; returns the filtered estimate."""
        record, filtered = answer.record, None
        for topic, data in answer.messages:
            self._bag.write_serialised(f"/{topic}", data, record.time)
        if record.estimate is not None:
            self.resumed += answer.resumed
            self.baselines.add(record.estimate.rig.baseline)
            if self._rig not in (None, record.estimate.rig):
                self.recalibrated.append(record.frame)
            self._rig = record.estimate.rig
            timing = record.estimate.timing_ms
            if self._timings is None:
                self._timings = TableWriter(self._folder / "timings.csv", ["frame", *timing])
            self._timings.write(
                {"frame": str(record.frame), **{k: f"{v:.3f}" for k, v in timing.items()}})
            filtered = self.filter.update(
                record.estimate.water, record.estimate.header.seconds, record.estimate.rig)
            if filtered is not None:
                self._write_filtered(record.estimate, filtered, record.time)
        self._log.write(line_of(record))
        return filtered

    def write_row(self, joined: JoinedFrame) -> None:
        """Write a completed row, and messages of its comparison with the sensor."""
        self._table.write(self._row(joined))
        make, time = self._bag.make, joined.record.time
        if joined.comparison is not None:
            frame = self._options.node.depth_frame
            for topic, message in nis_messages(make, joined.comparison, frame):
                self._bag.write(f"/{topic}", message, time)
        if self._options.all_topics:
            self._bag.write(DIAGNOSTICS, diagnostics(make, joined), time)

    def copy(self, message: Recorded, *, ros1: bool) -> None:
        """Copy a recorded message, under its name in results.mcap."""
        name, kind = self._copied[message.topic]
        data = jazzy_types()[0].ros1_to_cdr(message.data, kind) if ros1 else message.data
        self._bag.write_serialised(name, bytes(data), message.time)

    def close(self, provenance: Mapping[str, Any]) -> None:
        self._table.close()
        self._log.close()
        if self._timings is not None:
            self._timings.close()
        for key, text in texts_of(provenance).items():
            self._bag.annotate(f"uw_visibility.{key}", text)
        self._bag.close()
        made = self._folder / "results"
        (made / MESSAGES).rename(self._folder / MESSAGES)
        (made / "metadata.yaml").unlink()
        made.rmdir()

    def _row(self, joined: JoinedFrame) -> dict[str, str]:
        """Derive a frame's quantities, and return its row of the table; unknown cells are empty."""
        estimate, turbidity = joined.record.estimate, self._options.turbidity
        joined.derived = None if estimate is None else self._model.derive(estimate.water)
        if joined.filtered is not None:
            joined.filtered_derived = self._model.derive(joined.filtered.water)
        sources = {**vars(joined), "estimate": estimate}
        for prefix in ("", "filtered_"):
            derived = sources[f"{prefix}derived"]
            if turbidity is not None:
                sources[f"{prefix}turbidity"], sources[f"{prefix}turbidity_stddev"] = (
                    (math.nan, math.nan) if derived is None else turbidity.predict(
                        derived.beam_attenuation, derived.beam_attenuation_stddev))
        row = {name: column.text(sources) for name, column in self.columns.items()}
        return row if estimate is not None else {**row, "status": FAILED}

    def _write_filtered(self, estimate: FrameEstimate, filtered: FilteredWater, time: int) -> None:
        source = Estimate(
            self._bag.make, estimate.header, filtered.water, filtered.visibility,
            estimate.field_of_view, self._options.node,
        )
        for name in ESTIMATES:
            message = source.message(name)
            if message is not None:
                self._bag.write(f"/{FILTERED}/{name}", message, time)
