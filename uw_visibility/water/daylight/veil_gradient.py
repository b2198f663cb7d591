# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Gradient of the veil over the image, as open water shows it.

The veil is light that the water scatters towards the camera, and there is more of it from
where the light comes from: looking ahead, it is brighter above than below. Far things are
seen above near ones, so that a single veil would leave attenuation too small.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array
from uw_visibility.images.pair import read_only
from uw_visibility.images.view import ColourSamples
from uw_visibility.optics.transfer import encode_table, linear_table
from uw_visibility.water.daylight.position import HalfEnvelopes
from uw_visibility.water.daylight.surfaces import SurfaceStatistics
from uw_visibility.water.observations import Envelopes

# Standard deviation of place in an area, in parts of the image, from which on it tells half
# of a gradient, if it has so many cells: what differs in it is not all gradient.
SHORT, FEW = 0.02, 40.0
# Bounds of the veil over that of open water.
LEAST, MOST = 0.5, 1.6
# A gradient that changes the veil of the dark patches by less than this part is none.
LEAST_CHANGE = 0.1
# How far a gradient may be off, as a part of it, where it is continued beyond open water.
UNCERTAIN = 0.3


class PlaceCourse(NamedTuple):
    """Mean range (N,), m, and place (N, 2) of the pixels of each bin; see `VeilGradient`."""

    range: Array
    place: Array


@dataclass(frozen=True)
class VeilGradient:
    """Linear change of the veil over the image.

    Attributes
    ----------
    slope : (3, 2) float64 ndarray
        Relative change per height and per width of the image, downwards and to the right.
    place : (2,) float64 ndarray
        Row and column where the veil is that of open water, as fractions of height and width.
    """

    slope: Array
    place: Array

    def at(self, place: Array) -> Array:
        """Veil over that of open water at places (..., 2): (3, ...)."""
        change = np.tensordot(self.slope, place - self.place, axes=(1, -1))
        return np.asarray(np.clip(1.0 + change, LEAST, MOST))


def fit_gradient(light: Array, place: Array, weights: Array) -> VeilGradient:
    """Fit the gradient of open water by weighted least squares.

    Takes irradiance (N, 3) at places (N, 2); the weights, of sum 1, give the place of the veil.
    """
    middle = weights @ place
    off = place - place.mean(axis=0)
    mean = light.mean(axis=0)
    # A channel that the water took has no gradient.
    relative = np.divide(light, mean, out=np.ones_like(light), where=mean > 0) - 1.0
    spread = (off.T @ off + FEW * SHORT**2 * np.eye(2)) / len(off)
    slope = np.linalg.solve(spread, off.T @ relative / len(off)).T
    return VeilGradient(slope, middle)


def place_course(statistics: SurfaceStatistics) -> PlaceCourse:
    """Mean place of the pixels of each bin of range that has some."""
    whole = statistics.places.sum(axis=1)
    seen = whole[whole[:, 1] > 0]
    count = seen[:, 1]
    return PlaceCourse(seen[:, 0] / count, seen[:, 2:] / count[:, np.newaxis])


def veil_along(gradient: VeilGradient, course: PlaceCourse) -> Array:
    """Veil over that of open water in front of each bin of range, (3, N)."""
    return gradient.at(course.place)


def matters(gradient: VeilGradient | None, course: PlaceCourse | None) -> bool:
    """Whether the gradient changes the veil along the range."""
    if gradient is None or course is None or len(course.range) < 2:
        return False
    return bool((np.ptp(veil_along(gradient, course), axis=1) > LEAST_CHANGE).any())


def level_samples(samples: ColourSamples, gradient: VeilGradient) -> ColourSamples:
    """Divide the veil's gradient out of the pixels; saturated pixels stay so."""
    pixels = samples.pixels
    height, width = pixels.shape[:2]
    # Of the first row and column, and how it changes from one to the next.
    first = 1.0 + gradient.slope @ (np.array((0.5 / height, 0.5 / width)) - gradient.place)
    level = np.empty_like(pixels)
    _level(
        pixels, linear_table(samples.transfer, pixels.dtype),
        encode_table(samples.transfer, pixels.dtype), first,
        np.ascontiguousarray(gradient.slope / (height, width)), level)
    return replace(samples, pixels=read_only(level))


@njit(nogil=True)
def _level(pixels: Any, irradiance: Any, code_of: Any, first: Any, slope: Any, level: Any) -> None:
    top, last = irradiance.size - 1, code_of.size - 1
    for y in range(pixels.shape[0]):
        for x in range(pixels.shape[1]):
            for c in range(3):
                code = pixels[y, x, c]
                veil = min(max(first[c] + slope[c, 0] * y + slope[c, 1] * x, LEAST), MOST)
                light = min(irradiance[code] / veil, 1.0)
                level[y, x, c] = (
                    code if code >= top else code_of[index_of(light * last + 0.5, 0, last)])


def level_envelope(observed: Envelopes, gradient: VeilGradient, course: PlaceCourse) -> Envelopes:
    """Envelopes of levelled pixels, with the contrast that they had before."""
    factor = np.stack([
        np.interp(observed.range, course.range, veil) for veil in veil_along(gradient, course)])
    return replace(
        observed,
        # Not the light of the scene: the veil alone is levelled.
        bright=observed.dark + factor * (observed.bright - observed.dark),
        deviation=observed.deviation / factor)


def level_halves(halves: HalfEnvelopes, gradient: VeilGradient) -> HalfEnvelopes:
    """Dark envelopes of halves with the gradient of the veil divided out."""
    # Channels by halves by splits by bins.
    factor = np.moveaxis(gradient.at(halves.place), 0, 2)
    return replace(halves, dark=halves.dark / np.where(np.isfinite(factor), factor, 1.0))
