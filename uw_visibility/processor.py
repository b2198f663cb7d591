# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""From a stereo frame of messages to the outgoing messages: the path of node and replay."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from uw_visibility.config import NodeConfig, PipelineConfig
from uw_visibility.frames import FrameReader, StereoFrame
from uw_visibility.messages import MessageFactory, stamp_to_nanoseconds
from uw_visibility.outputs import Source, build_messages, enhanced_sides
from uw_visibility.pipeline import Pipeline
from uw_visibility.result import FrameResult
from uw_visibility.stereo.rig import StereoRig


class FrameProcessor:
    """Reads frames, runs the pipeline on them and makes the messages of its results.

    The pipeline is made anew when the calibration or its configuration changes.

    Parameters
    ----------
    make : MessageFactory
        Makes the outgoing messages.
    rectify : bool
        Whether the images are raw.
    track : bool
        Whether frames come one after the other, to be filtered over time as
        `TrackingConfig` says; else each is taken for itself.

    Attributes
    ----------
    reader : FrameReader
        Knows how often the calibration changed.
    """

    def __init__(self, make: MessageFactory, rectify: bool, track: bool = False) -> None:
        self._track = track
        self.reader = FrameReader(rectify)
        self._make = make
        self._pipeline: Pipeline | None = None
        self._made_for: tuple[StereoRig, PipelineConfig] | None = None

    def process(
        self,
        frame: StereoFrame,
        pipeline_config: PipelineConfig,
        node_config: NodeConfig,
        topics: Collection[str],
        *,
        match_original: bool = False,
        confidence: bool = False,
    ) -> tuple[FrameResult, dict[str, Any]]:
        """Process one frame.

        Parameters
        ----------
        frame : StereoFrame
            Input messages.
        pipeline_config : PipelineConfig
            Holds for this frame.
        node_config : NodeConfig
            Holds for this frame.
        topics : collection of str
            Outputs wanted, of `uw_visibility.outputs.all_topics`.
        match_original : bool
            Whether to match the raw pair too, for comparison.
        confidence : bool
            Whether to rate the disparities; no message carries it.

        Returns
        -------
        result : FrameResult
            What the pipeline found.
        messages : dict of str to object
            Message by topic; what is not assessable is absent.

        Raises
        ------
        InputError
            If the frame cannot be used, or shows nothing that could be matched.
        """
        pair = self.reader.read(frame)
        wanted = (pair.rig, pipeline_config)
        if self._pipeline is None or wanted != self._made_for:
            self._pipeline = Pipeline(*wanted)
            self._made_for = wanted
        result = self._pipeline.process(
            pair.left, pair.right, valid=pair.valid, match_original=match_original,
            enhance=enhanced_sides(topics), stamp=self._stamp(frame), confidence=confidence,
        )
        source = Source(self._make, frame, pair, result, node_config)
        return result, build_messages(source, topics)

    def _stamp(self, frame: StereoFrame) -> float | None:
        if not self._track:
            return None
        return 1e-9 * stamp_to_nanoseconds(frame.left.header.stamp)
