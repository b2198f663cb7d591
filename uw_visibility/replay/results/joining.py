# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Join of frames with the sensors' values around them, in the order of the recording."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.monitor import (
    RESTART_NANOSECONDS,
    WAITING_ESTIMATES,
    Comparison,
    DepthMonitor,
    Report,
)
from uw_visibility.plausibility.samples import DepthSample, interpolate
from uw_visibility.plausibility.verdict import Verdict
from uw_visibility.replay.inputs.positions import Position, PositionTrack, geographic
from uw_visibility.replay.inputs.stream import Restart, SensorValue
from uw_visibility.replay.table import FAILED, depth_sample, nanoseconds, number

# Numbers of a report that are sums over the whole recording.
COUNTS = ("compared", "failed", "inconclusive", "unmatched")


class Joiner:
    """Join of table rows with the depth sensor, its test and the position.

    A row waits until the sensors' values enclose its stamp, or are too far
    behind it. What comes out depends on the order of what goes in alone.

    Parameters
    ----------
    config : PlausibilityConfig
        The sensor's type is "none" where there is none.
    position : bool
        Whether positions will come.
    origin : tuple of float or None
        Latitude and longitude of the origin of positions in metres.

    Attributes
    ----------
    verdicts : Counter of str
        Frames by verdict of the plausibility test.
    """

    def __init__(
        self,
        config: PlausibilityConfig,
        position: bool = False,
        origin: tuple[float, float] | None = None,
    ) -> None:
        self._config = config
        self._monitor = DepthMonitor(config) if config.sensor_type != "none" else None
        self._samples: deque[DepthSample] = deque()
        self._track = PositionTrack() if position else None
        self._origin = origin
        self._waiting: deque[dict[str, str]] = deque()
        self._comparisons: dict[int, Comparison] = {}
        self._now = 0.0
        # Of the parts of the recording before its stamps jumped back.
        self._counts: Counter[str] = Counter()
        self.verdicts: Counter[str] = Counter()

    def add_frame(self, row: dict[str, str]) -> Iterator[dict[str, str]]:
        """Take a frame's row; yields the rows that are complete."""
        self._now = nanoseconds(row["time"]) / 1e9
        # As in the node, a frame without result says nothing of the ones around it.
        if self._monitor is not None and row["status"] != FAILED:
            self._note(self._monitor.add_estimate(*depth_sample(row), self._now))
        self._waiting.append(row)
        yield from self._complete(at_end=False)

    def add(self, event: SensorValue | Position | Restart) -> Iterator[dict[str, str]]:
        """Take whatever comes between frames; yields the rows that are complete."""
        if isinstance(event, SensorValue):
            yield from self.add_sensor(event)
        elif isinstance(event, Position):
            yield from self.add_position(event)
        else:
            self.restart()

    def add_sensor(self, value: SensorValue) -> Iterator[dict[str, str]]:
        """Take a value of the depth sensor; yields the rows that are complete."""
        if self._monitor is None:
            return
        self._now = value.time / 1e9
        self._note(self._monitor.add_sensor(value.sample, self._now))
        newest = self._samples[-1].stamp if self._samples else value.sample.stamp - 1
        if value.sample.stamp < newest - RESTART_NANOSECONDS:
            self._samples.clear()
        elif value.sample.stamp <= newest:
            return
        self._samples.append(value.sample)
        yield from self._complete(at_end=False)

    def add_position(self, position: Position) -> Iterator[dict[str, str]]:
        """Take a position; yields the rows that are complete."""
        if self._track is not None:
            self._track.add(position)
            yield from self._complete(at_end=False)

    def restart(self) -> None:
        """Reset the plausibility test: the stamps of the images jumped back."""
        if self._monitor is None:
            return
        report = self._monitor.report(self._now)
        self._counts.update({name: getattr(report, name) for name in COUNTS})
        self._monitor.reset()

    def finish(self) -> Iterator[dict[str, str]]:
        """Yield the rows that still wait: nothing more will come."""
        yield from self._complete(at_end=True)

    def report(self) -> Report | None:
        """Report of the plausibility test, if there is a sensor."""
        if self._monitor is None:
            return None
        report = self._monitor.report(self._now)
        return replace(
            report, **{name: getattr(report, name) + self._counts[name] for name in COUNTS}
        )

    def _note(self, comparisons: list[Comparison]) -> None:
        for comparison in comparisons:
            self._comparisons[comparison.estimate.stamp] = comparison
        while len(self._comparisons) > 2 * WAITING_ESTIMATES:
            del self._comparisons[next(iter(self._comparisons))]

    def _complete(self, at_end: bool) -> Iterator[dict[str, str]]:
        while self._waiting:
            stamp = nanoseconds(self._waiting[0]["stamp"])
            newest = nanoseconds(self._waiting[-1]["stamp"])
            overdue = len(self._waiting) >= WAITING_ESTIMATES or (
                newest - stamp > self._config.timeout * 1e9
            )
            if not (at_end or overdue or self._enclosed(stamp)):
                return
            row = self._waiting.popleft()
            self._join_sensor(row, stamp)
            self._join_position(row, stamp)
            yield row

    def _enclosed(self, stamp: int) -> bool:
        sensor = self._monitor is None or (
            bool(self._samples) and self._samples[-1].stamp >= stamp
        )
        return sensor and (self._track is None or self._track.reaches(stamp))

    def _join_sensor(self, row: dict[str, str], stamp: int) -> None:
        if self._monitor is None:
            return
        sample = interpolate(self._samples, stamp, self._config.timeout)
        while len(self._samples) > 1 and self._samples[1].stamp <= stamp:
            self._samples.popleft()
        if sample is not None:
            row["sensor_depth"] = number(sample.depth)
            row["sensor_depth_stddev"] = number(sample.variance**0.5)
        comparison = self._comparisons.pop(stamp, None)
        if comparison is not None:
            row["innovation"] = number(comparison.innovation)
            row["nis"] = number(comparison.nis)
        report = self._monitor.report(self._now)
        verdict, reason = report.verdict, report.reason
        if row["status"] == FAILED:
            verdict, reason = Verdict.NOT_ASSESSABLE, "the frame has no result"
        row["plausibility"] = str(verdict)
        row["plausibility_reason"] = "" if verdict is Verdict.OK else reason
        self.verdicts[row["plausibility"]] += 1

    def _join_position(self, row: dict[str, str], stamp: int) -> None:
        if self._track is None:
            return
        position = self._track.at(stamp)
        self._track.forget_before(stamp)
        if position is None:
            return
        longitude, latitude = position.x, position.y
        if not position.geographic:
            row["x"], row["y"] = number(position.x), number(position.y)
            if self._origin is None:
                return
            longitude, latitude = geographic(position.x, position.y, self._origin)
        row["longitude"], row["latitude"] = number(longitude), number(latitude)
