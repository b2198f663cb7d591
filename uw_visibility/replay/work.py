# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Work on one recorded frame, in any process."""

from __future__ import annotations

import traceback
import uuid
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.messages.outputs import all_topics
from uw_visibility.messages.processor import FrameProcessor, FrameWork
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.replay.bags.decoder import Decoder, jazzy_types
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.bags.storage import Channel
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.stream import RecordedFrame
from uw_visibility.replay.inputs.topics import Selection
from uw_visibility.replay.records import FrameEstimate, FrameRecord
from uw_visibility.water.estimate import LampLight
from uw_visibility.water.filter import FilteredWater, WaterFilter


@dataclass(frozen=True)
class Recording:
    """Options and topics that all frames of a recording share.

    Attributes
    ----------
    key : str
        Tells recordings apart.
    channels : dict of str to Channel
        Definitions by type of message.
    ros1 : bool
        How messages are serialised.
    pipeline, node : PipelineConfig, NodeConfig
        Parameters.
    topics : tuple of str
        Outputs to make of each frame.
    match_original : bool
        Whether the raw pair is matched too, for comparison.
    """

    key: str
    channels: Mapping[str, Channel]
    ros1: bool
    pipeline: PipelineConfig
    node: NodeConfig
    topics: tuple[str, ...]
    match_original: bool = False

    @classmethod
    def of(
        cls,
        reader: BagReader,
        selection: Selection,
        options: ReplayOptions,
        topics: Collection[str],
    ) -> Recording:
        """Collect the options and topics that the frames of a recording share."""
        used = [reader.channels[t] for t in (*selection.images(), *selection.infos())]
        return cls(
            uuid.uuid4().hex, {channel.type: channel for channel in used}, reader.ros1,
            options.pipeline, options.node, tuple(topics), options.match_original,
        )


@dataclass(frozen=True)
class FrameTask:
    """Task: a frame to work on, with the light of lamps over the frames before, where known."""

    recording: Recording
    frame: RecordedFrame
    known_light: LampLight | None = None


@dataclass(frozen=True)
class FrameAnswer:
    """Answer to a frame's task: record, messages and timing.

    Attributes
    ----------
    record : FrameRecord
        Estimate, or the reason of its failure.
    messages : list of tuple
        Topic and serialised message (CDR), in the order of publishing.
    timing_ms : dict of str to float
        Durations of the stages.
    """

    record: FrameRecord
    messages: list[tuple[str, bytes]] = field(default_factory=list)
    timing_ms: dict[str, float] = field(default_factory=dict)


class RecordingProcessor:
    """Processor of the frames of one recording."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._decoder = Decoder(recording.channels, recording.ros1)
        self._types, make = jazzy_types()
        self._processor = FrameProcessor(make, recording.node.rectify)
        self._types_by_topic = all_topics(recording.node)

    def answer(
        self, frame: RecordedFrame, known_light: LampLight | None = None
    ) -> FrameAnswer:
        """Process a task; whatever goes wrong costs this frame alone."""
        record = FrameRecord(frame.number, frame.stamp, frame.right_stamp, frame.time)
        try:
            work, result = self._assess(frame, known_light)
            messages = [
                (topic, bytes(self._types.serialize_cdr(message, self._types_by_topic[topic])))
                for topic, message in self._messages(work, result)
            ]
        except InputError as error:
            return FrameAnswer(replace(record, reason=str(error)))
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            reason = f"internal error, {type(error).__name__} at {place.name}:{place.lineno}"
            return FrameAnswer(replace(record, reason=reason))
        estimate = FrameEstimate.of(result, work.rig, work.header)
        return FrameAnswer(replace(record, estimate=estimate), messages, result.timing_ms)

    def process(
        self, frame: RecordedFrame, water_filter: WaterFilter
    ) -> tuple[FrameResult, FilteredWater | None, dict[str, Any]]:
        """Process the next frame; returns result, filtered estimate and messages by topic."""
        work, result = self._assess(frame, water_filter.lamps, confidence=True)
        filtered = water_filter.update(result.water, work.header.seconds, work.rig)
        return result, filtered, dict(self._messages(work, result, filtered))

    def _assess(
        self, frame: RecordedFrame, known_light: LampLight | None, confidence: bool = False
    ) -> tuple[FrameWork, FrameResult]:
        recording = self._recording
        work = self._processor.begin(frame.messages(self._decoder.decode), recording.pipeline)
        return work, work.assess(
            recording.topics, match_original=recording.match_original, confidence=confidence,
            known_light=known_light,
        )

    def _messages(
        self, work: FrameWork, result: FrameResult, filtered: FilteredWater | None = None
    ) -> Iterator[tuple[str, Any]]:
        return work.messages(result, self._recording.node, self._recording.topics, filtered)


_processors: dict[str, RecordingProcessor] = {}


def answer(task: FrameTask) -> FrameAnswer:
    """Work on a frame in this process, which keeps what the recording's frames share."""
    key = task.recording.key
    if key not in _processors:
        # One recording after the other: the one before is done with, or nearly.
        while len(_processors) > 1:
            del _processors[next(iter(_processors))]
        _processors[key] = RecordingProcessor(task.recording)
    return _processors[key].answer(task.frame, task.known_light)
