# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Typed records that the stages of a replay hand on, from a frame's result to its row."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from uw_visibility.messages.estimates import ImageHeader, field_of_view
from uw_visibility.pipeline.result import FrameResult
from uw_visibility.plausibility.comparison import Comparison, DepthSample, Verdict
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility
from uw_visibility.water.meaning.derived import DerivedQuantities
from uw_visibility.water.series.filter import FilteredWater

# Reasons may carry numbers of the input, and a recording may be long.
MOST_REASONS = 50
FURTHER = "further reasons"


@dataclass(frozen=True)
class FrameEstimate:
    """A frame's result without its images."""

    # water, visibility: of the frame alone
    water: WaterEstimate
    visibility: Visibility
    rig: StereoRig  # the filter begins anew with another one
    # field_of_view, header: of the left image; rad
    field_of_view: float
    header: ImageHeader
    support_points: int
    coverage: float
    matched_fraction: float
    limited_fraction: float
    matched_fraction_original: float | None = None
    timing_ms: dict[str, float] = field(default_factory=dict)  # durations of the stages, ms

    @classmethod
    def of(cls, result: FrameResult, rig: StereoRig, header: ImageHeader) -> FrameEstimate:
        """Keep what a result has besides its images."""
        stereo, limited = result.stereo, result.images.limited
        return cls(
            result.water, result.visibility, rig,
            field_of_view(stereo.disparity.shape[1], rig.focal_length), header,
            int(stereo.support_points), float(stereo.coverage), stereo.matched_fraction,
            float(limited.mean()) if limited.size else 0.0, stereo.matched_fraction_original,
            result.timing_ms,
        )

    @property
    def ranges(self) -> tuple[float, float]:
        """Nearest and farthest range that the water rests on, m; NaN without any."""
        envelope = self.water.envelope
        if envelope is None or not envelope.limits[1] > 0.0:
            return math.nan, math.nan
        return envelope.limits

    def depth(self, stamp: int) -> DepthSample:
        """Return the estimated depth at a stamp, ns, to be compared with a sensor's."""
        seen = self.visibility
        return DepthSample.estimated(
            stamp, seen.depth, seen.depth_stddev, seen.depth_precision)


@dataclass(frozen=True)
class FrameRecord:
    """Result of one frame: an estimate, or the reason why there is none."""

    frame: int  # its number among the recording's
    # stamp, right_stamp: of its images, ns
    stamp: int
    right_stamp: int
    time: int  # when the left image was received, ns
    reason: str = ""
    estimate: FrameEstimate | None = None


@dataclass
class JoinedFrame:
    """A frame with filtered estimate and sensor values: a row of the table."""

    record: FrameRecord
    filtered: FilteredWater | None = None
    sensor: DepthSample | None = None  # the depth sensor's value at the frame's stamp
    # of the estimate with the sensor; None where they were not compared
    comparison: Comparison | None = None
    # verdict, verdict_reason: of the sensor's plausibility, and why that is not ok; None without a
    # sensor
    verdict: Verdict | None = None
    verdict_reason: str = ""
    # longitude, latitude, x, y: degrees, and a position in metres; NaN where they are not known
    longitude: float = math.nan
    latitude: float = math.nan
    x: float = math.nan
    y: float = math.nan
    scalars: tuple[float, ...] = ()  # values of the joined topics; NaN where they are not known
    # derived, filtered_derived: of the frame's water and of the filtered one, once the row is
    # written
    derived: DerivedQuantities | None = None
    filtered_derived: DerivedQuantities | None = None


def count_reason(counter: Counter[str], reason: str) -> None:
    """Count a reason; beyond `MOST_REASONS` different ones, all others are one."""
    if reason not in counter and len(counter) >= MOST_REASONS:
        reason = FURTHER
    counter[reason] += 1
