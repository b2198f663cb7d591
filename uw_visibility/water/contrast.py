# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Decay of local contrast with range: e^(−βd), whatever the veil is.

The veil adds the same to neighbouring pixels at one range, so that their difference
is W Δρ e^(−βd). Texture is about scale invariant, but a scene's far parts may hold
more or less of it than its near ones. That error is common to the channels, so that
the differences between channels are known far better than their mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uw_visibility.water.observations import Envelopes
from uw_visibility.water.surfaces import COUNT, DIFFERENCE, RANGE, STEP, SurfaceStatistics

# Bins that are needed, and pixels that a bin needs.
FEWEST_BINS = 5
FEWEST_PIXELS = 75
# Contrast below so many times that of noise is not told from it.
ABOVE_NOISE = 1.0
# What texture and light change over a scene, as the logarithm of contrast per one
# standard deviation of range: common to the channels, and of each alone.
SCENE_DEVIATION = 0.25
CHANNEL_DEVIATION = 0.06
# Neighbouring bins show the same objects.
NEIGHBOURING_BINS = 3.0
# Deviation of a channel's attenuation, 1/m, of which nothing is seen.
UNSEEN = 10.0
# Difference of the envelopes and local contrast count alike.
SHARE_OF_CONTRAST = 0.5


@dataclass(frozen=True)
class Decay:
    """Attenuation of each channel from a course that falls as e^(−βd).

    Attributes
    ----------
    attenuation : (3,) float64 ndarray
        1/m; NaN where nothing shows it.
    covariance : (3, 3) float64 ndarray
        With the scene's error, common to the channels.
    """

    attenuation: NDArray[np.float64]
    covariance: NDArray[np.float64]


def contrast_course(
    statistics: SurfaceStatistics, noise: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Root mean square of the difference of a pixel to its neighbours, over range.

    Parameters
    ----------
    statistics : SurfaceStatistics
    noise : (3,) float64 ndarray
        Standard deviation of the image's noise and rounding, in code values.

    Returns
    -------
    range : (N,) float64 ndarray
        Of each bin with pixels enough, m.
    count : (N,) float64 ndarray
        Pixels of each.
    contrast : (3, N) float64 ndarray
        Irradiance, noise taken off; NaN where it is not told from noise.
    """
    sums = statistics.contrast[statistics.contrast[:, COUNT] >= FEWEST_PIXELS]
    count = sums[:, COUNT]
    variance = sums[:, DIFFERENCE] / count[:, np.newaxis]
    # One pixel and the mean of four.
    noisy = 1.25 * sums[:, STEP] / count[:, np.newaxis] * noise**2
    course = np.sqrt(np.where(variance > (1 + ABOVE_NOISE) * noisy, variance - noisy, np.nan))
    return sums[:, RANGE] / count, count, course.T


def decay(
    distance: NDArray[np.float64], count: NDArray[np.float64], course: NDArray[np.float64],
    active: NDArray[np.bool_],
) -> Decay | None:
    """Fit the logarithm of a course over range by a line.

    Parameters
    ----------
    distance, count : (N,) float64 ndarray
        Range, m, and pixels of each bin.
    course : (3, N) float64 ndarray
        What falls as e^(−βd); NaN where unknown.
    active : (3,) bool ndarray
        Channels that count; one at least.

    Returns
    -------
    Decay or None
        None where too few bins show it. Its covariance holds how far bins are from
        the line, and what a scene's texture changes over range.
    """
    if not active.all():
        course = np.where(active[:, np.newaxis], course, course[active].mean(axis=0))
    known = np.isfinite(course).all(axis=0) & (np.nan_to_num(course) > 0).all(axis=0)
    if known.sum() < FEWEST_BINS:
        return None
    d, logarithm = distance[known], np.log(course[:, known])
    weight = np.sqrt(count[known])
    weight /= weight.sum()
    centred = d - weight @ d
    spread = math.sqrt(float(weight @ centred**2))
    slope = (logarithm * weight) @ centred / spread**2
    residual = logarithm - (logarithm @ weight)[:, np.newaxis] - np.outer(slope, centred)
    independent = max(1.0 / float(weight @ weight) / NEIGHBOURING_BINS, 1.0)
    # Residuals that the channels share, and those of one alone.
    shared = (residual * weight) @ residual.T / independent
    covariance = shared + SCENE_DEVIATION**2 + CHANNEL_DEVIATION**2 * np.eye(3)
    # Of a channel that is not seen, nothing is said.
    return Decay(-slope, covariance / spread**2 + np.diag(np.where(active, 0.0, UNSEEN**2)))


def envelope_decay(envelope: Envelopes, active: NDArray[np.bool_]) -> Decay | None:
    """Attenuation from the difference of bright and dark envelope, W (ρ_u − ρ_d) e^(−βd)."""
    return decay(
        envelope.range, envelope.count.astype(np.float64),
        np.asarray(envelope.bright - envelope.dark), active,
    )


def fuse_decays(contrast: Decay | None, envelopes: Decay | None) -> Decay | None:
    """Mean of both: they share the scene, and so most of their error."""
    if contrast is None or envelopes is None:
        return contrast or envelopes
    share = SHARE_OF_CONTRAST
    return Decay(
        share * contrast.attenuation + (1 - share) * envelopes.attenuation,
        share * contrast.covariance + (1 - share) * envelopes.covariance,
    )
