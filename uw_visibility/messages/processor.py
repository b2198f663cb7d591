# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frame processor: from the messages of a stereo frame to outgoing ones, in node and replay."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.messages.estimates import ImageHeader
from uw_visibility.messages.frames import FrameReader, StereoFrame, StereoPair
from uw_visibility.messages.images import MessageFactory
from uw_visibility.messages.outputs import Source, each_message, enhanced_sides
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.pipeline.warm_up import warm_up_config
from uw_visibility.stereo.matchers import disparity_limits
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import LampLight, WaterEstimate
from uw_visibility.water.series.filter import FilteredWater, KnownWater

# Kernels are compiled once per type of pixel, not per size or rig; a small image is quicker.
WARM_UP_RIG = StereoRig(200.0, 0.1, (79.5, 59.5))
WARM_UP_SHAPE = (120, 160)
# Before the first image comes any width is possible, px.
LARGEST_WIDTH = 1 << 16


@functools.cache
def warm_up(config: PipelineConfig, *, compressed: bool = False) -> None:
    """Compile what frames of 8 bit need and is not compiled yet, or load it.

    Once for a configuration: several recordings are replayed in one process.
    """
    pipeline = Pipeline(WARM_UP_RIG, warm_up_config(config))
    pipeline.warm_up(WARM_UP_SHAPE, compressed=compressed)


def try_out(
    config: PipelineConfig, rig: StereoRig | None = None, shape: tuple[int, int] | None = None
) -> None:
    """Refuse parameters with which no frame could be processed, of a rig and a shape where known.
    """
    pipeline = Pipeline(rig or WARM_UP_RIG, config)
    if shape is not None:
        pipeline.allocate(shape)
    elif config.stereo.max_disparity:
        disparity_limits(config.stereo, LARGEST_WIDTH)


@dataclass(frozen=True, eq=False)
class FrameWork:
    """Work on one frame: the pair that was read, to be assessed and told of."""

    frame: StereoFrame
    pair: StereoPair
    pipeline: Pipeline
    make: MessageFactory

    @property
    def rig(self) -> StereoRig:
        return self.pair.rig

    @property
    def header(self) -> ImageHeader:
        return ImageHeader.of(self.frame.left)

    def assess(
        self,
        topics: Collection[str],
        *,
        match_original: bool = False,
        confidence: bool = False,
        known_light: LampLight | None = None,
        known_water: Callable[[], KnownWater | None] | None = None,
    ) -> FrameResult:
        """Run the pipeline on the frame, for topics of `uw_visibility.messages.outputs.all_topics`.

        See `Pipeline.process` for the other parameters, and `WaterFilter.known` for what
        `known_water` returns; no message carries the confidence.
        """
        pair = self.pair

        def known() -> WaterEstimate | None:
            water = known_water and known_water()
            return water.at(self.header.seconds, self.rig) if water else None

        return self.pipeline.process(
            pair.left, pair.right, valid=pair.valid, match_original=match_original,
            enhance=enhanced_sides(topics), confidence=confidence, colour=pair.chroma,
            known_light=known_light, known_water=known_water and known,
        )

    def messages(
        self,
        result: FrameResult,
        node_config: NodeConfig,
        topics: Collection[str],
        filtered: FilteredWater | None = None,
    ) -> Iterator[tuple[str, Any]]:
        """Make the messages of the frame's result, by topic; what is not assessable is absent.

        `filtered` is the estimate filtered up to this frame, where frames are tracked.
        """
        return each_message(
            Source(self.make, self.frame, self.pair, result, node_config, filtered), topics
        )


class FrameProcessor:
    """Frame processor: reads frames, runs the pipeline and makes the messages of its results.

    A pipeline is made anew when the calibration or its configuration changes. `rectify` says
    that the images are raw; `reader` knows how often the calibration changed.
    """

    def __init__(self, make: MessageFactory, rectify: bool) -> None:
        self.reader = FrameReader(rectify)
        self._make = make
        # Of each lane.
        self._pipelines: dict[int, Pipeline] = {}
        self._threads: tuple[int, Workers] | None = None
        self._lock = threading.Lock()

    def begin(
        self, frame: StereoFrame, pipeline_config: PipelineConfig, lane: int = 0
    ) -> FrameWork:
        """Read a frame, and make the pipeline that it needs.

        Frames that are processed at the same time are in lanes of their own.
        """
        with self._lock:
            pair = self.reader.read(frame)
            made = self._pipelines.get(lane)
            if made is None or (made.rig, made.config) != (pair.rig, pipeline_config):
                # Its memory is free before that of the next one is allocated.
                self._pipelines.pop(lane, None)
                made = None
                workers = self._workers(pipeline_config.threads)
                made = self._pipelines[lane] = Pipeline(pair.rig, pipeline_config, workers)
        return FrameWork(frame, pair, made, self._make)

    def _workers(self, threads: int) -> Workers:
        """Return the threads of the pipeline before, if there are to be as many."""
        if self._threads is None or self._threads[0] != threads:
            self._threads = threads, Workers(threads)
        return self._threads[1]
