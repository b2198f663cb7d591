# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Spatial consistency: dark envelopes of halves of the image at equal range.

Water and light that are the same all over give all parts of an image one dark
envelope. Where the halves on two sides, or the middle and the surroundings, differ by
more than dark patches do, no single attenuation describes the frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.optics.light_model import transmission
from uw_visibility.status import Status
from uw_visibility.water.surfaces import REGIONS, SurfaceStatistics

# What the bits of a region tell.
SPLITS = ("left and right", "top and bottom", "middle and surroundings")
# Pixels that half a bin needs; part of them below its dark envelope.
FEWEST = 40
FEWEST_BINS = 2
DARK = 0.03
# Darkest patches of halves differ by this part of the direct light.
DARKNESS = 0.08
# Neighbouring bins show the same objects.
NEIGHBOURING_BINS = 2.0
# Halves of one water differ by up to so many deviations; what is beyond makes an error
# of attenuation that is so many times as large, as range goes with position.
USUAL = 1.5
EFFECT = 1.7
# Differences beyond so many deviations and this part of attenuation refute the estimate, for
# each split; less is needed where surroundings are darker, as lenses and lamps make them.
SIGNIFICANT = np.array([4.0, 4.0, 5.0])
LARGE = np.array([0.15, 0.15, 0.25])
SIGNIFICANT_FALL, LARGE_FALL = 3.5, 0.12


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

    def stddev_of(self, attenuation: NDArray[np.float64]) -> float:
        """Standard deviation of attenuation by its unevenness, as a part of itself.

        Differences that scenes of one water show do not count.
        """
        beyond = np.abs(self.difference) - USUAL * self.stddev
        part = np.median(np.maximum(beyond, 0.0) / attenuation, axis=1)
        return EFFECT * float(part.max())

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
    range : (3, N) float64 ndarray
        Mean range of each bin, m, for each split; NaN where a half has too few pixels.
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
    places = statistics.places.sum(axis=1)
    mean = places[:, 0] / np.maximum(places[:, 1], 1.0)
    # Halves by splits by bins by channels by levels.
    halves = _halves(statistics.levels)
    about = _halves(statistics.places)
    enough = halves[:, :, :, 0].sum(axis=3).min(axis=0) >= FEWEST
    dark = np.moveaxis(_quantile(halves, statistics.edges), 3, 2)
    place = about[..., 2:] / np.maximum(about[..., 1:2], 1.0)
    return HalfEnvelopes(np.where(enough, mean, np.nan), dark, noise, place)


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
    for split, distance in enumerate(halves.range):
        both = np.isfinite(distance)
        if both.sum() < FEWEST_BINS:
            continue
        left = transmission(attenuation[:, np.newaxis], distance[both])
        # What a unit of attenuation changes, and what differs besides.
        by = veil[:, np.newaxis] * distance[both] * left
        other = np.hypot(DARKNESS * light[:, np.newaxis] * left, halves.noise[:, np.newaxis])
        weight = (by / other) ** 2
        shift = (halves.dark[0, split] - halves.dark[1, split])[:, both] / by
        total = weight.sum(axis=1)
        mean = (weight * shift).sum(axis=1) / total
        scatter = (weight * (shift - mean[:, np.newaxis]) ** 2).sum(axis=1) / (both.sum() - 1)
        difference[split] = mean
        stddev[split] = np.sqrt(NEIGHBOURING_BINS * np.maximum(scatter, 1.0) / total)
    return Unevenness(difference, stddev)


def _quantile(counts: NDArray[Any], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Dark quantile of histograms (..., LEVELS)."""
    running = counts.cumsum(axis=-1)
    rank = DARK * running[..., -1:]
    level = (running < rank).sum(axis=-1)
    here = np.take_along_axis(counts, level[..., np.newaxis], -1)[..., 0]
    upto = np.take_along_axis(running, level[..., np.newaxis], -1)[..., 0]
    inside = 1.0 - (upto - rank[..., 0]) / np.maximum(here, 1)
    return np.asarray(edges[level] + inside * (edges[level + 1] - edges[level]))
