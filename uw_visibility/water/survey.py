# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water of a survey: envelopes of many frames taken together.

Above a flat sea floor a frame's ranges are too alike to show how light decays with
range, but a vehicle climbs, sinks and pitches: over a minute the ranges differ enough.
The frames' envelopes are pooled and estimated from like those of one frame.

Frames that follow one another show the same ground, so their errors are alike. The
covariance comes from leaving out blocks of frames in turn (delete-a-group jackknife:
Künsch 1989, doi:10.1214/aos/1176347265), beside the estimate's own.

Two things else show whether the estimate holds. Relative contrast decays with range as
βB over the bright envelope, whatever exposure and scene are: over a floor without anything
dark, whose level would be taken for the veil's, it contradicts the estimate. And blocks
of frames differ where the water changes within the window.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import SurveyConfig
from uw_visibility.status import Status
from uw_visibility.water.assessment import joint_covariance
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.estimation import WaterEstimator
from uw_visibility.water.observations import Envelopes
from uw_visibility.water.pooling import (
    FrameEnvelopes,
    attenuation_change,
    contrast_decay,
    levels_fall_as_by_lamps,
    mean_of_known,
    median_level,
    pool,
)
from uw_visibility.water.window import FrameWindow

# Estimates are made at most once in so many seconds.
INTERVAL = 1.0
# Blocks of frames that are left out in turn, and those of them without which there may be
# no estimate.
BLOCKS = 8
MOST_DECISIVE = 2
# How much of the decay of relative contrast, 1/m, is the scene's: more ground is in view
# from farther away, and less of it is resolved.
SCENE_DECAY = 0.15
# Distance of the estimate from that decay, in standard deviations, from which on it widens
# the estimate's, and that refutes it.
WIDENING, CONTRADICTION = 1.0, 2.5


@dataclass(frozen=True)
class SurveyEstimate:
    """What frames show of the water together.

    Attributes
    ----------
    water : WaterEstimate
        Ambient light as the newest frame has it; its status says what is missing.
    frames : int
        Frames that it rests on.
    duration : float
        Time from the first to the last of them, s.
    range_min, range_max : float
        Nearest and farthest range among them, m; NaN without any.
    """

    water: WaterEstimate
    frames: int
    duration: float
    range_min: float
    range_max: float

    def __str__(self) -> str:
        return (
            f"{self.frames} frames in {self.duration:.0f} s, "
            f"ranges from {self.range_min:.2f} to {self.range_max:.2f} m"
        )


class Survey:
    """Takes the envelopes of frames together over a window of time.

    Parameters
    ----------
    config : SurveyConfig
    estimator : WaterEstimator
        Estimates from the envelopes over all frames.
    """

    def __init__(self, config: SurveyConfig, estimator: WaterEstimator) -> None:
        self._config = config
        self._estimator = estimator
        self._frames: FrameWindow[FrameEnvelopes] = FrameWindow(config)
        # Stamp of the newest frame, what was estimated, and its level of light.
        self._last: tuple[float, SurveyEstimate, NDArray[np.float64]] | None = None

    def reset(self) -> None:
        """Forget all frames."""
        self._frames.clear()
        self._last = None

    def add(self, envelope: Envelopes | None, stamp_seconds: float) -> None:
        """Take in a frame's envelopes.

        Parameters
        ----------
        envelope : Envelopes or None
            Without any bin, or None, the frame adds nothing.
        stamp_seconds : float
            Time of the frame, s. One not later than the last begins anew.
        """
        if not self._frames.continued_by(stamp_seconds):
            self.reset()
        self._frames.add(
            None if envelope is None else FrameEnvelopes.of(envelope), stamp_seconds)

    def estimate(self) -> SurveyEstimate:
        """Estimate the water over the frames of the window, once in `INTERVAL`."""
        newest = self._frames.newest
        if self._last is None or not newest - self._last[0] < INTERVAL:
            self._last = newest, *self._fresh()
        _, survey, level = self._last
        if not self._frames:
            return survey
        now = self._frames.items[-1].level
        return replace(survey, water=_at_level(survey.water, now / level))

    def _fresh(self) -> tuple[SurveyEstimate, NDArray[np.float64]]:
        """Estimate, with ambient light at the level of the frames' bright envelopes."""
        frames = self._frames.items
        if len(frames) < self._config.min_frames:
            water = WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
        else:
            water = self._water(frames)
        ranges = np.concatenate([f.envelope.range for f in frames] or [np.full(1, np.nan)])
        survey = SurveyEstimate(
            water, len(frames), self._frames.duration, float(ranges.min()), float(ranges.max()))
        return survey, median_level(frames)

    def _water(self, frames: Sequence[FrameEnvelopes]) -> WaterEstimate:
        if levels_fall_as_by_lamps(frames):
            return WaterEstimate.not_assessable(Status.LIT_BY_LAMPS)
        observed = pool(frames)
        whole = self._estimator.estimate_envelope(observed)
        if not np.isfinite(whole.attenuation).any():
            return whole
        block = np.arange(len(frames)) * BLOCKS // len(frames)
        subsets = [
            [f for f, b in zip(frames, block, strict=True) if b != left_out]
            for left_out in range(BLOCKS)
        ]
        parts = [self._estimator.estimate_envelope(pool(subset)) for subset in subsets]
        water = _with_spread(whole, parts)
        decays = np.array([contrast_decay(subset) for subset in subsets])
        bright = np.array([mean_of_known(channel) for channel in observed.bright])
        water = _compared(water, bright, contrast_decay(frames), _jackknife(decays))
        return _wider(water, attenuation_change(frames, block))


def _wider(water: WaterEstimate, deviation: float) -> WaterEstimate:
    """Add a deviation of attenuation that is common to the channels."""
    joint = joint_covariance(water).copy()
    joint[0::2, 0::2] += deviation**2
    return replace(water, covariance=_blocks(joint), joint_covariance=joint)


def _compared(
    water: WaterEstimate, bright: NDArray[np.float64], decay: NDArray[np.float64],
    covariance: NDArray[np.float64],
) -> WaterEstimate:
    """Compare with the decay of relative contrast: widen the covariance, or refuse."""
    seen = np.isfinite(water.attenuation) & np.isfinite(decay)
    if not seen.any():
        return water
    by_attenuation = (water.ambient_light / bright)[seen]
    by_light = (water.attenuation / bright)[seen]
    joint = joint_covariance(water)
    own = np.repeat(seen, 2)
    slopes = np.zeros((seen.sum(), own.sum()))
    at = np.arange(seen.sum())
    slopes[at, 2 * at], slopes[at, 2 * at + 1] = by_attenuation, by_light
    spread = slopes @ joint[np.ix_(own, own)] @ slopes.T + covariance[np.ix_(seen, seen)]
    # What the channels have in common: the scene's part is the same in them.
    variance = float(spread.mean()) + SCENE_DECAY**2
    gap = float(np.mean(water.attenuation[seen] * by_attenuation - decay[seen]))
    if gap**2 > CONTRADICTION**2 * variance:
        return WaterEstimate.not_assessable(Status.CUES_DISAGREE, water.envelope)
    excess = max(gap**2 - WIDENING**2 * variance, 0.0)
    return _wider(water, math.sqrt(excess) / float(by_attenuation.mean()))


def _jackknife(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance of values, given those without each of the blocks, (BLOCKS, ...)."""
    away = parts - parts.mean(axis=0)
    return np.asarray((BLOCKS - 1) / BLOCKS * away.T @ away)


def _with_spread(whole: WaterEstimate, parts: Sequence[WaterEstimate]) -> WaterEstimate:
    """Add the jackknife's covariance."""
    each = np.array([_values(part) for part in parts])
    # What a few blocks alone make assessable is not known. Those whose absence makes it
    # not assessable count as much as the others.
    known = np.isfinite(each)
    number = known.sum(axis=0)
    seen = np.isfinite(_values(whole)) & (number >= BLOCKS - MOST_DECISIVE)
    each = np.where(known, each, 0.0)
    away = np.where(known & seen, each - each.sum(axis=0) / np.maximum(number, 1), 0.0)
    joint = joint_covariance(whole) + _jackknife(away * np.sqrt(BLOCKS / np.maximum(number, 1)))
    joint[~seen, :] = np.nan
    joint[:, ~seen] = np.nan
    status = [
        reason if there or reason is not Status.OK else Status.RANGE_SPREAD_TOO_SMALL
        for reason, there in zip(whole.channel_status, seen[0::2], strict=True)
    ]
    return replace(
        whole,
        status=next((reason for reason in status if reason is not Status.OK), Status.OK),
        channel_status=(status[0], status[1], status[2]),
        attenuation=np.where(seen[0::2], whole.attenuation, np.nan),
        ambient_light=np.where(seen[0::2], whole.ambient_light, np.nan),
        covariance=_blocks(joint), joint_covariance=joint,
    )


def _at_level(water: WaterEstimate, gain: NDArray[np.float64]) -> WaterEstimate:
    """Bring light to the level of a frame."""
    scale = np.stack((np.ones(3), gain), axis=1).ravel()
    joint = joint_covariance(water) * np.outer(scale, scale)
    return replace(
        water, ambient_light=water.ambient_light * gain,
        covariance=_blocks(joint), joint_covariance=joint,
        light=None if water.light is None else water.light * gain,
        light_stddev=None if water.light_stddev is None else water.light_stddev * gain,
    )


def _values(estimate: WaterEstimate) -> NDArray[np.float64]:
    """β and I∞ of the channels, interleaved, (6,)."""
    return np.stack((estimate.attenuation, estimate.ambient_light), axis=1).ravel()


def _blocks(joint: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance of each channel alone, (3, 2, 2)."""
    return np.stack([joint[2 * c:2 * c + 2, 2 * c:2 * c + 2] for c in range(3)])
