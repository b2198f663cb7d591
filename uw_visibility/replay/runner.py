# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The replay of one recording: from its messages to a folder of results."""

from __future__ import annotations

import os
import sys
import time
import uuid
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self, TypeVar

from uw_visibility.errors import InputError
from uw_visibility.outputs import all_topics
from uw_visibility.plausibility import Report
from uw_visibility.replay.filtering import EstimateLog, FilterStage, split_topics
from uw_visibility.replay.folder import ResultFolder
from uw_visibility.replay.joining import Joiner
from uw_visibility.replay.options import ReplayOptions
from uw_visibility.replay.pool import FramePool
from uw_visibility.replay.positions import Position, write_geojson
from uw_visibility.replay.progress import Progress
from uw_visibility.replay.provenance import FileHash, fingerprint, version
from uw_visibility.replay.reader import BagReader
from uw_visibility.replay.results import EarlierPart, ResultWriter
from uw_visibility.replay.stream import Event, InputStream, RecordedFrame, Restart, SensorValue
from uw_visibility.replay.table import COLUMNS, FAILED, JOINED, TableWriter, read_rows
from uw_visibility.replay.work import FrameAnswer, FrameTask, Recording

Other = TypeVar("Other")


@dataclass
class Summary:
    """What a replay did.

    Attributes
    ----------
    bag, output : str
        Recording and folder of the result.
    complete : bool
        Whether the recording was replayed to its end.
    frames, resumed : int
        Rows of the table, and those of an earlier part among them.
    status, depth_status, reasons : Counter of str
        Frames by status, by that of the depth, and those without result by reason.
    dropped : Counter of str
        Images that became part of no frame, by reason.
    damage : list of str
        What could not be read.
    notes : list of str
        Choices made for the user.
    topics : dict of str to str
        Topics used, by purpose.
    seconds : float
        Duration of the replay.
    provenance : dict
        Version, parameters and hash of the input.
    plausibility : Report or None
        Of the depth sensor.
    """

    bag: str
    output: str
    complete: bool = False
    frames: int = 0
    resumed: int = 0
    status: Counter[str] = field(default_factory=Counter)
    depth_status: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    damage: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    topics: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    provenance: dict[str, Any] = field(default_factory=dict)
    plausibility: Report | None = None
    verdicts: Counter[str] = field(default_factory=Counter)

    @property
    def assessed(self) -> int:
        """Frames whose water was assessed."""
        return self.status["ok"]

    @property
    def failed(self) -> int:
        """Frames without a result."""
        return self.status[FAILED]

    def count(self, row: dict[str, str]) -> None:
        """Count a frame."""
        self.frames += 1
        self.status[row["status"]] += 1
        if row["status"] == FAILED:
            self.reasons[row["reason"]] += 1
        else:
            self.depth_status[row["depth_status"]] += 1


def replay_bag(
    bag: Path,
    target: Path,
    options: ReplayOptions,
    pool: FramePool,
    *,
    force: bool = False,
    resume: bool = False,
) -> Summary:
    """Replay a recording into a folder.

    Parameters
    ----------
    bag : Path
        The recording.
    target : Path
        Folder to make.
    options : ReplayOptions
        What is wanted.
    pool : FramePool
        Where frames are worked on.
    force, resume : bool
        Whether an existing result is replaced, or a partial one gone on from.

    Returns
    -------
    Summary

    Raises
    ------
    InputError
        If the recording or the folder cannot be used.
    KeyboardInterrupt
        After an interruption; what there is by then is a readable partial result.
    """
    with BagReader(bag) as reader:
        stream = InputStream(reader, options)
        folder = ResultFolder(target, force=force, resume=resume)
        replay = _Replay(reader, stream, options, folder)
        with replay:
            replay.run(pool)
        return replay.summary


class _Replay:
    """A replay under way: everything that is open while it runs."""

    def __init__(
        self,
        reader: BagReader,
        stream: InputStream,
        options: ReplayOptions,
        folder: ResultFolder,
    ) -> None:
        self._reader, self._stream = reader, stream
        self._options, self._folder = options, folder
        self._begin = time.monotonic()
        selection = stream.selection
        self.summary = Summary(str(reader.path), str(folder.target), notes=list(selection.notes))
        self.summary.topics = {
            name: topic for name in (
                "left", "right", "left_info", "right_info", "depth", "position"
            ) if (topic := getattr(selection, name)) is not None
        }
        self._fingerprint = fingerprint(reader.files)
        self._parameters = options.parameters()
        self._check_earlier()
        self._hash = FileHash(reader.files)
        self._earlier: EarlierPart | None = None
        if folder.earlier is not None:
            alone, _ = split_topics(options.pipeline, options.node)
            self._earlier = EarlierPart(folder.earlier, alone)
        self._table = TableWriter(folder.work / "frames.csv", COLUMNS)
        self._timings: TableWriter | None = None
        self._results = ResultWriter(folder.work, all_topics(options.node))
        self._joiner = Joiner(
            stream.plausibility, selection.position is not None, options.origin
        )
        self._filter = FilterStage(options.pipeline, options.node)
        self._estimates = EstimateLog(folder.work)
        self._write_state(complete=False)

    def run(self, pool: FramePool) -> None:
        """Replay the recording to its end."""
        progress = Progress(self._reader.path.name, self._stream.expected_frames)
        try:
            for item in pool.answers(self._tasks(self._stream.events())):
                for row in self._take(item):
                    self._write_row(row)
                if isinstance(item, FrameAnswer):
                    progress.add()
        finally:
            progress.close()
        self.summary.complete = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *details: object) -> None:
        if kind is not None and issubclass(kind, InputError) and self.summary.frames == 0:
            # Refused before the first frame: nothing is worth keeping.
            self._hash.stop()
            self._close_files()
            self._folder.refuse_earlier()
            return
        self._finish(hashed=kind is None)
        if kind is None:
            self._estimates.remove()
            self._folder.forget_earlier()
            self._folder.complete()
        elif self._earlier is not None and self.summary.frames < len(self._earlier.timings):
            # Less than there was: the earlier part stays the one to go on from.
            self._folder.refuse_earlier()
        else:
            self._folder.forget_earlier()

    def _tasks(self, events: Iterable[Event]) -> Iterator[Any]:
        """Yield tasks for frames, what an earlier part has of them, and sensor values."""
        recording = Recording(
            uuid.uuid4().hex, {c.type: c for c in self._used_channels()}, self._reader.ros1,
            self._options.pipeline, self._options.node,
        )
        known = self._earlier.answers() if self._earlier is not None else iter(())
        for event in events:
            if not isinstance(event, RecordedFrame):
                yield event
                continue
            earlier = next(known, None)
            if earlier is not None and earlier.row["frame"] != str(event.number):
                raise InputError(
                    f"{self._folder.earlier} is not of these frames: --force begins anew"
                )
            yield FrameTask(recording, event) if earlier is None else earlier

    def _used_channels(self) -> Iterator[Any]:
        selection = self._stream.selection
        for topic in (*selection.images(), *selection.infos()):
            yield self._reader.channels[topic]

    def _take(
        self, item: FrameAnswer | SensorValue | Position | Restart
    ) -> Iterator[dict[str, str]]:
        """Hand an item to the joiner; yields rows that are complete."""
        if isinstance(item, SensorValue):
            yield from self._joiner.add_sensor(item)
        elif isinstance(item, Position):
            yield from self._joiner.add_position(item)
        elif isinstance(item, Restart):
            self._joiner.restart()
        else:
            yield from self._joiner.add_frame(self._filter_frame(item))

    def _filter_frame(self, answer: FrameAnswer) -> dict[str, str]:
        """Write the messages of a frame, filtered ones too; returns its row."""
        self._results.write_messages(answer.messages, answer.time)
        self._write_timing(answer)
        # Rows of an earlier part are joined anew, so that the test's memory is right.
        row = {k: v for k, v in answer.row.items() if k not in JOINED}
        if answer.estimate is not None:
            messages, columns = self._filter.add(answer.estimate)
            self._results.write_messages(messages, answer.time)
            self._estimates.write(row["frame"], answer.estimate)
            row |= columns
        return row

    def _write_row(self, row: dict[str, str]) -> None:
        self._table.write(row)
        self._results.write_nis(row)
        self.summary.count(row)

    def _write_timing(self, answer: FrameAnswer) -> None:
        number = answer.row["frame"]
        row = {"frame": number, **{k: f"{v:.3f}" for k, v in answer.timing_ms.items()}}
        if not answer.timing_ms and self._earlier is not None:
            row = self._earlier.timings.get(number, row)
            self.summary.resumed += number in self._earlier.timings
        if len(row) == 1:
            return
        if self._timings is None:
            self._timings = TableWriter(self._folder.work / "timings.csv", list(row))
        self._timings.write({k: v for k, v in row.items() if k in self._timings.columns})

    def _finish(self, hashed: bool) -> None:
        """Close everything, whole or partial, and write what is made of it."""
        if not hashed:
            self._hash.stop()
        if self.summary.complete:
            for row in self._joiner.finish():
                self._write_row(row)
        self._collect()
        summary = self.summary
        summary.provenance = {
            "version": version(), "bag": self._reader.path.name, "input_sha256":
            self._hash.result(), "complete": summary.complete, "parameters": self._parameters,
            "threads": self._options.pipeline.threads or os.cpu_count() or 1,
        }
        self._close_files()
        self._write_state(complete=summary.complete)
        self._write_extras()

    def _collect(self) -> None:
        stream, summary = self._stream, self.summary
        summary.plausibility = self._joiner.report()
        summary.verdicts = self._joiner.verdicts
        summary.dropped = stream.synchronizer.dropped
        summary.damage = list(dict.fromkeys(self._reader.damage))
        if summary.complete:
            summary.damage += stream.missing()
        summary.damage += [f"{reason} ({count})" for reason, count in stream.problems.items()]
        restarts = stream.synchronizer.restarts
        if restarts:
            summary.damage.append(f"stamps of the images jumped back {restarts} times")
        summary.seconds = time.monotonic() - self._begin

    def _close_files(self) -> None:
        self._table.close()
        self._estimates.close()
        if self._timings is not None:
            self._timings.close()
        self._results.close(self.summary.provenance)

    def _write_extras(self) -> None:
        from uw_visibility.replay.gallery import write_pictures
        from uw_visibility.replay.report import write_report

        work = self._folder.work
        if self._options.geo:
            write_geojson(work / "frames.geojson", read_rows(work / "frames.csv"))
        if self.summary.complete:
            write_pictures(work, self._reader, self._stream.selection, self._options)
        write_report(work, self._reader, self._stream.selection, self.summary)

    def _check_earlier(self) -> None:
        """Refuse to go on with another input or other parameters.

        Raises
        ------
        InputError
            Saying what differs.
        """
        if self._folder.earlier is None:
            return
        try:
            state = self._folder.state()
            if state.get("fingerprint") != self._fingerprint:
                raise InputError(f"the partial result is not of {self._reader.path}: use --force")
            if state.get("version") != version():
                raise InputError("the partial result is of another version: use --force")
            before = state.get("parameters", {})
            now = self._parameters
            changed = sorted(k for k in {*before, *now} if before.get(k) != now.get(k))
            if changed:
                raise InputError(
                    f"the partial result was made with another {', '.join(changed)}: use --force"
                )
        except InputError:
            self._folder.refuse_earlier()
            raise

    def _write_state(self, complete: bool) -> None:
        summary = self.summary
        self._folder.write_state({
            "complete": complete, "version": version(), "bag": self._reader.path.name,
            "input_sha256": summary.provenance.get("input_sha256"),
            "fingerprint": self._fingerprint, "topics": summary.topics,
            "frames": summary.frames, "status": dict(summary.status),
            "depth_status": dict(summary.depth_status), "unusable": dict(summary.reasons),
            "dropped": dict(summary.dropped), "damage": summary.damage,
            "plausibility": dict(summary.verdicts), "seconds": round(summary.seconds, 3),
            "python": sys.version.split()[0], "parameters": self._parameters,
        })
