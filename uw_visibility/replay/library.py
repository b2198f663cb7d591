# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Replay as an iterator over results."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.messages.outputs import all_topics
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.stream import InputStream, RecordedFrame
from uw_visibility.replay.inputs.topics import Wanted
from uw_visibility.replay.work import Recording, RecordingProcessor
from uw_visibility.water.series.filter import FilteredWater, WaterFilter

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ReplayedFrame:
    """Frame of a recording with result of the pipeline and messages.

    Attributes
    ----------
    number : int
        Number of the frame in the recording.
    stamp : int
        Stamp of the left image, ns.
    time : int
        Time at which the left image was received, ns.
    result : FrameResult
        Result of the pipeline.
    filtered : FilteredWater or None
        Water filtered over the frames up to this one; None without tracking.
    messages : dict of str to object
        Messages that the node would publish, by topic.
    """

    number: int
    stamp: int
    time: int
    result: FrameResult
    filtered: FilteredWater | None
    messages: Mapping[str, Any]


def read(
    bag: str | Path,
    parameters: Mapping[str, Any] | None = None,
    *,
    topics: Wanted | None = None,
    calibration: tuple[Any, Any] | None = None,
    start: float = 0.0,
    duration: float = float("inf"),
    every: int = 1,
    match_original: bool = False,
) -> Iterator[ReplayedFrame]:
    """Yield the results of a recording, frame by frame.

    Unusable frames are skipped, and logged as warnings with the reason.

    Parameters
    ----------
    bag : str or Path
        Folder of a ROS 2 bag, one of its files, or a .bag of ROS 1.
    parameters : mapping of str to object, optional
        Parameters of the node, by name: ``{"rectify": True, "stereo.max_disparity": 96}``.
    topics : Wanted, optional
        Topics to use instead of those found by type and name.
    calibration : tuple of two objects, optional
        Left and right CameraInfo, or objects with their fields, instead of the
        recorded ones.
    start, duration : float
        Part of the recording, s.
    every : int
        Process only every Nth frame.
    match_original : bool
        Whether to match also the raw pair, for comparison.

    Yields
    ------
    ReplayedFrame
        In the order of the recording.

    Raises
    ------
    InputError
        If the recording cannot be read, has no stereo pair, or a parameter is
        not allowed.

    Examples
    --------
    >>> from uw_visibility import replay
    >>> for frame in replay.read("dive", {"rectify": True}):    # doctest: +SKIP
    ...     print(frame.stamp, frame.result.visibility.distance)
    """
    values = dict(parameters or {})
    options = ReplayOptions(
        pipeline=PipelineConfig.from_parameters(values),
        node=NodeConfig.from_parameters(values),
        wanted=topics or Wanted(),
        sensor_type=values.get("plausibility.sensor_type"),
        told=tuple(sorted(values)),
        infos=calibration,
        start=start,
        duration=duration,
        every=every,
        match_original=match_original,
    )
    with BagReader(bag) as reader:
        stream = InputStream(reader, options)
        recording = Recording.of(reader, stream.selection, options, all_topics(options.node))
        processor = RecordingProcessor(recording)
        water_filter = WaterFilter(options.pipeline)
        for event in stream.events():
            if not isinstance(event, RecordedFrame):
                continue
            try:
                result, filtered, messages = processor.process(event, water_filter)
            except InputError as error:
                log.warning("frame %d: %s", event.number, error)
                continue
            yield ReplayedFrame(
                event.number, event.parts.stamp, event.time, result, filtered, messages
            )
        for note in reader.damage:
            log.warning("%s", note)
