# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Output bag of a replay, results.mcap: its contents, and frames of an interrupted replay."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from uw_visibility.messages.estimates import ImageHeader
from uw_visibility.messages.images import MessageFactory
from uw_visibility.replay.bags.reader import BagReader, UnreadableError
from uw_visibility.replay.bags.storage import Channel
from uw_visibility.replay.frame_log import read_records
from uw_visibility.replay.inputs.topics import COMPRESSED, Selection
from uw_visibility.replay.records import JoinedFrame
from uw_visibility.replay.table import read_rows
from uw_visibility.replay.work import FrameAnswer
from uw_visibility.status import Status

NAME = "results.mcap"
DIAGNOSTICS = "/diagnostics"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"


class EarlierPart:
    """Frames of an interrupted replay, to be reused.

    Only messages of topics that depend on a single frame are reused.
    """

    def __init__(self, folder: Path, topics: Collection[str]) -> None:
        self._folder = folder
        self._topics = {f"/{topic}" for topic in topics}
        self._table = folder / "frames.csv"

    def frames(self) -> int:
        """Return how many rows its table has."""
        return sum(1 for _ in read_rows(self._table)) if self._table.is_file() else 0

    def answers(self) -> Iterator[FrameAnswer]:
        """Yield the frames whose row and messages are all there, in order."""
        if not self._table.is_file():
            return
        groups, records = self._groups(), read_records(self._folder)
        for row, record in zip(read_rows(self._table), records, strict=False):
            if row.get("frame") != str(record.frame):
                return
            if record.estimate is None:
                yield FrameAnswer(record)
                continue
            group = next(groups, None)
            if group is None or group[0] != record.time:
                return
            yield FrameAnswer(record, group[1], resumed=True)

    def _groups(self) -> Iterator[tuple[int, list[tuple[str, bytes]]]]:
        """Yield time and messages of the frames with messages."""
        path = self._folder / NAME
        whole = path.is_file()
        if not whole:
            # After a crash the file is still in its first folder, without an end.
            path = self._folder / "results" / NAME
        try:
            reader = BagReader(path)
        except (UnreadableError, OSError):
            return
        with reader:
            time, group = 0, dict[str, bytes]()
            for message in reader.messages():
                if message.topic not in self._topics:
                    continue
                topic = message.topic.removeprefix("/")
                # A frame has at most one message per topic, at the time of the frame.
                if group and (message.time != time or topic in group):
                    yield time, list(group.items())
                    group = {}
                time = message.time
                group[topic] = message.data
            if group and whole:
                yield time, list(group.items())


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
