# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Envelopes of many frames taken together, and what their course over range and time says.

Frames are brought to one scale by their bright envelopes, which are about as bright as
the ambient light at any range (eq. 7), in each channel: exposure and light may change
from frame to frame. Then range bins are formed anew over all frames, with the darkest
patches of any frame in each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.water.observations import Envelopes
from uw_visibility.water.validation import LAMP_SLOPE

# Range bins over all frames; a bin needs so many observations.
BINS = 32
FEWEST_OBSERVATIONS = 4
# The envelopes of a bin are these quantiles of its observations: a single one may hold
# wrong ranges, or an animal.
DARK_QUANTILE = 0.05
BRIGHT_QUANTILE = 0.9
# A change between older and newer frames beyond so many standard deviations is the water's.
CHANGE_LIMIT = 5.0
# Farthest over nearest frame from which on it shows whether lamps light the ground.
LAMP_RATIO = 1.25


@dataclass(frozen=True)
class FrameEnvelopes:
    """Envelopes of a frame, and the level of its bright envelope.

    Attributes
    ----------
    envelope : Envelopes
    level : (3,) float64 ndarray
        Geometric mean of the bright envelope over range, in each channel.
    """

    envelope: Envelopes
    level: NDArray[np.float64]

    @classmethod
    def of(cls, envelope: Envelopes) -> FrameEnvelopes | None:
        """Take a frame; None where a channel shows nothing."""
        bright = envelope.bright
        if bright.shape[1] == 0 or not (bright > 0).any(axis=1).all():
            return None
        known = np.where(bright > 0, bright, np.nan)
        return cls(envelope, np.exp(np.nanmean(np.log(known), axis=1)))


def median_level(frames: Sequence[FrameEnvelopes]) -> NDArray[np.float64]:
    """Median over frames of the bright envelopes' levels, (3,); 1 without frames."""
    return np.asarray(np.median([f.level for f in frames], axis=0) if frames else np.ones(3))


def pool(frames: Sequence[FrameEnvelopes]) -> Envelopes:
    """Envelopes over all frames, at the median level of their bright envelopes."""
    level = median_level(frames)
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


def levels_fall_as_by_lamps(frames: Sequence[FrameEnvelopes]) -> bool:
    """Tell whether frames from farther away are darker, as lamps make them, in every channel."""
    distance = np.array([float(np.exp(np.log(f.envelope.range).mean())) for f in frames])
    x = np.log(distance) - np.log(distance).mean()
    if distance.max() < LAMP_RATIO * distance.min():
        return False
    levels = np.log([f.level for f in frames])
    slopes = x @ (levels - levels.mean(axis=0)) / max(float(x @ x), 1e-12)
    return bool((slopes < LAMP_SLOPE).all())


def mean_of_known(values: NDArray[np.float64]) -> float:
    """Mean of what is known; NaN without any."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def _relative_contrast(envelope: Envelopes) -> NDArray[np.float64]:
    """(u − e)/u of each channel and bin, (3, N); NaN where nothing is bright."""
    return 1.0 - envelope.dark / np.where(envelope.bright > 0, envelope.bright, np.nan)


def contrast_decay(frames: Sequence[FrameEnvelopes]) -> NDArray[np.float64]:
    """Decay of relative contrast (u − e)/u with range in each channel, (3,), 1/m.

    Light and dark patches differ by W Δρ e^(−βd), and the bright envelope u approaches the
    veil B: the ratio falls as βB/u, whatever exposure and scene are.
    """
    decay = np.full(3, np.nan)
    for c in range(3):
        distance, logarithm, weight = [], [], []
        for envelope in (frame.envelope for frame in frames):
            contrast = _relative_contrast(envelope)[c]
            known = contrast > 0
            distance.append(envelope.range[known])
            logarithm.append(np.log(contrast[known]))
            weight.append(np.full(known.sum(), 1.0 / max(known.sum(), 1)))
        d, y, w = (np.concatenate(each) for each in (distance, logarithm, weight))
        if len(d) >= FEWEST_OBSERVATIONS:
            centred = d - np.average(d, weights=w)
            decay[c] = -(w * centred) @ y / max((w * centred) @ centred, 1e-12)
    return decay


def attenuation_change(frames: Sequence[FrameEnvelopes], block: NDArray[np.intp]) -> float:
    """Change of attenuation from older blocks to newer ones, 1/m, where it is the largest.

    By how dark each frame's dark patches are: for black ones, 1 − e^(−βd).

    Parameters
    ----------
    frames : sequence of FrameEnvelopes
    block : (N,) int ndarray
        Block of each frame, rising from 0.

    Returns
    -------
    float
        0 where the differences among the blocks explain it.
    """
    levels = np.empty(len(frames))
    for i, envelope in enumerate(frame.envelope for frame in frames):
        contrast = _relative_contrast(envelope)
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
