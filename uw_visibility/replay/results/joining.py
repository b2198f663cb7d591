# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Join of frames with values of sensors, in the order of the recording."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.comparison import DepthSample, Verdict
from uw_visibility.plausibility.monitor import WAITING_ESTIMATES, Comparison, DepthMonitor
from uw_visibility.replay.inputs.sensors import (
    LONGEST_GAP,
    Position,
    ScalarTopic,
    ScalarValue,
    Track,
    geographic,
)
from uw_visibility.replay.inputs.stream import Restart, SensorValue
from uw_visibility.replay.records import FrameRecord, JoinedFrame
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.series.filter import FilteredWater

# Limit of memory: a frame without its observations takes about 15 kB.
MOST_WAITING = 10_000


class Joiner:
    """Join of frames with the depth sensor, its test, positions and numbers of other topics.

    A frame waits until values of each sensor enclose its stamp, or would be too far apart for
    interpolation. It is first tested with the depth sensor, so that its verdict does not depend on
    the other topics. The output depends only on the order of the input.

    config: its sensor type is "none" without a sensor.
    origin, joins, tolerance: see `ReplayOptions`.
    unplaced: number of frames without a position.
    """

    def __init__(
        self,
        config: PlausibilityConfig,
        position: bool = False,
        origin: tuple[float, float] | None = None,
        joins: Sequence[ScalarTopic] = (),
        tolerance: float = 2.0,
    ) -> None:
        self._monitor = DepthMonitor(config) if config.sensor_type != "none" else None
        self._depths: Track[DepthSample] = Track(config.timeout)
        self._positions: Track[Position] | None = Track(LONGEST_GAP) if position else None
        self._origin = origin
        self._scalars: dict[ScalarTopic, Track[ScalarValue]] = {
            join: Track(tolerance) for join in joins}
        self._tested: list[Track[Any]] = [self._depths] if self._monitor is not None else []
        self._joined: list[Track[Any]] = [
            *([self._positions] if self._positions is not None else []), *self._scalars.values()]
        # Frames that wait for the test, and then for the values of other topics.
        self._untested: deque[JoinedFrame] = deque()
        self._unjoined: deque[JoinedFrame] = deque()
        self._comparisons: dict[int, Comparison] = {}
        # Stamp of the last frame, ns.
        self._newest = 0
        self._now = 0.0
        self.unplaced = 0

    def add_frame(
        self, record: FrameRecord, filtered: FilteredWater | None = None
    ) -> Iterator[JoinedFrame]:
        """Add a frame; yields completed frames."""
        self._now, self._newest = record.time / 1e9, record.stamp
        # As in the node, frames without result do not affect others.
        if self._monitor is not None and record.estimate is not None:
            depth = record.estimate.depth(record.stamp)
            status = record.estimate.visibility.depth_status
            self._note(self._monitor.add_estimate(depth, status, self._now))
        self._untested.append(_without_observations(record, filtered))
        yield from self._complete()

    def add(
        self, event: SensorValue | Position | ScalarValue | Restart
    ) -> Iterator[JoinedFrame]:
        """Add a sensor value or a restart; yields completed frames."""
        if isinstance(event, Restart):
            # The stamps of the images jumped back, so later values may have the stamps of frames
            # before, and the test restarts.
            yield from self._complete(at_end=True)
            if self._monitor is not None:
                self._monitor.reset()
        elif isinstance(event, ScalarValue):
            self._scalars[event.source].add(event)
        elif isinstance(event, Position):
            if self._positions is not None:
                self._positions.add(event)
        elif self._monitor is not None:
            self._now = event.time / 1e9
            self._note(self._monitor.add_sensor(event.sample, self._now))
            self._depths.add(event.sample)
        yield from self._complete()

    def finish(self) -> Iterator[JoinedFrame]:
        """Yield the frames that still wait, at the end of the recording."""
        yield from self._complete(at_end=True)

    def _note(self, comparisons: list[Comparison]) -> None:
        for comparison in comparisons:
            self._comparisons[comparison.estimate.stamp] = comparison
        while len(self._comparisons) > 2 * WAITING_ESTIMATES:
            del self._comparisons[next(iter(self._comparisons))]

    def _complete(self, at_end: bool = False) -> Iterator[JoinedFrame]:
        for joined in self._released(self._untested, self._tested, at_end):
            self._join_sensor(joined)
            self._unjoined.append(joined)
        for joined in self._released(self._unjoined, self._joined, at_end):
            self._join_position(joined)
            found = (track.at(joined.record.stamp) for track in self._scalars.values())
            joined.scalars = tuple(math.nan if each is None else each.value for each in found)
            yield joined

    def _released(
        self, waiting: deque[JoinedFrame], tracks: Sequence[Track[Any]], at_end: bool
    ) -> Iterator[JoinedFrame]:
        """Remove and yield the frames that wait for nothing in the tracks any more."""
        while waiting:
            stamp = waiting[0].record.stamp
            settled = all(track.settles(stamp, self._newest) for track in tracks)
            if not (at_end or settled or len(waiting) >= MOST_WAITING):
                return
            yield waiting.popleft()
            if not at_end:
                # A wrong stamp may be later than those of the frames behind it.
                behind = (joined.record.stamp for joined in chain(waiting, self._untested))
                oldest = min([stamp, *behind])
                for track in tracks:
                    track.forget_before(oldest)

    def _join_sensor(self, joined: JoinedFrame) -> None:
        if self._monitor is None:
            return
        stamp = joined.record.stamp
        joined.sensor = self._depths.at(stamp)
        joined.comparison = self._comparisons.pop(stamp, None)
        report = self._monitor.report(self._now)
        verdict, reason = report.verdict, report.reason
        if joined.record.estimate is None:
            verdict, reason = Verdict.NOT_ASSESSABLE, "the frame has no result"
        joined.verdict = verdict
        joined.verdict_reason = "" if verdict is Verdict.OK else reason

    def _join_position(self, joined: JoinedFrame) -> None:
        if self._positions is None:
            return
        position = self._positions.at(joined.record.stamp)
        if position is None:
            self.unplaced += 1
        elif position.geographic:
            joined.longitude, joined.latitude = position.x, position.y
        else:
            joined.x, joined.y = position.x, position.y
            if self._origin is not None:
                joined.longitude, joined.latitude = geographic(joined.x, joined.y, self._origin)


def _without_observations(record: FrameRecord, filtered: FilteredWater | None) -> JoinedFrame:
    """Return a frame that waits, without what only a survey needs, which is most of its memory."""
    def reduced(water: WaterEstimate) -> WaterEstimate:
        return replace(water, blocks=None, lamps=None)

    if record.estimate is not None:
        estimate = replace(record.estimate, water=reduced(record.estimate.water))
        record = replace(record, estimate=estimate)
    if filtered is not None:
        survey = filtered.survey and replace(filtered.survey, water=reduced(filtered.survey.water))
        filtered = filtered._replace(water=reduced(filtered.water), survey=survey)
    return JoinedFrame(record, filtered)
