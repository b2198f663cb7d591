# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Processing of recorded frames, in this process or in several.

Processes compute what depends on a single frame. The receiver of the answers keeps the state
between frames, in the order of the recording, so that results do not depend on the number of
processes, except under lamps, see `LightHistory`.
"""

from __future__ import annotations

import signal
import traceback
import uuid
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from uw_visibility.compute.processes import process_pool
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.messages.outputs import all_topics
from uw_visibility.messages.processor import FrameProcessor, FrameWork, try_out, warm_up
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.replay.bags.decoder import Decoder, jazzy_types
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.bags.storage import Channel
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.stream import RecordedFrame
from uw_visibility.replay.inputs.topics import Selection
from uw_visibility.replay.records import FrameEstimate, FrameRecord
from uw_visibility.water.estimate import LampLight
from uw_visibility.water.series.filter import FilteredWater, KnownWater, WaterFilter


@dataclass(frozen=True)
class Recording:
    """Options and topics that all frames of a recording share."""

    key: str  # unique for each recording
    channels: Mapping[str, Channel]  # definitions by message type
    ros1: bool
    pipeline: PipelineConfig
    node: NodeConfig
    topics: tuple[str, ...]  # outputs of each frame
    match_original: bool = False

    @classmethod
    def of(
        cls, reader: BagReader, selection: Selection, options: ReplayOptions,
        topics: Collection[str],
    ) -> Recording:
        """Collect the options and topics that the frames of a recording share."""
        used = [reader.channels[t] for t in (*selection.images(), *selection.infos())]
        return cls(
            uuid.uuid4().hex, {channel.type: channel for channel in used}, reader.ros1,
            options.pipeline, replace(options.node, rectify=selection.rectify), tuple(topics),
            options.match_original,
        )


@dataclass(frozen=True)
class FrameTask:
    """Task: a frame to process, with light of lamps and water of earlier frames, if known."""

    recording: Recording
    frame: RecordedFrame
    known_light: LampLight | None = None
    known_water: KnownWater | None = None


@dataclass(frozen=True)
class FrameAnswer:
    """Answer to a task: record of the frame, topics and serialised messages (CDR).

    Messages are in the order of publishing. `asked`: images depend on the water of earlier
    frames. `resumed`: from an earlier, interrupted replay.
    """

    record: FrameRecord
    messages: list[tuple[str, bytes]] = field(default_factory=list)
    asked: bool = False
    resumed: bool = False


class RecordingProcessor:
    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._decoder = Decoder(recording.channels, recording.ros1)
        self._types, make = jazzy_types()
        self._processor = FrameProcessor(make, recording.node.rectify)
        self._types_by_topic = all_topics(recording.node)

    def answer(self, task: FrameTask) -> FrameAnswer:
        """Process a frame; an error loses only this frame."""
        asked = []
        frame, recording = task.frame, self._recording

        def known() -> KnownWater | None:
            asked.append(True)
            return task.known_water

        record = FrameRecord(
            frame.number, frame.parts.stamp, frame.parts.right_stamp, frame.time)
        try:
            work, result = self._assess(frame, task.known_light, known)
            messages = [
                (topic, bytes(self._types.serialize_cdr(message, self._types_by_topic[topic])))
                for topic, message in work.messages(result, recording.node, recording.topics)
            ]
        except InputError as error:
            return FrameAnswer(replace(record, reason=str(error)))
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            reason = f"internal error, {type(error).__name__} at {place.name}:{place.lineno}"
            return FrameAnswer(replace(record, reason=reason))
        estimate = FrameEstimate.of(result, work.pair.rig, work.header)
        return FrameAnswer(replace(record, estimate=estimate), messages, bool(asked))

    def process(
        self, frame: RecordedFrame, water_filter: WaterFilter
    ) -> tuple[FrameResult, FilteredWater | None, dict[str, Any]]:
        """Process the next frame; returns result, filtered estimate and messages by topic."""
        work, result = self._assess(
            frame, water_filter.lamps, lambda: water_filter.known, confidence=True)
        filtered = water_filter.update(result.water, work.header.seconds, work.pair.rig)
        messages = work.messages(
            result, self._recording.node, self._recording.topics, filtered)
        return result, filtered, dict(messages)

    def _assess(
        self, frame: RecordedFrame, known_light: LampLight | None,
        known_water: Callable[[], KnownWater | None], confidence: bool = False,
    ) -> tuple[FrameWork, FrameResult]:
        recording = self._recording
        work = self._processor.begin(frame.messages(self._decoder.decode), recording.pipeline)
        return work, work.assess(
            recording.topics, match_original=recording.match_original, confidence=confidence,
            known_light=known_light, known_water=known_water,
        )


_processors: dict[str, RecordingProcessor] = {}


def answer(task: FrameTask) -> FrameAnswer:
    """Process a frame in this process, which caches the processor of its recording."""
    key = task.recording.key
    if key not in _processors:
        # Recordings are replayed in turn: earlier ones are done, or nearly done.
        while len(_processors) > 1:
            del _processors[next(iter(_processors))]
        _processors[key] = RecordingProcessor(task.recording)
    return _processors[key].answer(task)


# Frames read ahead per process, so that none waits, within the memory.
READ_AHEAD = 2


class FramePool:
    """Pool of processes, see `frame_pool`; with one job this process, without an executor.

    read_ahead: most unanswered tasks when the next one is given.
    """

    def __init__(self, jobs: int, executor: Executor | None = None) -> None:
        self.read_ahead = 0 if jobs == 1 else READ_AHEAD * jobs
        self._executor = executor

    def answers(
        self, items: Iterable[Any], known: Callable[[], KnownWater | None] = lambda: None
    ) -> Iterator[Any]:
        """Yield the answers to tasks in the order of the items, and other items unchanged.

        `known` returns the water after the answers yielded so far. Processes that work ahead do
        not have it: frames that depend on it are processed again.
        """
        # Tasks with their futures, and other items with None.
        waiting: deque[tuple[Any, Future[FrameAnswer] | None]] = deque()
        tasks = 0
        for item in items:
            if not isinstance(item, FrameTask):
                waiting.append((item, None))
            elif self._executor is None:
                yield answer(replace(item, known_water=known()))
            else:
                waiting.append((item, self._executor.submit(answer, item)))
                tasks += 1
            while waiting:
                head, future = waiting[0]
                if future is not None and not future.done() and tasks <= self.read_ahead:
                    break
                waiting.popleft()
                tasks -= future is not None
                yield self._settled(head, future, known())
        for head, future in waiting:
            yield self._settled(head, future, known())

    def _settled(
        self, item: Any, future: Future[FrameAnswer] | None, known: KnownWater | None
    ) -> Any:
        if future is None:
            return item
        found = future.result()
        if found.asked and known is not None:
            assert self._executor is not None
            again = replace(item, known_water=known)
            found = self._executor.submit(answer, again).result()
        return found


@contextmanager
def frame_pool(jobs: int, config: PipelineConfig) -> Iterator[FramePool]:
    """Open a pool of `jobs` processes, warmed up for a configuration."""
    # Once here, instead of in each process or for each frame.
    try_out(config)
    if jobs == 1:
        warm_up(config)
        yield FramePool(jobs)
        return
    with process_pool(jobs, _begin, config) as executor:
        yield FramePool(jobs, executor)


def _begin(config: PipelineConfig) -> None:
    # Ctrl-C reaches all processes of a terminal; the parent ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warm_up(config)


class LightHistory:
    """History of the light of lamps after each answered frame.

    A frame gets the light after the frame `ahead` + 1 before it, since `ahead` frames may be
    unanswered when its task is given. Results thus do not depend on the speed of processes, but on
    their number.
    """

    def __init__(self, ahead: int) -> None:
        self._ahead = ahead
        self._lights: deque[LampLight | None] = deque([None])
        self._given = 0

    def add(self, light: LampLight | None) -> None:
        """Add the light after the next answered frame."""
        # Its observations are large, and restoration does not need them.
        self._lights.append(None if light is None else replace(light, nodes=None, ground=None))

    def next(self) -> LampLight | None:
        """Light for the next frame; None if none is known yet."""
        if self._given > self._ahead:
            self._lights.popleft()
        self._given += 1
        return self._lights[0]
