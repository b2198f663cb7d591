# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Replay of recordings, one after the other, into folders of results."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import Any, Self

from uw_visibility import __version__
from uw_visibility.compute.threads import number_of_threads
from uw_visibility.config.assumptions import ASK_TRANSFER
from uw_visibility.config.files import sole_writer
from uw_visibility.errors import InputError, printable
from uw_visibility.replay import stores
from uw_visibility.replay.bags.reader import BagReader, find_files
from uw_visibility.replay.frame_log import NAME as LOG
from uw_visibility.replay.frame_log import EarlierPart
from uw_visibility.replay.inputs.options import ReplayOptions, check_in_any, without_lacking
from uw_visibility.replay.inputs.sensors import LONGEST_GAP
from uw_visibility.replay.inputs.stream import Event, InputStream, RecordedFrame
from uw_visibility.replay.progress import Progress
from uw_visibility.replay.records import JoinedFrame
from uw_visibility.replay.report.sentences import verdict
from uw_visibility.replay.results.exports import check_exports, write_exports
from uw_visibility.replay.results.folder import MARK, RESULT, TABLE, ResultFolder, read_state
from uw_visibility.replay.results.joining import Joiner
from uw_visibility.replay.results.provenance import FileHash, Origin
from uw_visibility.replay.results.recorder import FrameRecorder, copied_topics, frame_topics
from uw_visibility.replay.results.summary import Summary
from uw_visibility.replay.stores import Place
from uw_visibility.replay.table import Columns, read_table
from uw_visibility.replay.work import (
    FrameAnswer,
    FramePool,
    FrameTask,
    LightHistory,
    Recording,
    frame_pool,
)


def replay_bags(
    targets: Mapping[Place, Place],
    options: ReplayOptions,
    *,
    jobs: int = 1,
    force: bool = False,
    resume: bool = False,
) -> list[Summary]:
    """Replay recordings into folders.

    targets: folder to make for each recording.
    jobs: number of processes. The results do not depend on it, except under lamps, see
        `LightHistory`.
    force, resume: whether existing results are replaced; whether partial results are continued, and
        complete ones kept.
    Raises `InputError` if a folder or every recording cannot be used, or no recording has a topic
    to join. Otherwise the summaries say which recordings are unusable, or lack a topic.
    """
    stores.check_urls([*targets, *targets.values()])
    options = replace(options, several=options.several or len(targets) > 1)
    finished = {
        bag: _finished(bag, target, options) if resume and not force else None
        for bag, target in targets.items()
    }
    # Finished results had the same topics, and the check may have to download recordings.
    if len(targets) > 1 and not any(finished.values()):
        check_in_any(targets, options)
    for bag, target in targets.items():
        # Checked before hours of work.
        if finished[bag] is None:
            stores.check_place(target, force)
    with frame_pool(jobs, options.pipeline) as pool:
        outcomes: list[Summary | InputError] = []
        for bag, target in targets.items():
            try:
                outcomes.append(finished[bag] or _replay(
                    bag, target, options, pool, force=force, resume=resume,
                ))
            except InputError as error:
                outcomes.append(error)
            except (MemoryError, OSError):
                raise
            except Exception as error:
                # An internal error must not stop the other recordings.
                if not options.several:
                    raise
                reason = printable(" ".join(str(error).split()))
                outcomes.append(InputError(
                    f"internal error, {type(error).__name__}: {reason} (replay it separately with "
                    "--debug, which shows where)"))
    return settle(targets, outcomes)


def settle(
    targets: Mapping[Place, Place], outcomes: Sequence[Summary | InputError]
) -> list[Summary]:
    """Return a summary for each recording; if all failed, raise the first error."""
    errors = [outcome for outcome in outcomes if isinstance(outcome, InputError)]
    if errors and len(errors) == len(outcomes):
        raise errors[0]
    return [
        outcome if isinstance(outcome, Summary)
        else Summary(str(bag), str(target), error=str(outcome))
        for (bag, target), outcome in zip(targets.items(), outcomes, strict=True)]


def _replay(
    bag: Place, target: Place, options: ReplayOptions, pool: FramePool, *, force: bool, resume: bool
) -> Summary:
    """Replay a recording; URLs are downloaded, and results for URLs uploaded.

    After an interruption a readable partial result remains.
    """
    check_exports(options)
    with (
        stores.recording_here(bag) as recording,
        stores.result_here(target, force=force) as place,
        BagReader(recording) as reader,
        sole_writer(place, RESULT),
    ):
        used, lacks = without_lacking(reader, options) if options.several else (options, {})
        stream = InputStream(reader, used)
        folder = ResultFolder(place, force=force, resume=resume)
        try:
            replay = _Replay(reader, stream, options, folder, bag)
            replay.summary.lacks = [f"{name} is not joined: {why}" for name, why in lacks.items()]
            with replay:
                replay.run(pool)
        except OSError as error:
            raise InputError(
                f"cannot write {folder.work}: {error.strerror or error}; with more space "
                "--resume continues it"
            ) from error
    return replace(replay.summary, output=str(target))


def _finished(bag: Place, target: Place, options: ReplayOptions) -> Summary | None:
    """Return the summary of an existing complete result of the same recording and options."""
    with ExitStack() as fetched:
        try:
            folder = fetched.enter_context(stores.files_here(target, (MARK, TABLE)))
            state = read_state(folder)
        except (OSError, ValueError):
            return None
        if not state.get("complete"):
            return None
        if isinstance(bag, str):
            # Comparing the recording would need a download.
            origin = Origin(bag, str(state.get("fingerprint")), __version__, options.parameters())
        else:
            origin = Origin.of(bag, find_files(bag).files, options.parameters())
        difference = origin.difference(state)
        if not difference and state.get("extras") != options.extras():
            difference = (
                "was made with other --images, --video, --geo, --netcdf, --parquet, "
                "--attribute, --all-topics")
        if difference:
            raise InputError(
                f"{target} exists already and {difference}: give another name, or --force to "
                "replace")
        try:
            summary = Summary.of_finished(str(bag), str(target), state, folder / TABLE)
            # Final texts read more of the state, so that damage is found here.
            verdict(summary)
            return summary
        except (
            LookupError, TypeError, ValueError, ArithmeticError, AttributeError, OSError
        ) as error:
            raise InputError(
                f"{target} is damaged: give another name, or --force to replace the result"
            ) from error


class _Replay:
    """State of a running replay: everything that is open."""

    def __init__(
        self,
        reader: BagReader,
        stream: InputStream,
        options: ReplayOptions,
        folder: ResultFolder,
        source: Place,
    ) -> None:
        self._reader, self._stream = reader, stream
        self._options, self._folder = options, folder
        self._begin = time.monotonic()
        selection = stream.selection
        self.summary = Summary(str(source), str(folder.target), notes=list(selection.notes))
        self.summary.topics = {
            name: topic for name, topic in selection.by_use().items() if topic is not None}
        if "camera.transfer" not in options.told and stream.like_video():
            self.summary.notes.append(ASK_TRANSFER)
        self._origin = Origin.of(reader.path, reader.files, options.parameters())
        self._check_earlier()
        self._hash = FileHash(reader.files)
        self._earlier: EarlierPart | None = None
        if folder.earlier is not None:
            self._earlier = EarlierPart(folder.earlier, frame_topics(options))
        self._copied = copied_topics(selection, reader.channels) if options.all_topics else {}
        self._recorder = FrameRecorder(folder.work, options, self._copied)
        self._joiner = Joiner(
            stream.plausibility, selection.position is not None, options.origin, options.joins,
            options.join_tolerance,
        )
        folder.write_state(self._state())

    def run(self, pool: FramePool) -> None:
        lights = LightHistory(pool.read_ahead)
        with closing(Progress(self._reader.path.name, self._stream.expected_frames)) as progress:
            for item in pool.answers(
                self._tasks(self._stream.events(), lights), lambda: self._recorder.filter.known
            ):
                if isinstance(item, FrameAnswer):
                    filtered = self._recorder.write_frame(item)
                    lights.add(self._recorder.filter.lamps)
                    self._write_rows(self._joiner.add_frame(item.record, filtered))
                    progress.add()
                else:
                    self._write_rows(self._joiner.add(item))
        if self._copied:
            for message in self._reader.messages(self._copied, *self._stream.interval()):
                self._recorder.copy(message, ros1=self._reader.ros1)
        self.summary.complete = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *details: object) -> None:
        if kind is not None:
            self._hash.stop()
            if self.summary.frames == 0 and issubclass(kind, (InputError, KeyboardInterrupt)):
                # Refused or interrupted before the first frame: nothing is worth keeping.
                self._recorder.close({})
                self._folder.refuse_earlier()
                return
        try:
            self._finish()
        except OSError:
            # The first error matters more than a report that cannot be written on a full disk.
            if kind is None:
                raise
        if kind is None:
            self._folder.forget_earlier()
            self._folder.check_complete()
            (self._folder.work / LOG).unlink()
            self._folder.complete()
        elif self._earlier is not None and self.summary.frames < self._earlier.frames():
            # This run has fewer frames than the earlier part, which is kept for --resume.
            self._folder.refuse_earlier()
        else:
            self._folder.forget_earlier()

    def _tasks(
        self, events: Iterable[Event], lights: LightHistory
    ) -> Iterator[Any]:
        """Yield a task or an earlier answer for each frame, and sensor values.

        Under lamps a frame is restored with the light of earlier frames, except the last few, which
        other processes may still be processing.
        """
        recording = Recording.of(
            self._reader, self._stream.selection, self._options, frame_topics(self._options))
        known = self._earlier.answers() if self._earlier is not None else iter(())
        for event in events:
            if not isinstance(event, RecordedFrame):
                yield event
                continue
            earlier = next(known, None)
            if earlier is not None and earlier.record.frame != event.number:
                raise InputError(
                    f"{self._folder.earlier} has other frames: --force starts over"
                )
            light = lights.next()
            yield FrameTask(recording, event, light) if earlier is None else earlier

    def _write_rows(self, frames: Iterator[JoinedFrame]) -> None:
        for joined in frames:
            self._recorder.write_row(joined)
            self.summary.frames += 1

    def _finish(self) -> None:
        """Close everything, complete or partial, and write report and summary."""
        if self.summary.complete:
            self._write_rows(self._joiner.finish())
        table = read_table(self._folder.work / TABLE, self._recorder.columns)
        self._collect(table)
        summary, origin = self.summary, self._origin
        summary.provenance = {
            "version": origin.version, "bag": origin.bag, "input_sha256": self._hash.result(),
            "complete": summary.complete, "parameters": origin.parameters,
            "told": list(self._options.told),
            "threads": number_of_threads(self._options.pipeline.threads),
        }
        self._recorder.close(summary.provenance)
        self._folder.write_state(self._state())
        self._write_extras(table)

    def _state(self) -> dict[str, Any]:
        return self.summary.state(self._origin) | {"extras": self._options.extras()}

    def _collect(self, table: Columns) -> None:
        stream, summary = self._stream, self.summary
        summary.read(
            table, self._options.pipeline.assessment.contrast, self._recorder.baselines)
        summary.resumed = self._recorder.resumed
        summary.dropped = stream.synchronizer.dropped
        summary.damage = list(dict.fromkeys(self._reader.damage))
        if summary.complete:
            summary.damage += stream.missing()
        summary.damage += [f"{reason} ({count})" for reason, count in stream.problems.items()]
        if self._joiner.unplaced:
            summary.damage.append(
                f"{self._joiner.unplaced} of {summary.frames} frames have no position: "
                f"{stream.selection.position} has no fixes around them within {LONGEST_GAP:g} s")
        restarts, recalibrated = stream.synchronizer.restarts, self._recorder.recalibrated
        if restarts:
            summary.damage.append(f"stamps of the images jumped back {_times(restarts)}")
        if recalibrated:
            summary.damage.append(
                f"camera_info changed {_times(len(recalibrated))}, first at frame "
                f"{recalibrated[0]}: ranges before or after are wrong, unless the cameras changed "
                "as well")
        summary.seconds = time.monotonic() - self._begin

    def _write_extras(self, table: Columns) -> None:
        from uw_visibility.replay.report.gallery import Gallery
        from uw_visibility.replay.report.report import fit_joins, write_report
        from uw_visibility.replay.report.sentences import assumed

        work = self._folder.work
        write_exports(work, table, self._recorder.columns, self.summary.provenance, self._options)
        gallery = Gallery(
            work, table, self._reader, self._stream.selection,
            rectify=self._options.node.rectify)
        if self.summary.complete:
            gallery.write(self._options, assumed(self.summary))
        joins = fit_joins(work, table, self._options.joins)
        write_report(work, table, gallery, self.summary, joins)

    def _check_earlier(self) -> None:
        """Refuse to continue with another input or other parameters."""
        earlier = self._folder.earlier
        if earlier is None:
            return
        try:
            difference = self._origin.difference(read_state(earlier))
            problem = difference and f"the partial result {self._folder.work} {difference}"
        except (OSError, ValueError) as error:
            problem = f"cannot go on from {self._folder.work}: {error}"
        if problem:
            self._folder.refuse_earlier()
            raise InputError(f"{problem}: --force starts over")


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
