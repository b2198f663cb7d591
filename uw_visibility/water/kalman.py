# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Adaptive Kalman filter of the water's state over frames.

The state is attenuation and the logarithm of ambient light in each channel. In
the time between frames turbidity wanders, mostly alike in all channels, and the
colour of light wanders. The camera's exposure may be any other one in each frame:
a log gain common to the channels. It needs no state of its own: being forgotten
from frame to frame, it is process noise along the one direction in which the
three ambient lights change together, so that a jump leaves attenuation and
chromaticity alone.

How fast the water changes is not known beforehand: the process noise adapts to the
innovations (R. Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic
Control 17, 1972, doi:10.1109/TAC.1972.1100100). Where innovations keep to one side,
or where one of them surprises, the covariance grows along the innovation until that
is no larger than expected, and part of the growth stays for the frames to come. So does
the rate at which frames change, where it is more than their errors: channels err much
alike, and the small difference between them is what a ramp soon leaves. A frame beyond
the gate is rejected, since most are full of marine snow; that it may be the first of a
change is in the standard deviations until the next frames tell.

A part of a frame's error stays the same over frames, since they show the same
scene; averaging does not lessen it. It is carried along as a consider parameter
(Schmidt 1966): it has no influence on the filter's gain, and a full one on the
standard deviations.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from uw_visibility.config.schema import TrackingConfig
from uw_visibility.water.fit import ATTENUATION_BOUNDS
from uw_visibility.water.measurement import ATTENUATION, LIGHT, Measurement

# How much of a change of turbidity a single channel has for itself.
_CHANNEL_SHARE = 0.5
# Attenuation, 1/m, below which its changes are no longer proportional to it.
_LEAST_ATTENUATION = 0.1
# Innovations are averaged over about 1 / this many frames. The average of nothing
# but noise has this part of an innovation's variance.
_TREND_SHARE = 0.3
_TREND_VARIANCE = _TREND_SHARE / (2.0 - _TREND_SHARE)
# Standard deviations of its chi squared beyond which the average says that the
# state lags behind the water. Low: growth begins at nothing there.
_TREND_LIMIT = 1.0
# An interval between measurements is a gap from so many times the last one on.
_GAP = 1.5
# An innovation that so many are smaller than, where all is well, is taken for a change.
_SURPRISE = 0.99
# Changes from frame to frame are averaged over about 1 / this many of them. Of errors alone
# the average has this part of a frame's variance: following changes contradict each other.
_RATE_SHARE = 0.5
_RATE_VARIANCE = 2.0 * _RATE_SHARE**2 / (2.0 - _RATE_SHARE)
# Standard deviations of its chi squared beyond which it says that the water changes. Not low:
# outliers pass the gate as far as changes are expected.
_RATE_LIMIT = 3.0
# An error is far larger than another one by so many times. Not by less: errors grow with what
# was measured, and whoever believes the lower ones more is biased.
_FAR_LARGER = 1.5
# What stays, from frame to frame, of the process noise that a change has added.
_DRIFT_KEPT = 0.5


class WaterState:
    """Mean and covariance of β and ln I∞, and how fast they change."""

    def __init__(self, measurement: Measurement) -> None:
        self.mean = measurement.value.copy()
        self.covariance = measurement.noise.copy()
        # Effect of the errors that all frames have in common.
        self.common = measurement.common.copy()
        self.known = measurement.seen.copy()
        self._age = np.zeros(3)
        # Time since the last measurement, and since the last one taken in, s.
        self._interval = self._unseen = 0.0
        # The last time between measurements, s, whether this one is a gap or frames showed
        # nothing in it, and the variance that is in the covariance for that.
        self._last_interval = 0.0
        self._gap = False
        self._unawares = 0.0
        # Mean innovation and mean rate of change of late (per s), the measurement that was taken
        # in last, and the covariance of the rate of change, per s².
        self._trend = np.zeros(6)
        self._rate = np.zeros(6)
        self._last = measurement
        self._drift = np.zeros((6, 6))

    def predict(self, elapsed: float, config: TrackingConfig, shown: bool = True) -> None:
        """Predict the state after some time: its covariance grows.

        Parameters
        ----------
        elapsed : float
            s.
        config : TrackingConfig
        shown : bool
            Whether the frame that comes shows the water.
        """
        turbidity = (config.turbidity_rate * self._scale()) ** 2 * elapsed
        self.covariance[ATTENUATION, ATTENUATION] += turbidity * (
            1.0 - _CHANNEL_SHARE**2 + _CHANNEL_SHARE**2 * np.eye(3)
        )
        colour = config.light_rate**2 * elapsed
        self.covariance[LIGHT, LIGHT] += config.exposure_change**2 + colour * np.eye(3)
        drifted = self._drifted()
        self._age += elapsed
        self._interval += elapsed
        self._unseen += elapsed
        # Who changes goes on to: not a random walk's square root of time.
        self.covariance += self._drifted() - drifted
        self._gap |= not shown or self._interval > _GAP * self._last_interval
        unawares = self._changed_unawares(config) if self._gap else 0.0
        self.covariance[ATTENUATION, ATTENUATION] += unawares - self._unawares
        self._unawares = unawares
        self.known &= self._age <= config.timeout

    def _drifted(self) -> NDArray[np.float64]:
        """Return the part of the covariance by changes since the last measurement taken in."""
        return self._unseen**2 * self._drift

    def _changed_unawares(self, config: TrackingConfig) -> float:
        """Return the variance of attenuation, (1/m)², by changes while frames fail to show it.

        Water that did not change before may do so now, and be why they fail: at a rate of its
        logarithm that nobody knows.
        """
        return (math.expm1(config.unseen_rate * self._interval) * self._scale()) ** 2

    def _scale(self) -> float:
        """Return the attenuation, 1/m, that a change of turbidity is a part of."""
        return max(float(self.mean[ATTENUATION][self.known].mean()), _LEAST_ATTENUATION)

    def accepts(
        self, measurement: Measurement, probability: float, drifting: bool = True
    ) -> bool:
        """Chi-squared gate: whether a measurement may be one of this state, drifting or not."""
        index = np.flatnonzero(np.repeat(self.known & measurement.seen, 2))
        if index.size == 0:
            return True
        block = np.ix_(index, index)
        spread = (
            self.covariance + self.common @ self.common.T + measurement.covariance)[block]
        if not drifting:
            spread -= self._drifted()[block]
        innovation = (measurement.value - self.mean)[index]
        distance = innovation @ np.linalg.solve(spread + _ridge(spread), innovation)
        return bool(distance <= chdtri(index.size, 1.0 - probability))

    def reject(self, measurement: Measurement, share: float) -> NDArray[np.float64]:
        """Return the variance by the chance that a rejected measurement is right.

        Parameters
        ----------
        measurement : Measurement
        share : float
            That chance, 0..1, for a small change; it falls as a change gets
            larger than the state itself, which water does not do in a moment.
        """
        self._end_interval()
        both = np.repeat(self.known & measurement.seen, 2)
        innovation = np.where(both, measurement.value - self.mean, 0.0)
        scale = np.tile((self._scale(), 1.0), 3)
        share /= 1.0 + np.max((innovation / scale) ** 2)
        return np.asarray(share * np.outer(innovation, innovation))

    def _end_interval(self) -> None:
        """Begin the time to the next measurement."""
        self._last_interval, self._interval = self._interval, 0.0
        self._gap, self._unawares = False, 0.0

    def adapt(self, measurement: Measurement, config: TrackingConfig) -> None:
        """Adapt the process noise to innovations that the state's covariance does not explain.

        They say so where this one surprises the state as it would be without its drift
        of late; and where the mean of late ones, which is about zero while the state
        keeps up with the water, is beyond what noise explains: that is by how much the
        state lags. The rate at which measurements change stays for the frames to come.

        Parameters
        ----------
        measurement : Measurement
            About to be taken in.
        config : TrackingConfig
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
        for part in (ATTENUATION, LIGHT):
            index = np.arange(6)[part][both]
            block = np.ix_(index, index)
            spread = (state + noise)[block]
            spread += _ridge(spread)
            self._trend[index] += _TREND_SHARE * (innovation[index] - self._trend[index])
            if changed:
                growth[block] = _growth(innovation[index], spread)
                needed[block] = _growth(innovation[index], spread - drifted[block])
            else:
                growth[block] = _beyond_noise(
                    self._trend[index], _TREND_VARIANCE * spread, _TREND_LIMIT)
        self.covariance += growth
        self._drift = (
            _DRIFT_KEPT * self._drift + (1.0 - _DRIFT_KEPT) * needed / self._interval**2
            + self._ramp(measurement, config.exposure_change)
        )

    def _ramp(self, measurement: Measurement, exposure_change: float) -> NDArray[np.float64]:
        """Take a measurement into the mean rate of change; return what shows of its square."""
        both = self.known & measurement.seen & self._last.seen
        change = (measurement.value - self._last.value) / self._unseen
        # All of the errors, since how much of them frames share is known badly.
        spread = 0.5 * (measurement.covariance + self._last.covariance)
        spread[LIGHT, LIGHT] += exposure_change**2
        spread *= _RATE_VARIANCE / self._unseen**2
        ramp = np.zeros((6, 6))
        for part in (ATTENUATION, LIGHT):
            index = np.arange(6)[part][both]
            if index.size > 0:
                block = np.ix_(index, index)
                self._rate[index] += _RATE_SHARE * (change[index] - self._rate[index])
                ramp[block] = _beyond_noise(
                    self._rate[index], spread[block] + _ridge(spread[block]), _RATE_LIMIT)
        return ramp

    def correct(self, measurement: Measurement) -> None:
        """Take a measurement in."""
        self._begin(measurement.seen & ~self.known, measurement)
        gain = self._gain(measurement)
        kept = np.eye(6) - gain
        self.mean = self.mean + gain @ (measurement.value - self.mean)
        # This form (Joseph's) holds for any gain, the best one or not.
        self.covariance = (
            kept @ self.covariance @ kept.T + gain @ measurement.noise @ gain.T
        )
        self.common = kept @ self.common + gain @ measurement.common
        self._age[measurement.seen] = 0.0
        self._last = measurement
        self._unseen = 0.0
        self._end_interval()

    def _own(self, measurement: Measurement) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Covariance of what the state and what a measurement has for itself, (6, 6) each.

        What is far larger in one of the errors that both have in common is its own: a sure
        frame stands above unsure ones.
        """
        state, noise = self.covariance.copy(), measurement.noise.copy()
        ours, theirs = (common @ common.T for common in (self.common, measurement.common))
        for part in (ATTENUATION, LIGHT):
            index = np.arange(6)[part][self.known & measurement.seen]
            block = np.ix_(index, index)
            state[block] += _excess(ours[block], theirs[block])
            noise[block] += _excess(theirs[block], ours[block])
        return state, noise

    def _gain(self, measurement: Measurement) -> NDArray[np.float64]:
        """Return the part of each innovation that is believed.

        Attenuation and light are each corrected by their own innovation only. The
        best gain would let one correct the other as far as their errors are
        correlated in a frame; but that correlation is known too badly, and would
        make errors of attenuation ones of depth.
        """
        gain = np.zeros((6, 6))
        state, noise = self._own(measurement)
        for part in (ATTENUATION, LIGHT):
            index = np.arange(6)[part][measurement.seen]
            block = np.ix_(index, index)
            spread = (state + noise)[block]
            gain[block] = np.linalg.solve(spread + _ridge(spread), state[block]).T
        return gain

    def _begin(self, new: NDArray[np.bool_], measurement: Measurement) -> None:
        """Take channels on that nothing is known of: any value is possible."""
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

    def published(
        self, doubt: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return β and I∞, interleaved, and their covariance with a doubt added."""
        mean = self.mean.copy()
        mean[ATTENUATION] = np.maximum(mean[ATTENUATION], ATTENUATION_BOUNDS[0])
        mean[LIGHT] = np.exp(mean[LIGHT])
        scale = np.ones(6)
        scale[LIGHT] = mean[LIGHT]
        covariance = self.covariance + self.common @ self.common.T + doubt
        return mean, np.outer(scale, scale) * covariance


def _excess(larger: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of a covariance that is far beyond another one, where it is."""
    values, vectors = np.linalg.eigh(larger - _FAR_LARGER**2 * other)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _growth(
    innovation: NDArray[np.float64], spread: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Growth of a covariance along an innovation that makes the innovation as long as expected."""
    distance = float(innovation @ np.linalg.solve(spread, innovation))
    expected = float(len(innovation))
    lack = 1.0 / expected - 1.0 / max(distance, expected)
    return np.asarray(lack * np.outer(innovation, innovation))


def _beyond_noise(
    mean: NDArray[np.float64], spread: NDArray[np.float64], limit: float
) -> NDArray[np.float64]:
    """Return the part of a mean's square that noise of a covariance is not."""
    degrees = len(mean)
    distance = float(mean @ np.linalg.solve(spread, mean))
    noise = degrees + limit * math.sqrt(2.0 * degrees)
    return np.asarray((1.0 - noise / max(distance, noise)) * np.outer(mean, mean))


def _ridge(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Diagonal jitter for a near-singular covariance."""
    return np.diag(1e-9 * np.diag(covariance) + 1e-15)
