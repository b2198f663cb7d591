# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Adaptive Kalman filter of the water's state over frames, and its measurements.

The state is the logarithms of attenuation and ambient light in each channel: errors of both are
factors, so that σ does not depend on the value. In the time between frames turbidity wanders,
mostly by the same particles in all channels, and the colour of light wanders. The camera's exposure
may change freely between frames: a log gain common to the channels. It needs no state of its own:
it is process noise along the direction in which the three ambient lights change together, so that
a jump changes neither attenuation nor chromaticity.

How fast the water changes is not known beforehand: the process noise adapts to the
innovations (R. Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic
Control 17, 1972, doi:10.1109/TAC.1972.1100100). Where innovations are biased, or one is
unexpectedly large, the covariance grows along the innovation until its size is as expected. Part of
the growth is kept for later frames, and so is the rate at which frames change, where it exceeds
their errors. A frame beyond the gate is rejected, since most such frames are full of marine snow.
It may be the first frame of a change, too: the standard deviations include this chance, and two
such frames that agree are followed.

A part of a frame's error is common to all frames, since they show the same scene; averaging does
not reduce it. It is a consider parameter (Schmidt 1966): it does not change the filter's gain, but
is fully included in the standard deviations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uw_visibility.config.schema import TrackingConfig
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.water.estimate import WaterEstimate

# Errors that channels share come from model, ranges and scene, so that frames share them, too: in
# rendered frames 0.98 of their variance, and half of the rest. Largest variance of the part that is
# new in a frame, over that of the differences between channels.
_LARGEST_NEW = 30.0
ATTENUATION = slice(0, 6, 2)
LIGHT = slice(1, 6, 2)


@dataclass(frozen=True)
class Measurement:
    """Measurement of the filter: a frame's ln β and ln I∞, with the two parts of their error."""

    seen: Mask  # (3,), channels that were assessed
    value: Array  # (6,)
    noise: Array  # (6, 6), covariance of the error that is new in each frame
    common: Array  # (6, 6), root of the covariance of the error that all frames share

    @property
    def covariance(self) -> Array:
        """(6, 6) float64: covariance of the whole error."""
        return np.asarray(self.noise + self.common @ self.common.T)

    def agrees(self, other: Measurement, config: TrackingConfig) -> bool:
        """Whether another measurement is of the same water, at any exposure."""
        spread = self.covariance + other.covariance
        spread[LIGHT, LIGHT] += config.exposure_change**2
        return _passes(
            other.value - self.value, spread, self.seen & other.seen, config.gate_probability)

    @classmethod
    def of(cls, estimate: WaterEstimate, common_error: float) -> Measurement:
        """Convert an estimate; `common_error` is the part of its variance that frames share."""
        joint = estimate.covariance
        seen = np.isfinite(estimate.attenuation) & np.isfinite(estimate.ambient_light)
        seen &= np.minimum(estimate.attenuation, estimate.ambient_light) > 0.0
        seen &= np.isfinite(np.diag(joint)).reshape(3, 2).all(axis=1)
        both = np.repeat(seen, 2)
        linear = np.ones(6)
        linear[ATTENUATION] = np.where(seen, estimate.attenuation, 1.0)
        linear[LIGHT] = np.where(seen, estimate.ambient_light, 1.0)
        value = np.log(linear)
        covariance = np.where(np.outer(both, both), joint / np.outer(linear, linear), 0.0)
        noise = (1.0 - common_error) * _own(covariance, 2 * np.flatnonzero(seen))
        return cls(seen, value, noise, _root(covariance - noise))


def _passes(innovation: Array, covariance: Array, channels: Mask, probability: float) -> bool:
    """Chi-squared gate over some channels; True without any."""
    index = np.flatnonzero(np.repeat(channels, 2))
    if index.size == 0:
        return True
    spread = covariance[np.ix_(index, index)]
    distance = innovation[index] @ np.linalg.solve(spread + _ridge(spread), innovation[index])
    return bool(distance <= chdtri(index.size, 1.0 - probability))


def _root(covariance: Array) -> Array:
    """Symmetric square root of a covariance: it changes little when the covariance does."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _own(covariance: Array, index: NDArray[np.intp]) -> Array:
    """Covariance with the error that channels share in attenuation reduced to `_LARGEST_NEW`."""
    if len(index) < 2:
        return covariance
    block = np.ix_(index, index)
    values, vectors = np.linalg.eigh(covariance[block])
    kept = _LARGEST_NEW * values[:-1].mean() / values[-1]
    if kept >= 1.0:
        return covariance
    alike = vectors[:, -1]
    shrink = np.eye(6)
    shrink[block] -= (1.0 - np.sqrt(kept)) * np.outer(alike, alike)
    return np.asarray(shrink @ covariance @ shrink)


def _parts(channels: Mask) -> Iterator[tuple[NDArray[np.intp], tuple[NDArray[np.intp], ...]]]:
    """Indices of attenuation, then of light, of some channels, and the block of these in (6, 6)."""
    if channels.any():
        for part in (ATTENUATION, LIGHT):
            index = np.arange(6)[part][channels]
            yield index, np.ix_(index, index)


# Part of a change of turbidity that differs between channels.
_CHANNEL_SHARE = 0.5
# Innovations are averaged over about 1 / this many frames; the mean of noise has this part of an
# innovation's variance.
_TREND_SHARE = 0.3
_TREND_VARIANCE = _TREND_SHARE / (2.0 - _TREND_SHARE)
# An interval is a gap if it is so many times longer than the last one.
_GAP = 1.5
# Quantile beyond which an innovation is unexpectedly large.
_SURPRISE = 0.99
# Changes from frame to frame are averaged over about 1 / this many; the mean of errors alone has
# this part of a frame's variance, since successive changes are anticorrelated.
_RATE_SHARE = 0.5
_RATE_VARIANCE = 2.0 * _RATE_SHARE**2 / (2.0 - _RATE_SHARE)
# The water changes if chi squared of this mean is so many standard deviations too large. Not low:
# where changes are expected, outliers pass the gate.
_RATE_LIMIT = 3.0
# Change of ln β or ln I∞ from a frame to the next that water seldom exceeds: a factor of five.
_FASTEST = math.log(5.0)
# Part of a change's process noise that is kept from frame to frame.
_DRIFT_KEPT = 0.5


class WaterState:
    """Mean and covariance of ln β and ln I∞, and how fast they change."""

    def __init__(self, measurement: Measurement) -> None:
        self.mean = measurement.value.copy()
        self.covariance = measurement.noise.copy()
        # Effect of the errors that all frames have in common.
        self.common = measurement.common.copy()
        self.known = measurement.seen.copy()
        self._age = np.zeros(3)
        # Time since the last measurement, and since the last one taken in, s.
        self._interval = self._unseen = 0.0
        # Last interval between measurements, s; whether the current one is a gap or has frames
        # without measurement; the variance added to the covariance for that.
        self._last_interval = 0.0
        self._gap = False
        self._unawares: Array = np.zeros((3, 3))
        # Recent mean innovation and mean rate of change (per s), last accepted measurement, and
        # covariance of the rate of change, per s².
        self._trend = np.zeros(6)
        self._rate = np.zeros(6)
        self._last = measurement
        self._drift = np.zeros((6, 6))

    def predict(self, elapsed: float, config: TrackingConfig, shown: bool) -> None:
        """Grow the covariance over `elapsed` s; `shown`: the new frame shows the water."""
        # The same particles are added in all channels, with an attenuation of the mean β.
        attenuation = np.where(self.known, np.exp(self.mean[ATTENUATION]), np.inf)
        part = attenuation[self.known].mean() / attenuation
        alike = np.outer(part, part)
        turbidity = config.turbidity_rate**2 * elapsed * alike
        self.covariance[ATTENUATION, ATTENUATION] += turbidity * (
            1.0 - _CHANNEL_SHARE**2 + _CHANNEL_SHARE**2 * np.eye(3))
        colour = config.light_rate**2 * elapsed
        self.covariance[LIGHT, LIGHT] += config.exposure_change**2 + colour * np.eye(3)
        drifted = self._drifted()
        self._age += elapsed
        self._interval += elapsed
        self._unseen += elapsed
        # Water that changes goes on changing: linear in time, unlike a random walk.
        self.covariance += self._drifted() - drifted
        self._gap |= not shown or self._interval > _GAP * self._last_interval
        # Water may begin to change while frames do not show it, perhaps for that reason, and at an
        # unknown rate.
        unawares = math.expm1(config.unseen_rate * self._interval) ** 2 * alike * float(self._gap)
        self.covariance[ATTENUATION, ATTENUATION] += unawares - self._unawares
        self._unawares = unawares
        self.known &= self._age <= config.timeout

    def _drifted(self) -> Array:
        """Covariance of changes since the last accepted measurement."""
        return self._unseen**2 * self._drift

    def accepts(self, measurement: Measurement, probability: float, drifting: bool = True) -> bool:
        """Chi-squared gate: whether a measurement may be one of this state, drifting or not."""
        spread = self.covariance + self.common @ self.common.T + measurement.covariance
        if not drifting:
            spread -= self._drifted()
        return _passes(
            measurement.value - self.mean, spread, self.known & measurement.seen, probability)

    def reject(self, measurement: Measurement, share: float) -> Array:
        """Covariance of the chance `share` (0..1) that a rejected measurement is right.

        The chance falls where the change is larger than `_FASTEST`: water does not change so fast.
        """
        self._end_interval()
        both = np.repeat(self.known & measurement.seen, 2)
        innovation = np.where(both, measurement.value - self.mean, 0.0)
        share /= 1.0 + np.max((innovation / _FASTEST) ** 2)
        return np.asarray(share * np.outer(innovation, innovation))

    def _end_interval(self) -> None:
        """Start the interval to the next measurement."""
        self._last_interval, self._interval = self._interval, 0.0
        self._gap, self._unawares = False, np.zeros((3, 3))

    def adapt(self, measurement: Measurement, config: TrackingConfig) -> None:
        """Adapt the process noise to innovations that the state's covariance does not explain.

        The covariance grows where this innovation is a surprise, or where the mean of recent ones,
        which is about zero while the state keeps up with the water, is beyond noise: then the state
        lags behind. The rate of change is kept for later frames.
        """
        both = self.known & measurement.seen
        if not both.any():
            return
        innovation = measurement.value - self.mean
        changed = not self.accepts(
            measurement, min(_SURPRISE, config.gate_probability), drifting=False)
        drifted = self._drifted()
        state, noise = self._own(measurement)
        growth, needed = np.zeros((2, 6, 6))
        for index, block in _parts(both):
            spread = (state + noise)[block]
            spread += _ridge(spread)
            self._trend[index] += _TREND_SHARE * (innovation[index] - self._trend[index])
            if changed:
                growth[block] = _growth(innovation[index], spread)
                needed[block] = _growth(innovation[index], spread - drifted[block])
            else:
                growth[block] = _beyond_noise(self._trend[index], _TREND_VARIANCE * spread)
        self.covariance += growth
        self._drift = (
            _DRIFT_KEPT * self._drift + (1.0 - _DRIFT_KEPT) * needed / self._interval**2
            + self._ramp(measurement, config.exposure_change))

    def _ramp(self, measurement: Measurement, exposure_change: float) -> Array:
        """Update the mean rate of change; return the part of its square beyond noise."""
        both = self.known & measurement.seen & self._last.seen
        change = (measurement.value - self._last.value) / self._unseen
        # The whole errors: the part that frames share is poorly known.
        spread = 0.5 * (measurement.covariance + self._last.covariance)
        spread[LIGHT, LIGHT] += exposure_change**2
        spread *= _RATE_VARIANCE / self._unseen**2
        ramp = np.zeros((6, 6))
        for index, block in _parts(both):
            self._rate[index] += _RATE_SHARE * (change[index] - self._rate[index])
            ramp[block] = _beyond_noise(
                self._rate[index], spread[block] + _ridge(spread[block]), _RATE_LIMIT)
        return ramp

    def correct(self, measurement: Measurement) -> None:
        """Update the state by a measurement."""
        self._begin(measurement.seen & ~self.known, measurement)
        gain = self._gain(measurement)
        kept = np.eye(6) - gain
        self.mean = self.mean + gain @ (measurement.value - self.mean)
        # This form (Joseph's) holds for any gain, the best one or not.
        self.covariance = kept @ self.covariance @ kept.T + gain @ measurement.noise @ gain.T
        self.common = kept @ self.common + gain @ measurement.common
        self._age[measurement.seen] = 0.0
        self._last = measurement
        self._unseen = 0.0
        self._end_interval()

    def _own(self, measurement: Measurement) -> tuple[Array, Array]:
        """Covariances of the state's and the measurement's own errors, (6, 6) each.

        Where one shared error is larger than the other, the excess counts as its own error, so that
        precise frames have more weight.
        """
        state, noise = self.covariance.copy(), measurement.noise.copy()
        ours, theirs = (common @ common.T for common in (self.common, measurement.common))
        for _, block in _parts(self.known & measurement.seen):
            state[block] += _excess(ours[block], theirs[block])
            noise[block] += _excess(theirs[block], ours[block])
        return state, noise

    def _gain(self, measurement: Measurement) -> Array:
        """Gain that corrects attenuation and light by their own innovation only.

        The optimal gain would also use the correlation of their errors in a frame. It is poorly
        known, and would turn errors of attenuation into errors of depth.
        """
        gain = np.zeros((6, 6))
        state, noise = self._own(measurement)
        for _, block in _parts(measurement.seen):
            spread = (state + noise)[block]
            gain[block] = np.linalg.solve(spread + _ridge(spread), state[block]).T
        return gain

    def _begin(self, new: Mask, measurement: Measurement) -> None:
        """Initialise unknown channels, with a very large covariance."""
        for channel in np.flatnonzero(new):
            block = slice(2 * channel, 2 * channel + 2)
            self.mean[block] = measurement.value[block]
            self.covariance[block, :] = 0.0
            self.covariance[:, block] = 0.0
            self.covariance[block, block] = 1e6 * measurement.noise[block, block]
            self.common[block] = measurement.common[block]
            self._trend[block] = self._rate[block] = 0.0
            self._drift[block, :] = self._drift[:, block] = 0.0
            self.known[channel] = True

    def published(self, doubt: Array) -> tuple[Array, Array]:
        """β and I∞, interleaved, and their covariance plus `doubt`."""
        mean = np.exp(self.mean)
        covariance = self.covariance + self.common @ self.common.T + doubt
        return mean, np.outer(mean, mean) * covariance


def _excess(larger: Array, other: Array) -> Array:
    """Part of a covariance that is beyond another one."""
    values, vectors = np.linalg.eigh(larger - other)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _growth(innovation: Array, spread: Array) -> Array:
    """Growth of a covariance that makes an innovation as large as expected."""
    return _beyond_noise(innovation, spread) / len(innovation)


def _beyond_noise(mean: Array, spread: Array, limit: float = 0.0) -> Array:
    """Part of the square of a mean that noise of this covariance does not explain.

    Noise explains a chi squared that is `limit` standard deviations too large.
    """
    degrees = len(mean)
    distance = float(mean @ np.linalg.solve(spread, mean))
    noise = degrees + limit * math.sqrt(2.0 * degrees)
    return np.asarray((1.0 - noise / max(distance, noise)) * np.outer(mean, mean))


def _ridge(covariance: Array) -> Array:
    """Diagonal jitter for a near-singular covariance."""
    return np.diag(1e-9 * np.diag(covariance) + 1e-15)
