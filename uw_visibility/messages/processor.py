# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frame processor: from the messages of a stereo frame to output messages, in node and replay."""

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

# Kernels are compiled by type of pixel, not by size or rig, so a small image suffices.
WARM_UP_RIG = StereoRig(200.0, 0.1, (79.5, 59.5))
WARM_UP_SHAPE = (120, 160)
# Width for checks of parameters before the first image, px.
LARGEST_WIDTH = 1 << 16


@functools.cache
def warm_up(config: PipelineConfig, *, compressed: bool = False) -> None:
    """Compile or load all kernels that frames of 8 bit need.

    Runs once for each configuration, since one process may replay several recordings.
    """
    pipeline = Pipeline(WARM_UP_RIG, warm_up_config(config))
    pipeline.warm_up(WARM_UP_SHAPE, compressed=compressed)


def try_out(
    config: PipelineConfig, rig: StereoRig | None = None, shape: tuple[int, int] | None = None
) -> None:
    """Refuse parameters with which no frame, of a rig and a shape if known, can be processed."""
    pipeline = Pipeline(rig or WARM_UP_RIG, config)
    if shape is not None:
        pipeline.allocate(shape)
    elif config.stereo.max_disparity:
        disparity_limits(config.stereo, LARGEST_WIDTH)


@dataclass(frozen=True, eq=False)
class FrameWork:
    """One frame in process: its messages, the pair read from them, and the pipeline for it."""

    frame: StereoFrame
    pair: StereoPair
    pipeline: Pipeline
    make: MessageFactory

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
            return water.at(self.header.seconds, self.pair.rig) if water else None

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
        """Make the messages of the frame's result, by topic, without those not assessable.

        `filtered` is the estimate filtered up to this frame, if frames are tracked.
        """
        return each_message(
            Source(self.make, self.frame, self.pair, result, node_config, filtered), topics
        )


class FrameProcessor:
    """Frame processor: reads frames, runs the pipeline and makes the messages of its results.

    A change of calibration or configuration makes a new pipeline. `rectify` is set for raw
    images; `reader` counts the changes of calibration.
    """

    def __init__(self, make: MessageFactory, rectify: bool) -> None:
        self.reader = FrameReader(rectify)
        self._make = make
        # By lane.
        self._pipelines: dict[int, Pipeline] = {}
        self._workers: tuple[int, Workers] | None = None
        self._lock = threading.Lock()

    def begin(
        self, frame: StereoFrame, pipeline_config: PipelineConfig, lane: int = 0
    ) -> FrameWork:
        """Read a frame, and make its pipeline if it is not that of the lane's last frame.

        Frames that are processed at the same time need different lanes.
        """
        with self._lock:
            pair = self.reader.read(frame)
            made = self._pipelines.get(lane)
            if made is None or (made.rig, made.config) != (pair.rig, pipeline_config):
                # Free its memory before the next pipeline allocates.
                self._pipelines.pop(lane, None)
                made = None
                threads = pipeline_config.threads
                # All pipelines share the threads while their number is the same.
                if self._workers is None or self._workers[0] != threads:
                    self._workers = threads, Workers(threads)
                made = self._pipelines[lane] = Pipeline(
                    pair.rig, pipeline_config, self._workers[1])
        return FrameWork(frame, pair, made, self._make)
