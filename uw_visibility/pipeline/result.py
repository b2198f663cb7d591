# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Results of one stereo pair, filled ranges, and the durations of the stages."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap, Image, Mask, PerChannel, RangeMap
from uw_visibility.status import Status
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.stereo.views import in_right_view
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Visibility

# Placeholders for an image that is not wanted, and for its mask of limited gain.
NOT_WANTED: Image = np.empty((0, 0), np.uint8)
NOT_LIMITED: Mask = np.empty((0, 0), np.bool_)


@dataclass(frozen=True, eq=False)
class StereoResult:
    """Disparity and range of the left image.

    Attributes
    ----------
    disparity : ndarray
        ``(H, W)`` float32, left-referenced, px; NaN where unmatched.
    filled : ndarray
        ``(H, W)`` float32, px, for colour only; gaps filled, and in noise doubtful matches
        replaced. Finite everywhere if any pixel matched; NaN everywhere if none did, or if no
        enhanced image was wanted.
    range : ndarray
        ``(H, W)`` float32, m, of `disparity`, along the line of sight; NaN where unmatched.
    filled_range : ndarray
        ``(H, W)`` float32, m, of `filled`, for colour only: ranges in gaps are not
        measured. Infinite where the filled disparity lies at or beyond infinity.
    confidence : ndarray or None
        ``(H, W)`` float32, probability that `disparity` is within 1 px of the truth;
        0 where unmatched; None if not wanted.
    original : ndarray or None
        ``(H, W)`` float32, px; disparity of the raw pair; None if not wanted.
    support_points : int
        Support points of step 1.
    coverage : float
        Part of the left image that their mesh covers.
    min_disparity, max_disparity : int
        Limits of the search, inclusive, px.
    right_gain : ndarray
        ``(3,)``, or ``(1,)`` for grey images: irradiance in the right image over that in
        the left one. The right image's ambient light is that of the water times this.
    """

    disparity: DisparityMap
    filled: DisparityMap
    range: RangeMap
    filled_range: RangeMap
    confidence: DisparityMap | None
    original: DisparityMap | None
    support_points: int
    coverage: float
    min_disparity: int
    max_disparity: int
    right_gain: PerChannel

    @property
    def matched_fraction(self) -> float:
        """Matched part of `disparity`."""
        return _matched_fraction(self.disparity)

    @property
    def matched_fraction_original(self) -> float | None:
        """Matched part of `original`, if there is one."""
        return None if self.original is None else _matched_fraction(self.original)


@dataclass(frozen=True, eq=False)
class EnhancedImages:
    """The restored pair.

    Attributes
    ----------
    left, right : ndarray
        Like the input images; empty where not wanted.
    limited : ndarray
        ``(H, W)`` bool; pixels of the left image whose gain was limited; empty where
        that image was not wanted.
    scene_light : ndarray or None
        ``(C,)`` float64, the light W that is white in the left image; None if no image
        was wanted.
    balanced : float
        Weight of the camera's own white, from neutral bright patches, in that white, 0 to
        1; the rest is from the estimate.
    """

    left: Image
    right: Image
    limited: Mask
    scene_light: PerChannel | None = None
    balanced: float = 0.0


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Results of one stereo pair: water, visibility, stereo, images, timing.

    Arrays are not written to after construction. A quantity that could not be
    assessed is NaN, and the status beside it says why.

    Attributes
    ----------
    water : WaterEstimate
        Attenuation and ambient light after the second step.
    coarse_water : WaterEstimate
        The same after the first step.
    visibility : Visibility
        Mean attenuation, visibility distance and depth with standard deviations.
    clear_water_attenuation : ndarray
        ``(3,)`` float64, 1/m, RGB.
    stereo : StereoResult
        Disparity and range.
    images : EnhancedImages
        The restored pair.
    timing_ms : dict of str to float
        Duration of each stage and of the whole (``total``); two stages may overlap.
    """

    water: WaterEstimate
    coarse_water: WaterEstimate
    visibility: Visibility
    clear_water_attenuation: PerChannel
    stereo: StereoResult
    images: EnhancedImages
    timing_ms: dict[str, float]

    @property
    def status(self) -> Status:
        """Whether the water could be assessed (that of `water`)."""
        return self.water.status

    @property
    def disparity(self) -> DisparityMap:
        """``(H, W)`` float32, left-referenced, px; NaN where unmatched."""
        return self.stereo.disparity

    @property
    def range(self) -> RangeMap:
        """``(H, W)`` float32, m, measured along the line of sight; NaN where unmatched."""
        return self.stereo.range

    @property
    def left_enhanced(self) -> Image:
        """The left image restored; empty where not wanted."""
        return self.images.left

    @property
    def right_enhanced(self) -> Image:
        """The right image restored; empty where not wanted."""
        return self.images.right


def _matched_fraction(disparity: DisparityMap) -> float:
    return float(np.count_nonzero(np.isfinite(disparity)) / disparity.size)


class FilledRanges(NamedTuple):
    """Ranges of one view, with gaps filled.

    `range_map` is (H, W) float32, m; infinite where the filled disparity lies at or beyond
    infinity. `matched` is true where the range was measured.
    """

    range_map: RangeMap
    matched: Mask


class FilledStereo(NamedTuple):
    """Disparity of the left view with gaps filled, px, and ranges.

    `measured` are ranges of the left view, m; NaN where unmatched.
    """

    disparity: DisparityMap
    measured: RangeMap
    left: FilledRanges
    right: FilledRanges | None

    @classmethod
    def of(
        cls, rig: StereoRig, disparity: DisparityMap, filled: DisparityMap, right: bool,
        workers: Workers,
    ) -> FilledStereo:
        """Find the ranges of the left view, and of the right one if wanted.

        `disparity` of the left view is NaN where unmatched, `filled` that for colour, without gaps.
        """
        left = FilledRanges(rig.range_of_filled(filled), np.isfinite(disparity))
        of_right = None
        if right:
            seen = in_right_view(filled, workers)
            matched = seen == in_right_view(disparity, workers)
            of_right = FilledRanges(rig.range_of_filled(seen), matched)
        return cls(filled, rig.range_from_disparity(disparity), left, of_right)


class StageClock:
    """Durations of the stages of one frame; ``with clock(stage)`` measures one."""

    def __init__(self) -> None:
        self._begin = time.perf_counter()
        self._stages: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self._stages[stage] = 1e3 * (time.perf_counter() - begin)

    def milliseconds(self) -> dict[str, float]:
        """Return the stages and ``total``."""
        return {**self._stages, "total": 1e3 * (time.perf_counter() - self._begin)}
