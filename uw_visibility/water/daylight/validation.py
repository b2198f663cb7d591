# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Validation of observations before a fit, and of the fit of each channel."""

from __future__ import annotations

import math

import numpy as np

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.light_model import transmission, veil_thickness
from uw_visibility.status import Status
from uw_visibility.water.daylight.fit import ATTENUATION_BOUNDS, Fit
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.observations import Envelopes, quantile_of_known

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

# Under lamps the brightest patches fall with range, as 1/d in turbid water and faster than 1/d² in
# clear water, to a small part of those near by; by daylight they end in the veil. Most channels
# count, since in turbid water red may not fall. FLSea's frames fall as d^(-0.5) and less.
LAMP_SLOPE, LAMP_SLOPE_ERROR = -0.8, 2.0
LAMP_FALL, LAMP_DARKNESS = 0.6, 0.5
# A white board in front of dull ground falls by day too, but in one step: fall that lamps cause
# beside a step; ratio of ranges beyond which nothing is seen in between; ratio that separates two
# things, and that one of them has to span.
LAMP_FALL_BESIDE_STEP, RANGE_GAP, FAR_APART = 0.55, 1.25, 1.6


def lit_by_lamps(envelope: Envelopes, seen: Mask) -> bool:
    """Whether the bright envelope falls with range as under lamps, in most channels seen."""
    if not seen.any():
        return False
    near, far = near_bins(envelope), slice(-near_bins(envelope).stop, None)
    bright = np.where(envelope.bright > 0, envelope.bright, np.nan)[seen]
    first = quantile_of_known(bright[:, near], 0.5)
    last = quantile_of_known(bright[:, far], 0.5)
    dark = quantile_of_known(envelope.dark[seen][:, far], 0.5)
    known = np.isfinite(bright)
    if (known.sum(axis=1) < MIN_BINS).any() or np.isnan(first + last).any():
        return False
    shown = np.empty((len(bright), 4))
    courses = []
    for channel in range(len(bright)):
        here = known[channel]
        course = envelope.range[here], bright[channel, here], np.sqrt(envelope.count[here])
        courses.append(course)
        slope, error = _logarithmic_slope(*course)
        shown[channel] = (
            slope, slope + LAMP_SLOPE_ERROR * error, last[channel] / first[channel],
            dark[channel] / first[channel])
    _, slope, fall, darkness = np.median(shown, axis=0)
    falls = (
        shown[:, 0].max() < 0 and slope < LAMP_SLOPE
        and fall < LAMP_FALL and darkness < LAMP_DARKNESS)
    return bool(falls and np.median(
        [_fall_beside_step(*course) for course in courses]) < LAMP_FALL_BESIDE_STEP)


def _logarithmic_slope(distance: Array, values: Array, weight: Array) -> tuple[float, float]:
    """Slope of ln value over ln distance, and its standard deviation."""
    weight = weight / weight.sum()
    x, y = np.log(distance), np.log(values)
    x, y = x - weight @ x, y - weight @ y
    spread = max(float(weight @ x**2), 1e-12)
    slope = float((weight * x) @ y) / spread
    residual = float(weight @ (y - slope * x) ** 2)
    return slope, float(np.sqrt(residual / spread * (weight @ weight)))


def _fall_beside_step(distance: Array, values: Array, weight: Array) -> float:
    """Last value over the first of the longest thing, without one step and unseen gaps.

    By ln value = a + b ln distance + (c beyond a step), with the step of least residuals.
    """
    x, y, root = np.log(distance), np.log(values), np.sqrt(weight)
    things = np.split(np.arange(len(x)), np.flatnonzero(np.diff(x) > math.log(FAR_APART)) + 1)
    thing = max(things, key=lambda part: float(x[part[-1]] - x[part[0]]))
    x, y, root = x[thing], y[thing], root[thing]
    if len(things) > 1 and (len(x) < MIN_BINS or x[-1] - x[0] < math.log(FAR_APART)):
        return 1.0
    best = slope = math.inf
    for step in range(2, len(x) - 1):
        near = np.arange(len(x)) < step
        columns = np.stack((near, ~near, x), axis=1) * root[:, np.newaxis]
        found = np.linalg.lstsq(columns, root * y, rcond=None)[0]
        residual = float(((root * y - columns @ found) ** 2).sum())
        if residual < best:
            best, slope = residual, float(found[2])
    apart = np.diff(x)
    return math.exp(slope * float(apart[apart < math.log(RANGE_GAP)].sum()))


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
