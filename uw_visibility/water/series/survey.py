# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water of a survey: blocks of many frames taken together.

Above a flat sea floor a frame's ranges are too alike to show how light decays with
range, but a vehicle climbs, sinks and pitches: over a minute the ranges differ enough.
The blocks of pixels of all frames are estimated like those of one frame.

Frames that follow one another show the same ground, so their errors are alike. The
covariance comes from leaving out blocks of frames in turn (delete-a-group jackknife:
Künsch 1989, doi:10.1214/aos/1176347265), beside the estimate's own.

Blocks of frames also differ where the water changes within the window.

Frames may differ in exposure, so each is scaled to a common level of light. But where veil and
surfaces differ in brightness, that level changes with range, which shows the decay. So a trend of
the level over range is left in. An exposure that follows the altitude hides it, and attenuation is
too low then. With one light for both (`water.veil: paper`) there is no trend.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import SurveyConfig
from uw_visibility.images.arrays import Array
from uw_visibility.status import Status
from uw_visibility.water.blocks import Blocks, stacked
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.estimate import WaterEstimate, blank, of_channels
from uw_visibility.water.observations import Envelopes

Item = TypeVar("Item")


class FrameWindow(Generic[Item]):
    """Items of the frames in a time window, thinned to a largest number."""

    def __init__(self, config: SurveyConfig) -> None:
        self._config = config
        self._frames: deque[tuple[float, Item]] = deque()

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def items(self) -> list[Item]:
        """Items kept, the oldest first."""
        return [item for _, item in self._frames]

    @property
    def newest(self) -> float:
        """Time of the newest frame, s; NaN without any."""
        return self._frames[-1][0] if self._frames else math.nan

    @property
    def duration(self) -> float:
        """Time from the oldest to the newest frame, s."""
        return self._frames[-1][0] - self._frames[0][0] if self._frames else 0.0

    def add(self, item: Item | None, stamp_seconds: float) -> None:
        """Add a frame later than all before; drop those that have left the window.

        Without an item, only the time passes.
        """
        while self._frames and self._frames[0][0] < stamp_seconds - self._config.window:
            self._frames.popleft()
        if item is not None:
            self._frames.append((stamp_seconds, item))
        if len(self._frames) > self._config.max_frames:
            self._thin_out()

    def _thin_out(self) -> None:
        """Drop the frame whose neighbours are closest to one another in time."""
        stamps = np.array([stamp for stamp, _ in self._frames])
        del self._frames[1 + int(np.argmin(stamps[2:] - stamps[:-2]))]


# Standard deviations beyond which a change between older and newer frames is the water's.
CHANGE_LIMIT = 5.0


@dataclass(frozen=True)
class FrameEnvelopes:
    """Envelopes of a frame, and the level of its bright envelope."""

    envelope: Envelopes
    level: Array  # (3,), geometric mean of the bright envelope over range, in each channel
    blocks: Blocks  # some rows of the frame's blocks of pixels

    @classmethod
    def of(cls, water: WaterEstimate) -> FrameEnvelopes | None:
        """Envelopes of an estimate; None without blocks, or where a channel has no light."""
        if water.envelope is None or water.blocks is None:
            return None
        bright = water.envelope.bright
        if bright.shape[1] == 0 or not (bright > 0).any(axis=1).all():
            return None
        known = np.where(bright > 0, bright, np.nan)
        return cls(water.envelope, np.exp(np.nanmean(np.log(known), axis=1)), water.blocks)


class Levels(NamedTuple):
    """Level of light over the mean range d of frames: ln level = middle + slope · (d − range)."""

    middle: Array  # (3,)
    slope: Array  # (3,), 1/m
    range: float  # m

    @classmethod
    def of(cls, frames: Sequence[FrameEnvelopes], trend: bool) -> Levels:
        """Least-squares line through the levels of frames; without `trend` their median."""
        levels = np.log([f.level for f in frames])
        ranges = np.array([f.envelope.range.mean() for f in frames])
        away = ranges - ranges.mean()
        if not trend or not away.any():
            return cls(np.median(levels, axis=0), np.zeros(3), 0.0)
        return cls(levels.mean(axis=0), away @ levels / (away @ away), float(ranges.mean()))

    def at(self, frame: FrameEnvelopes) -> Array:
        """Level at the range of a frame, (3,)."""
        away = float(frame.envelope.range.mean()) - self.range
        return np.exp(self.middle + self.slope * away)


def mean_of_known(values: Array) -> float:
    """Mean of the finite values; NaN without any."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def attenuation_change(frames: Sequence[FrameEnvelopes]) -> float:
    """Largest change of attenuation between older and newer blocks, 1/m; 0 if insignificant.

    Each frame's attenuation is that for which its dark patches are black (1 − e^(−βd)).
    """
    block = _blocks_of(frames)
    levels = np.empty(len(frames))
    for i, envelope in enumerate(frame.envelope for frame in frames):
        contrast = 1.0 - envelope.dark / np.where(envelope.bright > 0, envelope.bright, np.nan)
        black = -np.log(np.where(contrast > 0, contrast, np.nan)) / envelope.range
        levels[i] = mean_of_known(black)
    blocks = int(block.max()) + 1
    means = np.array([mean_of_known(levels[block == b]) for b in range(blocks)])
    found, largest = 0.0, CHANGE_LIMIT**2
    for at in range(2, blocks - 1):
        old, new = means[:at], means[at:]
        change = float(new.mean() - old.mean())
        squares = float(((old - old.mean()) ** 2).sum() + ((new - new.mean()) ** 2).sum())
        variance = squares / (blocks - 2) * (1.0 / at + 1.0 / (blocks - at))
        if change**2 > largest * variance:
            found, largest = change, change**2 / variance
    return found


# Estimates are made at most once in so many seconds.
INTERVAL = 1.0
# Blocks of frames that are left out in turn; how many of these may leave no estimate.
BLOCKS = 8
MOST_DECISIVE = 2


@dataclass(frozen=True)
class SurveyEstimate:
    """Estimate of the water from several frames."""

    # with the ambient light of the newest frame; its status says what is missing
    water: WaterEstimate
    frames: int  # number of frames used
    duration: float  # time from the first to the last of them, s
    range_min: float  # nearest range among them, m; NaN without any
    range_max: float  # farthest range among them, m; NaN without any

    @classmethod
    def of(
        cls, water: WaterEstimate, window: FrameWindow[Any], ranges: list[Array]
    ) -> SurveyEstimate:
        """Add the number of frames, duration and ranges of a window to an estimate."""
        joined = np.concatenate(ranges or [np.full(1, np.nan)])
        return cls(water, len(window), window.duration, float(joined.min()), float(joined.max()))

    def __str__(self) -> str:
        return (
            f"{self.frames} frames in {self.duration:.0f} s, "
            f"ranges from {self.range_min:.2f} to {self.range_max:.2f} m")


class Survey:
    """Estimator of the water from the blocks of all frames in a time window."""

    def __init__(self, config: SurveyConfig, estimator: WaterEstimator) -> None:
        self._config = config
        self._estimator = estimator
        self._frames: FrameWindow[FrameEnvelopes] = FrameWindow(self._config)
        # Stamp of the newest frame, what was estimated, and its levels of light.
        self._last: tuple[float, SurveyEstimate, Levels] | None = None

    def add(self, water: WaterEstimate, stamp_seconds: float) -> None:
        """Add a frame's blocks, if any; its stamp (s) is later than those before."""
        self._frames.add(FrameEnvelopes.of(water), stamp_seconds)

    def estimate(self) -> SurveyEstimate:
        """Estimate the water over the frames of the window, once in `INTERVAL`."""
        newest = self._frames.newest
        if self._last is None or not newest - self._last[0] < INTERVAL:
            self._last = newest, *self._fresh()
        _, survey, levels = self._last
        if not self._frames:
            return survey
        now = self._frames.items[-1]
        return replace(survey, water=_at_level(survey.water, now.level / levels.at(now)))

    def _fresh(self) -> tuple[SurveyEstimate, Levels]:
        """Estimate, and the levels of the bright envelopes."""
        frames = self._frames.items
        if len(frames) < self._config.min_frames:
            water = WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
        else:
            water = self._water(frames)
        survey = SurveyEstimate.of(water, self._frames, [f.envelope.range for f in frames])
        return survey, self._levels(frames) if frames else Levels(np.zeros(3), np.zeros(3), 0.0)

    def _levels(self, frames: Sequence[FrameEnvelopes]) -> Levels:
        return Levels.of(frames, not self._estimator.one_light)

    def _water(self, frames: Sequence[FrameEnvelopes]) -> WaterEstimate:
        whole = self._together(frames)
        if not np.isfinite(whole.attenuation).any():
            return whole
        block = _blocks_of(frames)
        parts = [
            self._together([frame for frame, b in zip(frames, block, strict=True) if b != left_out])
            for left_out in range(BLOCKS)]
        water = _with_spread(whole, parts)
        joint = water.covariance.copy()
        joint[0::2, 0::2] += attenuation_change(frames) ** 2
        return replace(water, covariance=joint)

    def _together(self, frames: Sequence[FrameEnvelopes]) -> WaterEstimate:
        """Estimate from frames as from one."""
        levels = self._levels(frames)
        alike = [f for f in frames if f.blocks.range.shape == frames[-1].blocks.range.shape]
        blocks = stacked([(f.blocks, levels.at(f) / f.level) for f in alike])
        range_error = float(np.mean([f.envelope.range_error for f in alike]))
        # The jackknife's covariance is added to that of the posterior.
        return replace(self._estimator.estimate_blocks(blocks, range_error), clearest=None)


def _blocks_of(frames: Sequence[FrameEnvelopes]) -> NDArray[np.intp]:
    """Block of each frame, numbered from 0."""
    return np.arange(len(frames)) * BLOCKS // len(frames)


def _with_spread(whole: WaterEstimate, parts: Sequence[WaterEstimate]) -> WaterEstimate:
    """Add the jackknife's covariance."""
    each = np.array([_values(part) for part in parts])
    # A channel that only a few blocks make assessable is unknown. Blocks whose absence makes it not
    # assessable count as much as the others.
    known = np.isfinite(each)
    number = known.sum(axis=0)
    seen = np.isfinite(_values(whole)) & (number >= BLOCKS - MOST_DECISIVE)
    each = np.where(known, each, 0.0)
    away = np.where(known & seen, each - each.sum(axis=0) / np.maximum(number, 1), 0.0)
    away = away * np.sqrt(BLOCKS / np.maximum(number, 1))
    away -= away.mean(axis=0)
    joint = whole.covariance + (BLOCKS - 1) / BLOCKS * away.T @ away
    status = [
        reason if there or reason is not Status.OK else Status.ATTENUATION_UNCERTAIN
        for reason, there in zip(whole.channel_status, seen[0::2], strict=True)]
    return replace(whole, **of_channels(
        status, np.where(seen[0::2], whole.attenuation, np.nan),
        np.where(seen[0::2], whole.ambient_light, np.nan), blank(joint, seen)))


def _at_level(water: WaterEstimate, gain: Array) -> WaterEstimate:
    """Scale light by the gain of each channel."""
    scale = np.stack((np.ones(3), gain), axis=1).ravel()
    return replace(
        water, ambient_light=water.ambient_light * gain,
        covariance=water.covariance * np.outer(scale, scale),
        light=None if water.light is None else water.light * gain)


def _values(estimate: WaterEstimate) -> Array:
    """β and I∞ of the channels, interleaved, (6,)."""
    return np.stack((estimate.attenuation, estimate.ambient_light), axis=1).ravel()
