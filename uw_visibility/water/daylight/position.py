# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Spatial consistency: dark envelopes of halves of the image at equal range.

In uniform water and light all parts of an image have one dark envelope. Where the left and right
half, upper and lower half, or middle and surroundings differ by more than dark patches do, no
single attenuation describes the frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.status import Status
from uw_visibility.water.daylight.surfaces import REGIONS, SurfaceStatistics
from uw_visibility.water.robust import cauchy_weight_by_precision

# Splits of the image, in the order of a region's bits.
SPLITS = ("left and right", "top and bottom", "middle and surroundings")
# Pixels that half a bin needs; fraction of them below its dark envelope.
FEWEST = 40
FEWEST_HALF_BINS = 2
DARK = 0.03
# Least transmission of a dark patch: one as bright as the veil shows none.
LEAST_TRANSMISSION = 0.02
# Difference of the darkest patches of halves, relative to the direct light.
DARKNESS = 0.08
# Neighbouring bins show the same objects.
HALF_BINS_ALIKE = 2.0
# Prior of halves with different water, and their difference relative to attenuation; scatter of
# scenes in one water over the deviation; for each split, average minus clearest attenuation over
# the difference, and its relative deviation: a plume fills a half, but light falls, and layers
# thicken, all over the image.
UNLIKE = 0.2
APART = 0.7
SCATTER = np.array([1.0, 0.7, 0.9])
CHANGE = np.array([0.5, 1.0, 1.0])
EFFECT = 0.5
# Cauchy's scale, in deviations.
TAIL = 2.0
# Relative error of the veil in front of a half.
VEIL_ERROR = 0.02
# Differences beyond so many deviations and this part of attenuation refute the estimate, for each
# split; less is needed where surroundings are darker, as by lenses and lamps.
SIGNIFICANT = np.array([4.0, 4.0, 8.0])
LARGE = np.array([0.5, 0.5, 0.25])
SIGNIFICANT_FALL, LARGE_FALL = 3.0, 0.12


@dataclass(frozen=True)
class Unevenness:
    """Difference of the attenuations of two halves of an image, for each split.

    Attributes
    ----------
    difference, stddev : (3, C) float64 ndarray
        First half minus second, 1/m: splits by channels. Infinite `stddev` if no range is shared.
    """

    difference: Array
    stddev: Array

    @property
    def significance(self) -> Array:
        """(3,): difference over its deviation for each split, the median channel's."""
        return np.asarray(np.median(self.difference / self.stddev, axis=1))

    def averaged(self, attenuation: Array) -> tuple[Array, Array]:
        """Average attenuation of the water and its standard deviation by unevenness, (C,) 1/m.

        The lower envelope of an image is that of its clearest part. Where halves differ by more
        than in scenes of one water, the average is higher; where the middle is brighter, a lens
        darkens the rest.
        """
        variance = (SCATTER[:, np.newaxis] * self.stddev) ** 2
        alike = np.ones_like(attenuation)
        by = np.stack((alike, alike, attenuation))
        spread = (APART * attenuation.mean() * by / by.mean(axis=1, keepdims=True)) ** 2
        kept = spread / (spread + variance)
        # Odds of halves that differ to one water, as the median channel has them.
        odds = np.median(
            np.log(np.sqrt(1.0 - kept)) + 0.5 * kept * self.difference**2 / variance, axis=1)
        share = UNLIKE / (UNLIKE + (1.0 - UNLIKE) * np.exp(-np.minimum(odds, 50.0)))
        size = np.median(np.abs(kept * self.difference) / by, axis=1)
        # No lens makes the surroundings brighter, but they may lack dark patches.
        change = CHANGE * (1.0, 1.0, np.median(self.difference[2]) > 0) * size
        split = int((share * change * by.mean(axis=1)).argmax())
        shift = share[split] * change[split] * by[split]
        error = math.sqrt(share[split] * (1.0 - share[split]) + share[split] * EFFECT**2)
        return attenuation + shift, error * change[split] * by[split]

    def refutes(self, attenuation: Array) -> Status:
        """OK, or why one attenuation does not describe the frame."""
        part = np.median(np.abs(self.difference) / attenuation, axis=1)
        uneven = (np.abs(self.significance) > SIGNIFICANT) & (part > LARGE)
        uneven[2] |= self.significance[2] > SIGNIFICANT_FALL and part[2] > LARGE_FALL
        if not uneven.any():
            return Status.OK
        ring = int(np.argmax(np.where(uneven, np.abs(self.significance), 0.0))) == 2
        return Status.UNEVEN_RADIUS if ring else Status.UNEVEN_SIDES


@dataclass(frozen=True)
class HalfEnvelopes:
    """Dark envelopes of halves of an image over range.

    Attributes
    ----------
    range : (2, 3, N) float64 ndarray
        Mean range of the pixels, m: halves by splits by bins; NaN for too few pixels.
    dark : (2, 3, 3, N) float64 ndarray
        Irradiance: halves by splits by channels by bins.
    noise : (3,) float64 ndarray
        Its standard deviation by noise and rounding.
    place : (2, 3, N, 2) float64 ndarray
        Mean row and column of the pixels, as fractions of the image: halves by splits by bins.
    """

    range: Array
    dark: Array
    noise: Array
    place: Array

    def of_channels(self, active: Mask) -> HalfEnvelopes:
        """The envelopes of the active channels."""
        return replace(self, dark=self.dark[:, :, active], noise=self.noise[active])


def observe_halves(statistics: SurfaceStatistics, noise: Array) -> HalfEnvelopes:
    """Take the dark envelopes of halves; `noise` is that of irradiance, (3,)."""
    # Halves by splits by bins by channels by levels.
    halves = _halves(statistics.levels)
    about = _halves(statistics.places)
    enough = halves[:, :, :, 0].sum(axis=3).min(axis=0) >= FEWEST
    dark = np.moveaxis(_quantile(halves, statistics.edges), 3, 2)
    mean = about[..., (0, 2, 3)] / np.maximum(about[..., 1:2], 1.0)
    return HalfEnvelopes(np.where(enough, mean[..., 0], np.nan), dark, noise, mean[..., 1:])


def _halves(of_regions: NDArray[Any]) -> NDArray[Any]:
    """Sum over the regions of each half: (N, 8, ...) to halves by splits by (N, ...)."""
    whole = of_regions.sum(axis=1)
    second = np.stack([
        of_regions[:, (np.arange(REGIONS) >> split) & 1 == 1].sum(axis=1)
        for split in range(len(SPLITS))])
    return np.stack((whole - second, second))


def compare_halves(
    halves: HalfEnvelopes, attenuation: Array, veil: Array, light: Array
) -> Unevenness:
    """Compare the dark envelopes of halves, given β, B and W of their channels, (C,)."""
    difference = np.zeros((len(SPLITS), len(veil)))
    stddev = np.full((len(SPLITS), len(veil)), np.inf)
    # Of one layout, or the kernel would be compiled once more, in flight.
    _compare(
        *map(np.ascontiguousarray, (halves.range, halves.dark, halves.noise, veil, light)),
        difference, stddev)
    return Unevenness(difference, stddev)


@njit(nogil=True)
def _compare(
    ranges: Any, dark: Any, noise: Any, veil: Any, light: Any, difference: Any, stddev: Any,
) -> None:
    bins = ranges.shape[2]
    apart, weight = np.empty(bins), np.empty(bins)
    for split in range(ranges.shape[1]):
        for c in range(len(veil)):
            count = 0
            for at in range(bins):
                near, far = ranges[0, split, at], ranges[1, split, at]
                if np.isfinite(near) and np.isfinite(far):
                    apart[count], weight[count] = attenuation_apart(
                        near, far, dark[0, split, c, at], dark[1, split, c, at], veil[c],
                        light[c], noise[c])
                    count += 1
            if count < FEWEST_HALF_BINS:
                continue
            shift, counts = apart[:count], weight[:count]
            # Ranges of a bin that are wrong in one half make it an outlier.
            most, middle = np.median(counts), np.median(shift)
            total = mean = scatter = 0.0
            for at in range(count):
                counts[at] = cauchy_weight_by_precision(
                    shift[at] - middle, min(counts[at], most), TAIL)
                total += counts[at]
                mean += counts[at] * shift[at]
            mean /= total
            for at in range(count):
                scatter += counts[at] * (shift[at] - mean) ** 2
            difference[split, c] = mean
            stddev[split, c] = math.sqrt(HALF_BINS_ALIKE * max(scatter / (count - 1), 1.0) / total)


@njit(nogil=True)
def attenuation_apart(
    first_range: float, second_range: float, first_dark: float, second_dark: float,
    veil: float, light: float, noise: float,
) -> tuple[float, float]:
    """Attenuation of the first half minus that of the second, if black is as dark in both.

    Takes the ranges, m, and the irradiance of dark patches; returns the difference, 1/m, and the
    inverse of its variance.
    """
    # Transmission that each half shows: what differs much does so by more than in proportion.
    first = max(1.0 - first_dark / veil, LEAST_TRANSMISSION)
    second = max(1.0 - second_dark / veil, LEAST_TRANSMISSION)
    difference = math.log(second) / second_range - math.log(first) / first_range
    # What a unit of attenuation changes (logarithmic mean), and what differs besides.
    ratio = math.log(second / first)
    mean = first if abs(ratio) < 1e-6 else (second - first) / ratio
    by = mean * 0.5 * (first_range + second_range) * veil
    darkness = 0.5 * (DARKNESS * light) ** 2 * (first**2 + second**2)
    return difference, by**2 / (darkness + noise**2 + (VEIL_ERROR * veil) ** 2)


def _quantile(counts: NDArray[Any], edges: Array) -> Array:
    """Dark quantile of histograms (..., LEVELS)."""
    running = counts.cumsum(axis=-1)
    rank = DARK * running[..., -1:]
    level = (running < rank).sum(axis=-1)
    here = np.take_along_axis(counts, level[..., np.newaxis], -1)[..., 0]
    upto = np.take_along_axis(running, level[..., np.newaxis], -1)[..., 0]
    inside = 1.0 - (upto - rank[..., 0]) / np.maximum(here, 1)
    return np.asarray(edges[level] + inside * (edges[level + 1] - edges[level]))
