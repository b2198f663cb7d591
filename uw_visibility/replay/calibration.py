# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration of white reference and water type from recordings with a depth sensor."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility.optics.spectra import load_response
from uw_visibility.replay.bags.reader import BagReader
from uw_visibility.replay.inputs.options import ReplayOptions
from uw_visibility.replay.inputs.stream import InputStream, RecordedFrame
from uw_visibility.replay.progress import Progress
from uw_visibility.replay.records import JoinedFrame
from uw_visibility.replay.results.joining import Joiner
from uw_visibility.replay.work import FrameAnswer, FramePool, FrameTask, Recording, frame_pool
from uw_visibility.water.daylight.one_light import NOTHING_EXPECTED
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.calibration import Calibration, calibrate

# Least range of depths, m. Over smaller ones, water type and white reference cannot be separated:
# greener light may come from greener water or from a greener camera.
LEAST_DEPTH_SPREAD = 1.0


@dataclass
class CalibrationSeries:
    """Estimates from recordings, with the depths of a sensor."""

    estimates: list[WaterEstimate] = field(default_factory=list)  # one per frame with a result
    # sensed, assessed: depth of the sensor, and estimated with the given parameters, m; NaN if
    # unknown
    sensed: list[float] = field(default_factory=list)
    assessed: list[float] = field(default_factory=list)
    unusable: int = 0  # frames without a result
    damage: list[str] = field(default_factory=list)  # unreadable parts of the recordings

    def add(self, frames: Iterable[JoinedFrame]) -> None:
        for joined in frames:
            estimate = joined.record.estimate
            if estimate is None:
                self.unusable += 1
                continue
            self.estimates.append(estimate.water)
            self.sensed.append(math.nan if joined.sensor is None else joined.sensor.depth)
            self.assessed.append(estimate.visibility.depth)

    def errors(self) -> Array:
        """Return estimated minus sensed depths where both are known, m."""
        errors = np.array(self.assessed) - np.array(self.sensed)
        return np.asarray(errors[np.isfinite(errors)])


def calibrate_recordings(
    bags: Sequence[Path], options: ReplayOptions, *, jobs: int = 1
) -> tuple[Calibration, CalibrationSeries]:
    """Find the white reference and water type that fit a depth sensor; also return the data.

    The recordings are of one camera in one water. The result does not depend on `jobs`, the
    number of processes.
    """
    # The prior of the colour of light depends on white reference and water type, and would bias
    # the result to the given ones.
    water = replace(options.pipeline.water, daylight_tolerance=NOTHING_EXPECTED)
    options = replace(options, pipeline=replace(options.pipeline, water=water))
    _check_spread(_sensed_depths(bags, options))
    series = CalibrationSeries()
    with frame_pool(jobs, options.pipeline) as pool:
        for bag in bags:
            _add_recording(series, bag, options, pool)
    found = calibrate(
        series.estimates, series.sensed, load_response(options.pipeline.camera.response)
    )
    _check_spread(found.depth_range)
    return found, series


def _sensed_depths(bags: Sequence[Path], options: ReplayOptions) -> tuple[float, float]:
    """Return the smallest and the largest depth of the sensor, without processing frames."""
    low, high = math.inf, -math.inf
    for bag in bags:
        with BagReader(bag) as reader:
            for sample in _stream(bag, reader, options).sensor_samples():
                low, high = min(low, sample.depth), max(high, sample.depth)
    return low, high


def _check_spread(depths: tuple[float, float]) -> None:
    """Refuse depths with too small a spread; missing depths are reported later."""
    spread = depths[1] - depths[0]
    if 0.0 <= spread < LEAST_DEPTH_SPREAD:
        raise InputError(
            f"the depths differ by {spread:.2f} m only: calibrate over a dive whose depths differ "
            f"by {LEAST_DEPTH_SPREAD:g} m or more, otherwise white and water cannot be separated"
        )


def _stream(bag: Path, reader: BagReader, options: ReplayOptions) -> InputStream:
    stream = InputStream(reader, options)
    if stream.selection.depth is None:
        raise InputError(
            f"{bag} has no depth sensor: name its topic with --depth-sensor; --list of replay "
            "shows what there is"
        )
    return stream


def _add_recording(
    series: CalibrationSeries, bag: Path, options: ReplayOptions, pool: FramePool
) -> None:
    with BagReader(bag) as reader:
        stream = _stream(bag, reader, options)
        recording = Recording.of(reader, stream.selection, options, ())
        joiner = Joiner(stream.plausibility)
        tasks: Iterator[Any] = (
            FrameTask(recording, event) if isinstance(event, RecordedFrame) else event
            for event in stream.events()
        )
        with closing(Progress(bag.name, stream.expected_frames)) as progress:
            for item in pool.answers(tasks):
                if isinstance(item, FrameAnswer):
                    series.add(joiner.add_frame(item.record))
                    progress.add()
                else:
                    series.add(joiner.add(item))
            series.add(joiner.finish())
        series.damage += reader.damage
