# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Gradient of the veil over the image, as open water shows it.

The veil is light that the water scatters towards the camera, and there is more of it from
where the light comes from: looking ahead, it is brighter above than below. Far things are
seen above near ones, so that a single veil would leave attenuation too small.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.water.observations import Envelopes
from uw_visibility.water.position import HalfEnvelopes
from uw_visibility.water.surfaces import SurfaceStatistics

# Standard deviation of place in an area, in parts of the image, from which on it tells half
# of a gradient.
SHORT = 0.02
# Bounds of the veil over that of open water.
LEAST, MOST = 0.5, 1.6
# A gradient that changes the veil of the dark patches by less than this part is none.
NEGLIGIBLE = 0.1
# How far a gradient may be off, as a part of it, where it is continued beyond open water.
UNCERTAIN = 0.3


class PlaceCourse(NamedTuple):
    """Mean place in the image of the pixels of each bin of range.

    Attributes
    ----------
    range : (N,) float64 ndarray
        m, rising.
    place : (N, 2) float64 ndarray
        Row and column, in parts of the image's height and width.
    """

    range: NDArray[np.float64]
    place: NDArray[np.float64]


@dataclass(frozen=True)
class VeilGradient:
    """Veil over the image: so many times that at one place.

    Attributes
    ----------
    slope : (3, 2) float64 ndarray
        Relative change per height and per width of the image, downwards and to the right.
    place : (2,) float64 ndarray
        Row and column where the veil is that of open water, in parts of the image.
    """

    slope: NDArray[np.float64]
    place: NDArray[np.float64]

    def at(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Veil over that of open water at places (..., 2): (3, ...)."""
        change = np.tensordot(self.slope, place - self.place, axes=(1, -1))
        return np.asarray(np.clip(1.0 + change, LEAST, MOST))


def fit_gradient(
    light: NDArray[np.float64], place: NDArray[np.float64], weights: NDArray[np.float64]
) -> VeilGradient:
    """Fit the gradient of open water by weighted least squares.

    Parameters
    ----------
    light : (N, 3) float64 ndarray
        Irradiance.
    place : (N, 2) float64 ndarray
        Row and column, in parts of the image.
    weights : (N,) float64 ndarray
        Of the place where the veil is wanted; their sum is 1.

    Returns
    -------
    VeilGradient
    """
    middle = weights @ place
    off = place - place.mean(axis=0)
    relative = light / light.mean(axis=0) - 1.0
    # As if nothing were known of less than a short area.
    spread = off.T @ off / len(off) + SHORT**2 * np.eye(2)
    slope = np.linalg.solve(spread, off.T @ relative / len(off)).T
    return VeilGradient(slope, middle)


def place_course(statistics: SurfaceStatistics) -> PlaceCourse:
    """Mean place of the pixels of each bin of range that has some."""
    whole = statistics.places.sum(axis=1)
    seen = whole[whole[:, 1] > 0]
    count = seen[:, 1]
    return PlaceCourse(seen[:, 0] / count, seen[:, 2:] / count[:, np.newaxis])


def veil_along(gradient: VeilGradient, course: PlaceCourse) -> NDArray[np.float64]:
    """Veil over that of open water in front of each bin of range, (3, N)."""
    return gradient.at(course.place)


def matters(gradient: VeilGradient | None, course: PlaceCourse | None) -> bool:
    """Tell whether the veil differs along the range."""
    if gradient is None or course is None or len(course.range) < 2:
        return False
    return bool((np.ptp(veil_along(gradient, course), axis=1) > NEGLIGIBLE).any())


def level_envelope(
    envelope: Envelopes, gradient: VeilGradient, course: PlaceCourse
) -> Envelopes:
    """Return envelopes as they were with the veil of open water all over the image."""
    along = veil_along(gradient, course)
    factor = np.stack([
        np.interp(d, course.range, veil)
        for d, veil in zip(envelope.dark_range, along, strict=True)])
    dark = envelope.dark / factor
    return replace(
        envelope,
        dark=dark,
        # What the veil adds to dark patches it adds to bright ones.
        bright=envelope.bright + dark - envelope.dark,
        deviation=envelope.deviation / factor,
    )


def level_halves(halves: HalfEnvelopes, gradient: VeilGradient) -> HalfEnvelopes:
    """Return dark envelopes of halves as they were with one veil all over the image."""
    # Channels by halves by splits by bins.
    factor = np.moveaxis(gradient.at(halves.place), 0, 2)
    return replace(halves, dark=halves.dark / np.where(np.isfinite(factor), factor, 1.0))
