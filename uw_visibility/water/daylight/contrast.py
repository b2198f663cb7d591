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

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.water.daylight.surfaces import COUNT, DIFFERENCE, RANGE, STEP, SurfaceStatistics
from uw_visibility.water.observations import Envelopes

# Bins that are needed, and pixels that a bin needs.
FEWEST_CONTRAST_BINS = 5
FEWEST_PIXELS = 75
# Least contrast over that of noise.
ABOVE_NOISE = 1.0
# Deviation of the logarithm of contrast by texture and light, per standard deviation of range:
# common to the channels, and of each alone.
SCENE_DEVIATION = 0.25
CHANNEL_DEVIATION = 0.06
# Neighbouring bins show the same objects.
CONTRAST_BINS_ALIKE = 3.0
# Deviation of a channel's attenuation, 1/m, of which nothing is seen.
UNSEEN = 10.0
# Difference of the envelopes and local contrast count alike.
SHARE_OF_CONTRAST = 0.5


@dataclass(frozen=True)
class Decay:
    """Attenuation of each channel from a quantity that falls as e^(−βd).

    Attributes
    ----------
    attenuation : (3,) float64 ndarray
        1/m; NaN where unknown.
    covariance : (3, 3) float64 ndarray
        With the error by the scene, common to the channels.
    """

    attenuation: Array
    covariance: Array


def contrast_course(statistics: SurfaceStatistics, noise: Array) -> tuple[Array, Array, Array]:
    """Root mean square difference of pixels to their neighbours, over range.

    Takes the standard deviation of noise and rounding, (3,), in code values. Returns range (N,), m,
    and pixels (N,) of each bin, and contrast (3, N), irradiance without noise; NaN where noise
    hides it.
    """
    sums = statistics.contrast[statistics.contrast[:, COUNT] >= FEWEST_PIXELS]
    count = sums[:, COUNT]
    variance = sums[:, DIFFERENCE] / count[:, np.newaxis]
    # One pixel and the mean of four.
    noisy = 1.25 * sums[:, STEP] / count[:, np.newaxis] * noise**2
    course = np.sqrt(np.where(variance > (1 + ABOVE_NOISE) * noisy, variance - noisy, np.nan))
    return sums[:, RANGE] / count, count, course.T


def decay(distance: Array, count: Array, course: Array, active: Mask) -> Decay | None:
    """Fit a line to the logarithm of a quantity (3, N) over range (N,), m, weighted by pixels (N,).

    None where too few bins show it. The covariance holds the scatter about the line, and the change
    of a scene's texture over range.
    """
    if not active.all():
        course = np.where(active[:, np.newaxis], course, course[active].mean(axis=0))
    known = np.isfinite(course).all(axis=0) & (np.nan_to_num(course) > 0).all(axis=0)
    if known.sum() < FEWEST_CONTRAST_BINS:
        return None
    d, logarithm = distance[known], np.log(course[:, known])
    weight = np.sqrt(count[known])
    weight /= weight.sum()
    centred = d - weight @ d
    spread = math.sqrt(float(weight @ centred**2))
    slope = (logarithm * weight) @ centred / spread**2
    residual = logarithm - (logarithm @ weight)[:, np.newaxis] - np.outer(slope, centred)
    independent = max(1.0 / float(weight @ weight) / CONTRAST_BINS_ALIKE, 1.0)
    # Residuals that the channels share, and those of one alone.
    shared = (residual * weight) @ residual.T / independent
    covariance = shared + SCENE_DEVIATION**2 + CHANNEL_DEVIATION**2 * np.eye(3)
    # Of a channel that is not seen, nothing is said.
    return Decay(-slope, covariance / spread**2 + np.diag(np.where(active, 0.0, UNSEEN**2)))


def envelope_decay(envelope: Envelopes, active: Mask) -> Decay | None:
    """Decay of the difference of bright and dark envelope, W (ρ_u − ρ_d) e^(−βd)."""
    return decay(
        envelope.range, envelope.count.astype(np.float64),
        np.asarray(envelope.bright - envelope.dark), active)


def fuse_decays(contrast: Decay | None, envelopes: Decay | None) -> Decay | None:
    """Mean of both: they share the scene, and so most of their error."""
    if contrast is None or envelopes is None:
        return contrast or envelopes
    share = SHARE_OF_CONTRAST
    return Decay(
        share * contrast.attenuation + (1 - share) * envelopes.attenuation,
        share * contrast.covariance + (1 - share) * envelopes.covariance)
