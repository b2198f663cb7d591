# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Validation of observations before a fit, and of the fit of each channel."""

from __future__ import annotations

import numpy as np

from uw_visibility.images.arrays import Array
from uw_visibility.optics.light_model import transmission, veil_thickness
from uw_visibility.status import Status
from uw_visibility.water.daylight.fit import ATTENUATION_BOUNDS, Fit
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.observations import Envelopes

# The bright envelope is that of the third brightest bin: one or two bins may
# hold an animal's reflection or wrong ranges.
BRIGHT_BINS = 3
MIN_BINS = 6
# Largest relative deviation of the nearest range; beyond, disparities are noise.
MAX_RANGE_ERROR = 0.5
# Largest fraction of saturated, or black, pixels of a channel.
MAX_CLIPPED_FRACTION = 0.5
# Least code values that a channel's bright patches span.
MIN_CODES = 4.0
# Attenuation is not assessable if its standard deviation is beyond both.
MAX_STDDEV = 0.1
MAX_RELATIVE_STDDEV = 0.75
# Ambient light is known from bright patches, by their radiance over that of the dark ones near by,
# or from optically thick water.
MIN_NEAR_RADIANCE = 0.25
MIN_OPTICAL_THICKNESS = 4.0
# Standard deviations beyond which an attenuation below clear water's is refuted.
CLEARER = 3.0
# Standard deviations, and part of attenuation, by which the steps' estimates may differ. They share
# most of the image, and so most of their errors.
STEPS_APART, STEPS_APART_PART = 3.0, 0.25


def refuse_frame(envelope: Envelopes, min_pixels: int, min_range_ratio: float) -> Status:
    """Validate a frame's observations: OK, or why no channel is assessable.

    `min_pixels` is what a bin needs, `min_range_ratio` the least ratio of farthest to nearest
    range.
    """
    if envelope.pixels < min_pixels * MIN_BINS:
        return Status.TOO_FEW_OBSERVATIONS
    if (envelope.saturated > MAX_CLIPPED_FRACTION).all():
        return Status.SATURATED
    if len(envelope.range) == 0:
        return Status.TOO_FEW_OBSERVATIONS
    if envelope.range[-1] < min_range_ratio * envelope.range[0]:
        return Status.RANGE_SPREAD_TOO_SMALL
    if envelope.range_error * envelope.range[0] > MAX_RANGE_ERROR:
        return Status.RANGE_SPREAD_TOO_SMALL
    if len(envelope.range) < MIN_BINS:
        return Status.TOO_FEW_OBSERVATIONS
    return Status.OK


def refuse_channel(envelope: Envelopes, channel: int) -> Status:
    """Validate a channel's observations: OK, or why it cannot be fitted."""
    if envelope.saturated[channel] > MAX_CLIPPED_FRACTION:
        return Status.SATURATED
    known = np.isfinite(envelope.dark[channel])
    if known.sum() < MIN_BINS:
        return Status.SATURATED if not known.all() else Status.TOO_FEW_OBSERVATIONS
    too_dark = least_ambient_light(envelope, channel) < MIN_CODES * np.nanmin(
        envelope.step[channel])
    if too_dark or envelope.zero[channel] > MAX_CLIPPED_FRACTION:
        return Status.TOO_DARK
    return Status.OK


def validate_fit(fit: Fit, envelope: Envelopes, channel: int) -> Status:
    """Validate the fit of a channel: OK, or the first reason why it does not hold."""
    attenuation, ambient = fit.parameters[channel]
    variance = np.diag(fit.covariance)[2 * channel:2 * channel + 2]
    if not fit.converged or not np.isfinite(variance).all() or (variance < 0).any():
        return Status.FIT_FAILED
    if attenuation >= ATTENUATION_BOUNDS[1]:
        return Status.FIT_FAILED
    near = near_bins(envelope)
    direct = ambient * transmission(attenuation, envelope.range[near])
    bright, dark = envelope.bright[channel, near], envelope.dark[channel, near]
    radiance = np.max(np.nan_to_num((bright - dark) / direct))
    thickness = attenuation * envelope.range[-1]
    if radiance < MIN_NEAR_RADIANCE and thickness < MIN_OPTICAL_THICKNESS:
        return Status.AMBIENT_LIGHT_UNBOUNDED
    return refuse_spread(float(attenuation), float(np.sqrt(variance[0])))


def refuse_spread(
    attenuation: float, stddev: float, most_relative: float = MAX_RELATIVE_STDDEV
) -> Status:
    """Refuse an attenuation that is too uncertain; OK otherwise."""
    certain = stddev <= max(MAX_STDDEV, most_relative * attenuation)
    return Status.OK if certain else Status.RANGE_SPREAD_TOO_SMALL


def refute_clearness(attenuation: Array, covariance: Array, clear_water: Array) -> Status:
    """Refuse an estimate that is significantly clearer than clear water; OK otherwise.

    NaN for unknown channels; `covariance` (3, 3) of β.
    """
    missing = clear_water - attenuation
    beyond = missing > CLEARER * np.sqrt(np.diag(covariance))
    known = np.isfinite(missing)
    # Mean attenuation by particles, α < 0 (eq. 9).
    together = missing[known].sum() > CLEARER * np.sqrt(covariance[np.ix_(known, known)].sum())
    return Status.CLEARER_THAN_CLEAR_WATER if (beyond.any() or together) else Status.OK


def compare_steps(first: WaterEstimate, second: WaterEstimate) -> WaterEstimate:
    """Refuse the second step's estimate where the first one's contradicts it.

    Both read the same pixels, but with ranges of a mesh and of dense disparities. The mesh covers
    open water and snow too, so a clearer first estimate is no contradiction.
    """
    apart = first.attenuation - second.attenuation
    deviation = np.hypot(first.attenuation_stddev, second.attenuation_stddev)
    # Comparisons with NaN are false.
    contradicted = (apart > STEPS_APART * deviation) & (
        apart > STEPS_APART_PART * second.attenuation)
    if not contradicted.any():
        return second
    return WaterEstimate.not_assessable(Status.STEPS_DISAGREE, second.envelope)


def least_ambient_light(envelope: Envelopes, channel: int) -> float:
    """Lower bound of ambient light: the bright envelope (eq. 7)."""
    bright = envelope.bright[channel]
    ordered = np.sort(bright[np.isfinite(bright)])
    return float(ordered[-min(BRIGHT_BINS, len(ordered))])


def brightest_patch(envelope: Envelopes, channel: int) -> tuple[float, float]:
    """Irradiance and range of the brightest patch in the nearest quarter of the bins."""
    bright = np.nan_to_num(envelope.bright[channel, near_bins(envelope)])
    at = int(bright.argmax())
    return float(bright[at]), float(envelope.range[at])


def near_bins(envelope: Envelopes) -> slice:
    """Nearest quarter of the bins."""
    return slice(0, -(-len(envelope.range) // 4))


def black_attenuation(envelope: Envelopes, channel: int, ambient_light: float) -> Array:
    """Attenuation at which each bin's dark envelope is black, 1/m: an upper bound."""
    known = np.isfinite(envelope.dark[channel])
    share = np.clip(envelope.dark[channel, known] / ambient_light, 0.0, 0.98)
    return np.asarray(veil_thickness(share, 1.0) / envelope.dark_range[channel, known])
