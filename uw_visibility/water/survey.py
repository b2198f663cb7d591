# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water of a survey: envelopes of many frames taken together.

Above a flat sea floor a frame's ranges are too alike to show how light decays with
range, but a vehicle climbs, sinks and pitches: over a minute the ranges differ enough.
Frames are brought to one scale by their bright envelopes, which are about as bright as
the ambient light at any range (eq. 7), in each channel: exposure and light may change
from frame to frame. Then range bins are formed anew over all frames, with the darkest
patches of any frame in each.

Frames that follow one another show the same ground, so their errors are alike. The
covariance comes from leaving out blocks of frames in turn (delete-a-group jackknife:
Künsch 1989, doi:10.1214/aos/1176347265), beside the estimate's own.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import SurveyConfig
from uw_visibility.status import Status
from uw_visibility.water.assessment import joint_covariance
from uw_visibility.water.estimation import WaterEstimate, WaterEstimator
from uw_visibility.water.observations import Envelopes

# Estimates are made at most once in so many seconds.
INTERVAL = 1.0
# Blocks of frames that are left out in turn, and those of them without which there may be
# no estimate.
BLOCKS = 8
MOST_DECISIVE = 2
# Range bins over all frames; a bin needs so many observations.
BINS = 32
FEWEST_OBSERVATIONS = 4
# The envelopes of a bin are these quantiles of its observations: a single one may hold
# wrong ranges, or an animal.
DARK_QUANTILE = 0.05
BRIGHT_QUANTILE = 0.9


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
        self._frames: deque[tuple[float, _Frame]] = deque()
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
        if self._frames and stamp_seconds <= self._frames[-1][0]:
            self.reset()
        while self._frames and self._frames[0][0] < stamp_seconds - self._config.window:
            self._frames.popleft()
        frame = None if envelope is None else _Frame.of(envelope)
        if frame is not None:
            self._frames.append((stamp_seconds, frame))
        if len(self._frames) > self._config.max_frames:
            self._thin_out()

    def _thin_out(self) -> None:
        """Leave out the frame whose neighbours are closest to one another in time."""
        stamps = np.array([stamp for stamp, _ in self._frames])
        del self._frames[1 + int(np.argmin(stamps[2:] - stamps[:-2]))]

    def estimate(self) -> SurveyEstimate:
        """Estimate the water over the frames of the window, once in `INTERVAL`.

        Returns
        -------
        SurveyEstimate
        """
        newest = self._frames[-1][0] if self._frames else math.nan
        if self._last is None or not newest - self._last[0] < INTERVAL:
            self._last = newest, *self._fresh()
        _, survey, level = self._last
        if not self._frames:
            return survey
        return replace(survey, water=_at_level(survey.water, self._frames[-1][1].level / level))

    def _fresh(self) -> tuple[SurveyEstimate, NDArray[np.float64]]:
        """Estimate, with ambient light at the level of the frames' bright envelopes."""
        stamps = [stamp for stamp, _ in self._frames]
        frames = [frame for _, frame in self._frames]
        if len(frames) < self._config.min_frames:
            water = WaterEstimate.not_assessable(Status.TOO_FEW_OBSERVATIONS)
        else:
            water = self._water(frames)
        ranges = np.concatenate([f.envelope.range for f in frames] or [np.full(1, np.nan)])
        survey = SurveyEstimate(
            water, len(frames), stamps[-1] - stamps[0] if stamps else 0.0,
            float(ranges.min()), float(ranges.max()))
        return survey, _level(frames)

    def _water(self, frames: Sequence[_Frame]) -> WaterEstimate:
        whole = self._estimator.estimate_envelope(together(frames))
        if not np.isfinite(whole.attenuation).any():
            return whole
        block = np.arange(len(frames)) * BLOCKS // len(frames)
        return _with_spread(whole, [
            self._estimator.estimate_envelope(
                together([f for f, b in zip(frames, block, strict=True) if b != left_out]))
            for left_out in range(BLOCKS)
        ])


@dataclass(frozen=True)
class _Frame:
    """Envelopes of a frame, and the level of its bright envelope in each channel, (3,)."""

    envelope: Envelopes
    level: NDArray[np.float64]

    @classmethod
    def of(cls, envelope: Envelopes) -> _Frame | None:
        """Take a frame; None where a channel shows nothing."""
        bright = envelope.bright
        if bright.shape[1] == 0 or not (bright > 0).any(axis=1).all():
            return None
        known = np.where(bright > 0, bright, np.nan)
        return cls(envelope, np.exp(np.nanmean(np.log(known), axis=1)))


def _level(frames: Sequence[_Frame]) -> NDArray[np.float64]:
    return np.asarray(np.median([f.level for f in frames], axis=0) if frames else np.ones(3))


def together(frames: Sequence[_Frame]) -> Envelopes:
    """Envelopes over all frames, at the median level of their bright envelopes."""
    level = _level(frames)
    gains = [level / f.level for f in frames]
    envelopes = [f.envelope for f in frames]

    def all_of(name: str, scaled: bool) -> NDArray[np.float64]:
        return np.concatenate([
            getattr(e, name) * (g[:, np.newaxis] if scaled else 1.0)
            for e, g in zip(envelopes, gains, strict=True)], axis=-1)

    distance, count = all_of("range", False), all_of("count", False)
    dark, bright = all_of("dark", True), all_of("bright", True)
    dark_range = all_of("dark_range", False)
    step, deviation = all_of("step", True), all_of("deviation", True)
    low, high = distance.min(), distance.max() * (1 + 1e-9)
    place = np.log(distance / low) / max(math.log(high / low), 1e-9)
    bin_of = np.minimum((place * BINS).astype(int), BINS - 1)
    size = np.bincount(bin_of, minlength=BINS)
    full = np.flatnonzero(size >= FEWEST_OBSERVATIONS)
    out = np.full((5, 3, len(full)), np.nan)
    mean_range = np.empty(len(full))
    pixels = np.empty(len(full), np.int64)
    for i, b in enumerate(full):
        here = np.flatnonzero(bin_of == b)
        weight = count[here] / count[here].sum()
        mean_range[i] = weight @ distance[here]
        pixels[i] = count[here].sum()
        for c in range(3):
            known = here[np.isfinite(dark[c, here])]
            if len(known) < FEWEST_OBSERVATIONS:
                continue
            chosen = known[np.argsort(dark[c, known])[int(DARK_QUANTILE * len(known))]]
            out[:, c, i] = (
                dark[c, chosen], dark_range[c, chosen],
                np.quantile(bright[c, known], BRIGHT_QUANTILE), step[c, chosen],
                deviation[c, chosen],
            )
    total = max(sum(e.pixels for e in envelopes), 1)
    share = np.array([e.pixels for e in envelopes]) / total
    return replace(
        envelopes[-1],
        range=mean_range, count=pixels, dark=out[0], dark_range=out[1], bright=out[2],
        step=out[3], deviation=out[4], pixels=total,
        noise=np.asarray(share @ [e.noise for e in envelopes]),
        saturated=np.asarray(share @ [e.saturated for e in envelopes]),
        zero=np.asarray(share @ [e.zero for e in envelopes]),
        grey=all(e.grey for e in envelopes),
        limits=(float(low), float(high)),
        range_error=float(share @ [e.range_error for e in envelopes]),
    )


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
    away *= np.sqrt(BLOCKS / np.maximum(number, 1))
    joint = joint_covariance(whole) + (BLOCKS - 1) / BLOCKS * away.T @ away
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
