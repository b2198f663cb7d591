# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filter over frames in a replay, where the frames' estimates arrive in order.

The filter is the only part of a frame's way that needs the frames before it. It
is applied here, to estimates that other processes may have made.
"""

from __future__ import annotations

from uw_visibility.config.schema import NodeConfig, PipelineConfig
from uw_visibility.messages.estimates import ESTIMATES, Estimate
from uw_visibility.messages.outputs import FILTERED, all_topics
from uw_visibility.replay.bags.decoder import jazzy_types
from uw_visibility.replay.records import FrameEstimate
from uw_visibility.water.estimate import LampLight
from uw_visibility.water.filter import FilteredWater, WaterFilter


def split_topics(pipeline: PipelineConfig, node: NodeConfig) -> tuple[list[str], list[str]]:
    """Return the topics that a frame alone fills, and those of the filter."""
    topics = list(all_topics(node))
    if not pipeline.tracking.enabled:
        return topics, []
    filtered = [f"{FILTERED}/{name}" for name in ESTIMATES]
    return [t for t in topics if t not in filtered], filtered


class FilterStage:
    """Filter stage: filters estimates in order and makes the messages of the filtered ones."""

    def __init__(self, pipeline: PipelineConfig, node: NodeConfig) -> None:
        self._node = node
        self._store, self._make = jazzy_types()
        self._filter = WaterFilter(pipeline)

    @property
    def lamps(self) -> LampLight | None:
        """Light of the lamps over the frames so far; see `WaterFilter.lamps`."""
        return self._filter.lamps

    def add(
        self, estimate: FrameEstimate
    ) -> tuple[list[tuple[str, bytes]], FilteredWater | None]:
        """Take a frame's estimate.

        Returns
        -------
        messages : list of tuple
            Topic and serialised message.
        filtered : FilteredWater or None
            None where tracking is off.
        """
        filtered = self._filter.update(estimate.water, estimate.header.seconds, estimate.rig)
        if filtered is None:
            return [], None
        source = Estimate(
            self._make, estimate.header, filtered.water, filtered.visibility,
            estimate.field_of_view, self._node,
        )
        messages = ((name, kind, source.message(name)) for name, kind in ESTIMATES.items())
        return [
            (f"{FILTERED}/{name}", bytes(self._store.serialize_cdr(message, kind)))
            for name, kind, message in messages if message is not None
        ], filtered
