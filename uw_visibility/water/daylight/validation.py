# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Validation of observations, and of what is estimated from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uw_visibility.images.arrays import Array
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate, passed, refuse
from uw_visibility.water.observations import FEWEST_BINS, Envelopes

# Largest relative deviation of the nearest range; beyond, disparities are noise.
MAX_RANGE_ERROR = 0.5
# Largest fraction of saturated, or black, pixels of a channel.
MAX_CLIPPED_FRACTION = 0.5
# Least irradiance of a channel's bright patches, and least difference from dark ones, in codes.
MIN_CODES = 4.0
# Attenuation is not assessable if its standard deviation is beyond both.
MAX_STDDEV = 0.1
MAX_RELATIVE_STDDEV = 0.75
# Standard deviations beyond which a contradiction is not by chance.
SIGNIFICANT = 3.0
# Part of attenuation by which the steps' estimates may differ. They share most of the image, and so
# most of their errors.
STEPS_APART = 0.25


def refuse_frame(envelope: Envelopes, min_range_ratio: float) -> Status:
    """Validate a frame's observations: OK, or why no channel is assessable.

    `min_range_ratio` is the least ratio of farthest to nearest range.
    """
    if (envelope.saturated > MAX_CLIPPED_FRACTION).all():
        return Status.SATURATED
    if len(envelope.range) == 0:
        return Status.TOO_FEW_OBSERVATIONS
    nearest, farthest = envelope.limits
    if farthest < min_range_ratio * nearest or envelope.range_error * nearest > MAX_RANGE_ERROR:
        return Status.RANGE_SPREAD_TOO_SMALL
    if len(envelope.range) < FEWEST_BINS:
        return Status.TOO_FEW_OBSERVATIONS
    if ((envelope.bright - envelope.dark) / envelope.step).max() < MIN_CODES:
        return Status.NO_TEXTURE
    return Status.NO_COLOUR if envelope.grey else Status.OK


def refuse_channel(envelope: Envelopes, channel: int) -> Status:
    """Validate a channel's observations: OK, or why it cannot be fitted."""
    if envelope.saturated[channel] > MAX_CLIPPED_FRACTION:
        return Status.SATURATED
    too_dark = envelope.least_light(channel) < MIN_CODES * envelope.step[channel].min()
    if too_dark or envelope.zero[channel] > MAX_CLIPPED_FRACTION:
        return Status.TOO_DARK
    return Status.OK


def refuse_uncertain(attenuation: float, stddev: float) -> Status:
    """Refuse an attenuation that is too uncertain; OK otherwise."""
    certain = stddev <= max(MAX_STDDEV, MAX_RELATIVE_STDDEV * attenuation)
    return Status.OK if certain else Status.ATTENUATION_UNCERTAIN


def refuse_attenuation(
    status: Sequence[Status], attenuation: Array, covariance: Array, clear_water: Array
) -> list[Status]:
    """Refuse channels whose attenuation is too uncertain, and all if they are too clear.

    `status` is that of the channels before, `covariance` (3, 3) that of β.
    """
    stddev = np.sqrt(np.diag(covariance))
    found = [
        refuse_uncertain(float(value), float(spread)) if reason is Status.OK else reason
        for reason, value, spread in zip(status, attenuation, stddev, strict=True)]
    shown = np.where(passed(found), attenuation, np.nan)
    return refuse(found, refute_clearness(shown, covariance, clear_water))


def refute_clearness(attenuation: Array, covariance: Array, clear_water: Array) -> Status:
    """Refuse an estimate that is significantly clearer than clear water; OK otherwise.

    NaN for unknown channels; `covariance` (3, 3) of β.
    """
    missing = clear_water - attenuation
    beyond = missing > SIGNIFICANT * np.sqrt(np.diag(covariance))
    known = np.isfinite(missing)
    # Mean attenuation by particles, α < 0 (eq. 9).
    together = missing[known].sum() > SIGNIFICANT * np.sqrt(covariance[np.ix_(known, known)].sum())
    return Status.CLEARER_THAN_CLEAR_WATER if (beyond.any() or together) else Status.OK


def compare_steps(first: WaterEstimate, second: WaterEstimate) -> WaterEstimate:
    """Refuse the second step's estimate where the first one's contradicts it.

    Both read the same pixels, but with ranges of a mesh and of dense disparities. The mesh covers
    open water and snow too, so a clearer first estimate is no contradiction.
    """
    apart = first.attenuation - second.attenuation
    deviation = np.hypot(first.attenuation_stddev, second.attenuation_stddev)
    # Comparisons with NaN are false.
    contradicted = (apart > SIGNIFICANT * deviation) & (apart > STEPS_APART * second.attenuation)
    if not contradicted.any():
        return second
    return WaterEstimate.not_assessable(Status.STEPS_DISAGREE, second.envelope)
