# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Spatial consistency: dark envelopes of halves of the image at equal range.

Water and light that are the same all over give all parts of an image one dark
envelope. Where the halves on two sides, or the middle and the surroundings, differ by
more than dark patches do, no single attenuation describes the frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.status import Status
from uw_visibility.water.surfaces import REGIONS, SurfaceStatistics

# What the bits of a region tell.
SPLITS = ("left and right", "top and bottom", "middle and surroundings")
# Pixels that half a bin needs; part of them below its dark envelope.
FEWEST = 40
FEWEST_BINS = 2
DARK = 0.03
# Least transmission that a dark patch shows: what is as bright as the veil shows none.
LEAST_TRANSMISSION = 0.02
# Darkest patches of halves differ by this part of the direct light.
DARKNESS = 0.08
# Neighbouring bins show the same objects.
NEIGHBOURING_BINS = 2.0
# Images whose halves show different water beforehand, how far they are apart as a part of
# attenuation, what scenes of one water make them differ over its deviation, how far attenuation
# on average is from that of the clearest part, as a part of the difference, and how well that is
# known: a plume fills a half, but light falls, and layers thicken, all over the image.
UNLIKE = 0.2
APART = 0.7
SCATTER = np.array([1.0, 0.7, 0.9])
CHANGE = np.array([0.5, 1.0, 1.0])
EFFECT = 0.5
# Deviations from the median from which on a bin counts less (Cauchy's scale).
TAIL = 2.0
# How well the veil in front of a half is known, as a part of it.
VEIL_ERROR = 0.02
# Differences beyond so many deviations and this part of attenuation refute the estimate, for
# each split; less is needed where surroundings are darker, as lenses and lamps make them.
SIGNIFICANT = np.array([4.0, 4.0, 8.0])
LARGE = np.array([0.5, 0.5, 0.25])
SIGNIFICANT_FALL, LARGE_FALL = 3.0, 0.12


@dataclass(frozen=True)
class Unevenness:
    """Difference of the attenuations that two halves of an image show.

    Attributes
    ----------
    difference : (3, 3) float64 ndarray
        Attenuation of the first half less that of the second, 1/m: splits by channels.
    stddev : (3, 3) float64 ndarray
        Its standard deviation; infinite where the halves share no ranges.
    """

    difference: NDArray[np.float64]
    stddev: NDArray[np.float64]

    @property
    def significance(self) -> NDArray[np.float64]:
        """(3,): difference over its deviation for each split, the median channel's."""
        return np.asarray(np.median(self.difference / self.stddev, axis=1))

    def averaged(
        self, attenuation: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Attenuation of the water on average, and its standard deviation by unevenness.

        The lower envelope of an image is that of its clearest part. Where halves differ by
        more than scenes of one water make them, that on average is higher; where the middle
        is the brighter, a lens darkens the rest.

        Parameters
        ----------
        attenuation : (3,) float64 ndarray
            As estimated, 1/m.

        Returns
        -------
        attenuation, stddev : (3,) float64 ndarray
            1/m.
        """
        variance = (SCATTER[:, np.newaxis] * self.stddev) ** 2
        by = np.stack((np.ones(3), np.ones(3), attenuation))
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

    def refutes(self, attenuation: NDArray[np.float64]) -> Status:
        """OK, or the reason why one attenuation does not describe the frame."""
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
        Mean range of the pixels, m: halves by splits by bins; NaN where a half has too few.
    dark : (2, 3, 3, N) float64 ndarray
        Irradiance: halves by splits by channels.
    noise : (3,) float64 ndarray
        Its standard deviation by noise and rounding.
    place : (2, 3, N, 2) float64 ndarray
        Mean row and column of the pixels, in parts of the image: halves by splits by bins.
    """

    range: NDArray[np.float64]
    dark: NDArray[np.float64]
    noise: NDArray[np.float64]
    place: NDArray[np.float64]


def observe_halves(
    statistics: SurfaceStatistics, noise: NDArray[np.float64]
) -> HalfEnvelopes:
    """Take the dark envelopes of halves of an image.

    Parameters
    ----------
    statistics : SurfaceStatistics
    noise : (3,) float64 ndarray
        Standard deviation of the image's noise and rounding, as irradiance.
    """
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
    halves: HalfEnvelopes, attenuation: NDArray[np.float64], veil: NDArray[np.float64],
    light: NDArray[np.float64],
) -> Unevenness:
    """Compare the dark envelopes of halves of an image.

    Parameters
    ----------
    halves : HalfEnvelopes
    attenuation, veil, light : (3,) float64 ndarray
        β, B and W as estimated.
    """
    difference = np.zeros((len(SPLITS), 3))
    stddev = np.full((len(SPLITS), 3), np.inf)
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
            if count < FEWEST_BINS:
                continue
            shift, counts = apart[:count], weight[:count]
            # Ranges of a bin that are wrong in one half make it an outlier.
            most, middle = np.median(counts), np.median(shift)
            total = mean = scatter = 0.0
            for at in range(count):
                counts[at] = min(counts[at], most)
                counts[at] /= 1.0 + counts[at] * ((shift[at] - middle) / TAIL) ** 2
                total += counts[at]
                mean += counts[at] * shift[at]
            mean /= total
            for at in range(count):
                scatter += counts[at] * (shift[at] - mean) ** 2
            difference[split, c] = mean
            stddev[split, c] = math.sqrt(
                NEIGHBOURING_BINS * max(scatter / (count - 1), 1.0) / total)


@njit(nogil=True)
def attenuation_apart(
    first_range: float, second_range: float, first_dark: float, second_dark: float,
    veil: float, light: float, noise: float,
) -> tuple[float, float]:
    """Attenuation of a first half less that of the second, if black is as dark in both.

    Parameters
    ----------
    first_range, second_range : float
        m.
    first_dark, second_dark : float
        Irradiance of dark patches.
    veil, light, noise : float
        B, W, and the standard deviation of noise and rounding.

    Returns
    -------
    difference, weight : float
        1/m, and the inverse of its variance.
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


def _quantile(counts: NDArray[Any], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Dark quantile of histograms (..., LEVELS)."""
    running = counts.cumsum(axis=-1)
    rank = DARK * running[..., -1:]
    level = (running < rank).sum(axis=-1)
    here = np.take_along_axis(counts, level[..., np.newaxis], -1)[..., 0]
    upto = np.take_along_axis(running, level[..., np.newaxis], -1)[..., 0]
    inside = 1.0 - (upto - rank[..., 0]) / np.maximum(here, 1)
    return np.asarray(edges[level] + inside * (edges[level + 1] - edges[level]))
