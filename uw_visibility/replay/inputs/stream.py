# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Stream of stereo frames and sensor values of a recording, in the order of time."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from uw_visibility.config.assumptions import like_video
from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.errors import InputError
from uw_visibility.messages.depth_sensor import read_depth
from uw_visibility.messages.frames import StereoFrame
from uw_visibility.messages.stamps import header_stamp
from uw_visibility.messages.synchronizer import SynchronizedFrame, Synchronizer
from uw_visibility.plausibility.comparison import DepthSample
from uw_visibility.replay.bags.reader import BagReader, Recorded
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.sensors import (
    Position,
    ScalarTopic,
    ScalarValue,
    check_join,
    read_position,
)
from uw_visibility.replay.inputs.topics import ODOMETRY, Selection, find_topics, is_raw
from uw_visibility.replay.records import count_reason
from uw_visibility.stereo.calibration import CameraCalibration, doubt


class RecordedFrame(NamedTuple):
    """Recorded stereo frame: images, and each CameraInfo, recorded or given."""

    number: int  # among all frames of the recording (from `start` on)
    time: int  # time at which the left image was received, ns
    parts: SynchronizedFrame  # the images are `Recorded`

    def messages(self, decode: Callable[[Recorded], Any]) -> StereoFrame:
        """Return images and CameraInfo as decoded messages."""
        _, _, *messages = self.parts
        return StereoFrame(*(
            decode(part) if isinstance(part, Recorded) else part for part in messages))


class SensorValue(NamedTuple):
    """A value of the depth sensor, and the time of its reception, ns."""

    sample: DepthSample
    time: int


@dataclass(frozen=True)
class Restart:
    """The stamps of the images jumped back: a clock was set, or a recording restarted."""


Event = RecordedFrame | SensorValue | Position | ScalarValue | Restart


class InputStream:
    """Stream of stereo frames and sensor values of a recording.

    plausibility: configuration with the type of the sensor that was found.
    problems: unusable messages, by reason.
    frames: number of frames so far, also of skipped ones.
    """

    def __init__(self, reader: BagReader, options: ReplayOptions) -> None:
        self._reader = reader
        self._options = options
        self.selection: Selection = find_topics(
            reader.channels, options.wanted, rectify=options.node.rectify,
            calibrated=options.infos is not None, sensor_type=options.sensor_type,
        )
        self._check_start()
        self._check_topics()
        self._joins: dict[str, list[ScalarTopic]] = {}
        for join in options.joins:
            self._joins.setdefault(join.topic, []).append(join)
        self.plausibility: PlausibilityConfig = replace(
            options.node.plausibility, sensor_type=self.selection.sensor_type
        )
        self.synchronizer = Synchronizer(options.node.synchronization)
        self.problems: Counter[str] = Counter()
        self.frames = 0
        self._checked: set[str] = set()

    @property
    def expected_frames(self) -> int | None:
        """Approximate number of frames to process; None if unknown from the indexes."""
        counts = [self._reader.channels[t].count for t in self.selection.images()]
        span = self._reader.span
        known = [count for count in counts if count is not None]
        if len(known) < len(counts) or span is None:
            return None
        frames, (start, stop) = min(known), self.interval()
        if start is not None and frames > 1:
            # Cameras are often turned on later than sensors.
            begin = self._first_image(span[0])
            end = span[1] if stop is None else min(stop, span[1])
            share = max(end - max(start, begin), 0) / max(span[1] - begin, 1)
            frames = round((frames - 1) * min(share, 1.0)) + (share > 0.0)
        return -(-frames // self._options.every)

    def events(self) -> Iterator[Event]:
        """Yield frames and sensor values as they become complete."""
        start, stop = self.interval()
        self._take_calibration(start)
        images, infos = self.selection.images(), self.selection.infos()
        topics = {*images, *infos}
        topics |= {t for t in (self.selection.depth, self.selection.position) if t is not None}
        topics |= set(self._joins)
        for message in self._reader.messages(topics, start, stop):
            if message.topic in images:
                yield from self._add(self.synchronizer.add_image, images[message.topic], message)
            elif message.topic in infos:
                self._check_rectified(message, infos[message.topic])
                yield from self._add(self.synchronizer.add_info, infos[message.topic], message)
            else:
                yield from self._sensor(message)
        yield from self._choose(self.synchronizer.finish())

    def sensor_samples(self) -> Iterator[DepthSample]:
        """Yield the usable values of the depth sensor, without reading images."""
        if self.selection.depth is None:
            return
        for message in self._reader.messages([self.selection.depth], *self.interval()):
            try:
                yield read_depth(
                    self._reader.deserialize(message), self.plausibility, message.time)
            except InputError:
                # Counted when the frames are processed.
                continue

    def missing(self) -> list[str]:
        """Return for each image topic how many indexed messages could not be read, as text."""
        if self._options.start > 0.0 or self._options.duration < np.inf:
            return []
        notes = []
        for topic, side in self.selection.images().items():
            expected, read = self._reader.channels[topic].count, self.synchronizer.received[side]
            if expected is not None and read < expected:
                notes.append(f"{expected - read} of {expected} messages on {topic} are missing")
        return notes

    def _check_start(self) -> None:
        """Refuse a start after the end of the recording."""
        span = self._reader.span
        if span is not None and self._options.start > (span[1] - span[0]) / 1e9:
            raise InputError(
                f"--start is {self._options.start:g}: {self._reader.path.name} ends after "
                f"{(span[1] - span[0]) / 1e9:.1f} s"
            )

    def _check_topics(self) -> None:
        """Refuse joined topics that are missing, and an Odometry without --origin."""
        channels, position = self._reader.channels, self.selection.position
        for join in self._options.joins:
            # Checked before hours of work.
            check_join(self._reader, join)
        if position is None or not self._options.geo or self._options.origin is not None:
            return
        if channels[position].type == ODOMETRY:
            raise InputError(
                f"{position} is an Odometry, in metres from its own origin: give the position of "
                "that with --origin LAT LON"
            )

    def interval(self) -> tuple[int | None, int | None]:
        """Return the interval of requested messages, ns."""
        options = self._options
        if options.start == 0.0 and options.duration == np.inf:
            return None, None
        span = self._reader.span
        begin = self._first_image(0) if span is None else span[0]
        start = begin + round(options.start * 1e9)
        stop = None if options.duration == np.inf else start + round(options.duration * 1e9)
        return start, stop

    def _first_image(self, otherwise: int) -> int:
        """Return the time of reception of the first image, ns."""
        first = next(self._reader.messages(self.selection.images()), None)
        return otherwise if first is None else first.time

    def like_video(self) -> bool:
        """Return whether the first left image is like video, see `assumptions.like_video`."""
        first = next(self._reader.messages([self.selection.left]), None)
        try:
            return first is not None and like_video(self._reader.deserialize(first))
        except InputError:
            return False

    def _take_calibration(self, start: int | None) -> None:
        """Add the given calibration, or the last one before the start."""
        if self._options.infos is not None:
            for side, info in zip(("left", "right"), self._options.infos, strict=True):
                self._check_rectified(info, side)
                self.synchronizer.add_info(side, 0, info)
            return
        infos = self.selection.infos()
        if start is None or not self._is_latched(infos):
            return
        for message in self._reader.messages(infos, None, start):
            list(self._add(self.synchronizer.add_info, infos[message.topic], message))

    def _check_rectified(self, info: Any, side: str) -> None:
        """Refuse images that are raw by their name and need rectification; tell of a `doubt`.

        `info` is a CameraInfo, given or recorded.
        """
        if side in self._checked:
            return
        self._checked.add(side)
        image = self.selection.left if side == "left" else self.selection.right
        try:
            if isinstance(info, Recorded):
                info = self._reader.deserialize(info)
            calibration = CameraCalibration.from_camera_info(info, side)
            if why := doubt(info, calibration, side):
                count_reason(self.problems, why)
        except InputError:
            # Frames report why their calibration cannot be used.
            return
        if not (self.selection.rectify or calibration.is_of_rectified) and is_raw(image):
            raise InputError(
                f"{image} is raw by its name, and by its calibration not rectified: add --rectify, "
                "or name rectified images with --left and --right"
            )

    def _is_latched(self, infos: dict[str, str]) -> bool:
        """Return whether CameraInfo is latched, with fewer messages than images."""
        for info, image in zip(infos, self.selection.images(), strict=True):
            counts = self._reader.channels[info].count, self._reader.channels[image].count
            if counts[0] is None or counts[1] is None or counts[0] < 0.9 * counts[1]:
                return True
        return False

    def _add(self, add: Any, side: str, message: Recorded) -> Iterator[RecordedFrame | Restart]:
        try:
            stamp = header_stamp(message.data, ros1=self._reader.ros1)
        except InputError as error:
            count_reason(self.problems, f"{message.topic}: {error}")
            return
        restarts = self.synchronizer.restarts
        frames = add(side, stamp, message)
        if self.synchronizer.restarts > restarts:
            yield Restart()
        yield from self._choose(frames)

    def _choose(self, frames: list[SynchronizedFrame]) -> Iterator[RecordedFrame]:
        for synchronized in frames:
            number = self.frames
            self.frames += 1
            if number % self._options.every == 0:
                yield RecordedFrame(number, synchronized.left.time, synchronized)

    def _sensor(self, message: Recorded) -> Iterator[Event]:
        try:
            content = self._reader.deserialize(message)
        except InputError as error:
            count_reason(self.problems, f"{message.topic}: {error}")
            return
        readers: list[Callable[[], Event | None]] = [
            functools.partial(join.read, content, message.time)
            for join in self._joins.get(message.topic, ())
        ]
        if message.topic == self.selection.position:
            readers.append(lambda: read_position(content))
        if message.topic == self.selection.depth:
            readers.append(lambda: SensorValue(
                read_depth(content, self.plausibility, message.time), message.time))
        for read in readers:
            try:
                event = read()
            except InputError as error:
                count_reason(self.problems, f"{message.topic}: {error}")
                continue
            if event is not None:
                yield event
