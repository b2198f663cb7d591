# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Recursion over frames: a Kalman filter of the water's state.

The state is attenuation and the logarithm of ambient light in each channel. In
the time between frames turbidity wanders, mostly alike in all channels, and the
colour of light wanders. The camera's exposure may be any other one in each frame:
a log gain common to the channels. It needs no state of its own: being forgotten
from frame to frame, it is process noise along the one direction in which the
three ambient lights change together, so that a jump leaves attenuation and
chromaticity alone.

A part of a frame's error stays the same over frames, since they show the same
scene; averaging does not lessen it. It is carried along as a consider parameter
(Schmidt 1966): it has no influence on the filter's gain, and a full one on the
standard deviations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.quantiles import chi_squared_quantile
from uw_visibility.config.schema import TrackingConfig
from uw_visibility.errors import InputError
from uw_visibility.status import Status
from uw_visibility.water.assessment import joint_covariance
from uw_visibility.water.estimation import WaterEstimate
from uw_visibility.water.fit import ATTENUATION_BOUNDS

# How much of a change of turbidity a single channel has for itself.
_CHANNEL_SHARE = 0.5
# Attenuation, 1/m, below which its changes are no longer proportional to it.
_LEAST_ATTENUATION = 0.1
# Innovations of attenuation are averaged over about 1 / this many frames; where the
# average is beyond so many of its standard deviations, the water has changed.
_TREND_SHARE = 0.3
_TREND_LIMIT = 2.0
_ATTENUATION = slice(0, 6, 2)
_LIGHT = slice(1, 6, 2)


class TrackingEvent(Enum):
    """What a frame did to the state."""

    STARTED = "started"
    UPDATED = "updated"
    OUTLIER = "outlier"
    RESTARTED = "restarted"
    PREDICTED = "predicted"
    NOT_ASSESSABLE = "not assessable"

    def __str__(self) -> str:
        return self.value


class WaterTracker:
    """Filters estimates of the water's state over time.

    Parameters
    ----------
    config : TrackingConfig

    Attributes
    ----------
    event : TrackingEvent or None
        What the last frame did; None before the first.
    estimate : WaterEstimate or None
        The filtered state after the last frame; None before the first.
    """

    def __init__(self, config: TrackingConfig | None = None) -> None:
        self._config = config or TrackingConfig()
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.event: TrackingEvent | None = None
        self.estimate: WaterEstimate | None = None
        self._state: _State | None = None
        # Grows from measurements that the state's gate refuses; takes its place
        # when enough of them in a row agree with one another.
        self._candidate: _State | None = None
        self._stamp = -math.inf

    def update(self, estimate: WaterEstimate, stamp_seconds: float) -> WaterEstimate:
        """Take in one frame's estimate.

        Parameters
        ----------
        estimate : WaterEstimate
            Of this frame alone. A channel that is not assessable is predicted.
        stamp_seconds : float
            Time of the frame, s. A stamp that is not later than the last one, or
            later by more than the timeout, begins anew.

        Returns
        -------
        WaterEstimate
            The filtered state. A channel is not assessable, for the reason that
            its frame gives, when nothing was seen of it for longer than the
            timeout; `envelope`, `bins` and `iterations` are the frame's.

        Raises
        ------
        InputError
            If the stamp is not finite.
        """
        if not math.isfinite(stamp_seconds):
            raise InputError(f"the stamp of the frame is {stamp_seconds}: give a time in seconds")
        elapsed = stamp_seconds - self._stamp
        if not 0.0 < elapsed <= self._config.timeout:
            self.reset()
        self._stamp = stamp_seconds
        measurement = _Measurement.of(estimate, self._config.common_error)
        self._predict(elapsed)
        self.event = self._correct(measurement)
        self.estimate = self._filtered(estimate)
        return self.estimate

    def _predict(self, elapsed: float) -> None:
        for state in (self._state, self._candidate):
            if state is not None:
                state.predict(elapsed, self._config)
        if self._candidate is not None and not self._candidate.known.any():
            self._candidate = None
        if self._state is not None and not self._state.known.any():
            self._state, self._candidate = self._candidate, None

    def _correct(self, measurement: _Measurement) -> TrackingEvent:
        if not measurement.seen.any():
            return TrackingEvent.NOT_ASSESSABLE if self._state is None else TrackingEvent.PREDICTED
        if self._state is None:
            self._state = _State(measurement)
            return TrackingEvent.STARTED
        if self._state.accepts(measurement, self._config.gate_probability):
            self._state.correct(measurement)
            self._candidate = None
            return TrackingEvent.UPDATED
        candidate = self._candidate
        if candidate is None or not candidate.accepts(measurement, self._config.gate_probability):
            candidate = _State(measurement)
        else:
            candidate.correct(measurement)
        self._candidate = candidate
        if candidate.count < self._config.reset_count:
            return TrackingEvent.OUTLIER
        self._state, self._candidate = candidate, None
        return TrackingEvent.RESTARTED

    def _filtered(self, estimate: WaterEstimate) -> WaterEstimate:
        if self._state is None:
            return estimate
        known = self._state.known
        status = tuple(
            Status.OK if known[c] else estimate.channel_status[c] for c in range(3)
        )
        mean, joint = self._state.published()
        absent = np.repeat(~known, 2)
        mean[absent] = np.nan
        joint[absent, :] = np.nan
        joint[:, absent] = np.nan
        return WaterEstimate(
            status=next((reason for reason in status if reason is not Status.OK), Status.OK),
            attenuation=mean[_ATTENUATION],
            ambient_light=mean[_LIGHT],
            covariance=np.stack([joint[2 * c:2 * c + 2, 2 * c:2 * c + 2] for c in range(3)]),
            iterations=estimate.iterations,
            bins=estimate.bins,
            channel_status=(status[0], status[1], status[2]),
            envelope=estimate.envelope,
            joint_covariance=joint,
        )


@dataclass(frozen=True)
class _Measurement:
    """A frame's estimate: β and ln I∞ of each channel, and the two parts of its error.

    Attributes
    ----------
    seen : (3,) bool ndarray
        Channels that were assessed.
    value : (6,) float64 ndarray
    noise : (6, 6) float64 ndarray
        Covariance of what is new in each frame.
    common : (6, 6) float64 ndarray
        Root of the covariance of what stays the same.
    """

    seen: NDArray[np.bool_]
    value: NDArray[np.float64]
    noise: NDArray[np.float64]
    common: NDArray[np.float64]

    @classmethod
    def of(cls, estimate: WaterEstimate, common_error: float) -> _Measurement:
        """Take an estimate; ``common_error`` is the part of its variance that stays."""
        joint = joint_covariance(estimate)
        seen = np.isfinite(estimate.attenuation) & np.isfinite(estimate.ambient_light)
        seen &= np.isfinite(np.diag(joint)).reshape(3, 2).all(axis=1)
        index = np.flatnonzero(np.repeat(seen, 2))
        value = np.zeros(6)
        value[_ATTENUATION] = np.where(seen, estimate.attenuation, 0.0)
        light = np.where(seen, estimate.ambient_light, 1.0)
        value[_LIGHT] = np.log(light)
        scale = np.ones(6)
        scale[_LIGHT] = 1.0 / light
        covariance = np.zeros((6, 6))
        covariance[np.ix_(index, index)] = (np.outer(scale, scale) * joint)[np.ix_(index, index)]
        return cls(
            seen, value, (1.0 - common_error) * covariance, _root(common_error * covariance)
        )


class _State:
    """Mean and covariance of β and ln I∞, and how long each channel was not seen."""

    def __init__(self, measurement: _Measurement) -> None:
        self.mean = measurement.value.copy()
        self.covariance = measurement.noise.copy()
        # Effect of the errors that all frames have in common.
        self.common = measurement.common.copy()
        self.known = measurement.seen.copy()
        self.count = 1
        self._age = np.zeros(3)
        self._trend = 0.0

    def predict(self, elapsed: float, config: TrackingConfig) -> None:
        """Let time pass (s): what is known becomes less so."""
        attenuation = self.mean[_ATTENUATION][self.known].mean()
        turbidity = config.turbidity_rate**2 * max(attenuation, _LEAST_ATTENUATION) ** 2 * elapsed
        self.covariance[_ATTENUATION, _ATTENUATION] += turbidity * (
            1.0 - _CHANNEL_SHARE**2 + _CHANNEL_SHARE**2 * np.eye(3)
        )
        colour = config.light_rate**2 * elapsed
        self.covariance[_LIGHT, _LIGHT] += config.exposure_change**2 + colour * np.eye(3)
        self._age += elapsed
        self.known &= self._age <= config.timeout

    def accepts(self, measurement: _Measurement, probability: float) -> bool:
        """Tell whether a measurement may well be one of this state."""
        index = np.flatnonzero(np.repeat(self.known & measurement.seen, 2))
        if index.size == 0:
            return True
        block = np.ix_(index, index)
        spread = (
            self.covariance + measurement.noise
            + self.common @ self.common.T + measurement.common @ measurement.common.T
        )[block]
        innovation = (measurement.value - self.mean)[index]
        distance = innovation @ np.linalg.solve(spread + _ridge(spread), innovation)
        return bool(distance <= chi_squared_quantile(index.size, probability))

    def correct(self, measurement: _Measurement) -> None:
        """Take a measurement in."""
        self._begin(measurement.seen & ~self.known, measurement)
        self._follow_trend(measurement)
        gain = self._gain(measurement)
        kept = np.eye(6) - gain
        self.mean = self.mean + gain @ (measurement.value - self.mean)
        # This form (Joseph's) holds for any gain, the best one or not.
        self.covariance = (
            kept @ self.covariance @ kept.T + gain @ measurement.noise @ gain.T
        )
        self.common = kept @ self.common + gain @ measurement.common
        self._age[measurement.seen] = 0.0
        self.count += 1

    def _follow_trend(self, measurement: _Measurement) -> None:
        """Let the state go as far as innovations of one sign say that the water went.

        A step too small for the gate would else be followed at the pace of a slow
        wander, which depends on the rate of frames.
        """
        index = np.arange(6)[_ATTENUATION][measurement.seen]
        block = np.ix_(index, index)
        innovation = float((measurement.value - self.mean)[index].mean())
        variance = float((self.covariance + measurement.noise)[block].mean()) + 1e-15
        self._trend += _TREND_SHARE * (innovation / math.sqrt(variance) - self._trend)
        if self._trend**2 > _TREND_LIMIT**2 * _TREND_SHARE / (2.0 - _TREND_SHARE):
            self.covariance[_ATTENUATION, _ATTENUATION] += max(innovation**2 - variance, 0.0)

    def _gain(self, measurement: _Measurement) -> NDArray[np.float64]:
        """Return the part of each innovation that is believed.

        Attenuation and light are each corrected by their own innovation only. The
        best gain would let one correct the other as far as their errors are
        correlated in a frame; but that correlation is known too badly, and would
        make errors of attenuation ones of depth.
        """
        gain = np.zeros((6, 6))
        for part in (_ATTENUATION, _LIGHT):
            index = np.arange(6)[part][measurement.seen]
            block = np.ix_(index, index)
            spread = self.covariance[block] + measurement.noise[block]
            gain[block] = np.linalg.solve(spread + _ridge(spread), self.covariance[block]).T
        return gain

    def _begin(self, new: NDArray[np.bool_], measurement: _Measurement) -> None:
        """Take channels on that nothing is known of: any value is possible."""
        for channel in np.flatnonzero(new):
            block = slice(2 * channel, 2 * channel + 2)
            self.mean[block] = measurement.value[block]
            self.covariance[block, :] = 0.0
            self.covariance[:, block] = 0.0
            self.covariance[block, block] = 1e6 * measurement.noise[block, block]
            self.common[block] = measurement.common[block]
            self.known[channel] = True

    def published(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return β and I∞, interleaved, and their covariance."""
        mean = self.mean.copy()
        mean[_ATTENUATION] = np.maximum(mean[_ATTENUATION], ATTENUATION_BOUNDS[0])
        mean[_LIGHT] = np.exp(mean[_LIGHT])
        scale = np.ones(6)
        scale[_LIGHT] = mean[_LIGHT]
        covariance = self.covariance + self.common @ self.common.T
        return mean, np.outer(scale, scale) * covariance


def _root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the symmetric root of a covariance, which changes little when that does."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _ridge(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what makes a covariance regular and changes nothing else."""
    return np.diag(1e-9 * np.diag(covariance) + 1e-15)
