# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bayesian model of the difference between a depth sensor and the depth estimated from colour.

The difference between a correct sensor and the estimate is

    the camera's constant (white balance, type of water), which is the same during a dive,
    + its slope over the camera's own depth (type of water),
    + errors that vary slowly, two Ornstein-Uhlenbeck processes: with the scene, in proportion to
      the frame's own standard deviation and in bursts, and with the water,
    + independent errors of frames and sensor;

a faulty sensor adds an offset that begins at any time, by a jump of the sensor's own depth or from
zero, with a drift and a random walk. Both are Kalman filters, with hypotheses of how restless a
dive is (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation",
2001, section 11.6, doi:10.1002/0471221279). The evidence of a fault is the Shiryaev-Roberts
statistic. Without a fault its mean grows by one second per second, whatever is assumed of faults:
the mean time to a false alarm is at least the threshold of the evidence (Pollak, Annals of
Statistics 13, 1985, doi:10.1214/aos/1176346587).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

from uw_visibility.plausibility.comparison import DepthSample

Array = NDArray[np.float64]


class Camera(NamedTuple):
    """Errors of a camera's depths beyond their own variance; sizes are standard deviations."""

    # constant, slope: of the dive's constant and its slope, relative to the first estimate's own
    # for the constant
    constant: float
    slope: float
    fast: float  # of the error that varies with the scene, relative to a frame's own
    # fast_time, slow_time: correlation times of the errors with the scene and with the water, s
    fast_time: float
    # of the error that varies with the water, relative to the first estimate's for the constant
    slow: float
    slow_time: float
    # rate of bursts of error by the scene, 1/s; they decay as the error that varies with it
    bursts: float
    burst: float  # size of a burst, relative to `PlausibilityConfig.model_stddev`
    outliers: float  # share of frames that are outliers
    outlier: float  # size of an outlier, relative to `PlausibilityConfig.model_stddev`
    # factor by which varying errors, bursts and outliers are larger in a restless dive than in a
    # usual one, and smaller in a calm one
    spread: float


CAMERA = Camera(
    constant=0.82, slope=0.99, fast=0.41, fast_time=1.6, slow=0.11, slow_time=200.0,
    bursts=0.049, burst=3.6, outliers=0.12, outlier=1.9, spread=1.6)
"""Fitted by ``python -m uw_visibility_lab.evaluation.plausibility``."""

# Powers of `Camera.spread`: a calm, a usual and a restless dive.
SCALES = (-1.0, 0.0, 1.0)
# Frames closer in time see the same scene and have the same error, s.
INTERVAL = 0.9
# Standard deviation of a fault or a wild value, m: any depth of a sensor; and the share of wild
# values, one in ten minutes.
FAULT, WILD = 10.0, 1.0 / 600.0
# Share of faults that begin with a jump; the others drift from zero.
JUMPS = 0.5
# Standard deviation of the vehicle's vertical speed, m/s: the jump of a fault is the change of the
# sensor minus this motion.
MOTION = 0.5
# Standard deviation of a fault's drift, m/s, and its random walk, m²/s: a metre in some minutes.
DRIFTING, WALK = 1.0 / 60.0, 0.001
# Time constant by which the camera's own depth is smoothed, s, against errors of single frames.
SMOOTHED = 16.0
# Lower limits that keep logarithms finite: of time, s, and of a weight.
SHORTEST, LEAST_WEIGHT = 1e-6, 1e-12
# Relative tolerance of a gate.
PRECISE = 1e-6

CONSTANT, SLOPE, FAST, SLOW, OFFSET, DRIFT = range(6)
STATES = 6
# Row of the observation: the states whose sum is the difference.
SEEN = np.array((1.0, 0.0, 1.0, 1.0, 1.0, 0.0))


class Taken(NamedTuple):
    """Conditions of one difference."""

    elapsed: float  # since the last update, s
    depth: float  # estimated by the camera, m
    # variance, sensor_variance: of the estimate's errors that differ between frames, and of the
    # sensor, m²
    variance: float
    sensor_variance: float
    # change of the sensor's depth since the last update, m; NaN if unknown
    sensor_change: float = math.nan


class RightSensor:
    """Filter of the difference between a correct sensor and the estimate.

    estimate: the first one of a dive that is compared.
    stddev: of varying errors that the estimate's own does not include, m.
    """

    def __init__(self, estimate: DepthSample, stddev: float, camera: Camera) -> None:
        self.stddev = stddev
        # The constant is at least as uncertain as the rest.
        constant_stddev = max(math.sqrt(estimate.constant_variance), stddev)
        depth = self._depth = estimate.depth
        scales = np.square(camera.spread ** np.array(SCALES))
        self._rate, self._outliers = camera.bursts, camera.outliers
        self._burst = (camera.burst * stddev) ** 2 * scales
        self._outlier = (camera.outlier * stddev) ** 2 * scales
        self._fast = camera.fast**2 * scales
        self._slow = (camera.slow * constant_stddev) ** 2 * scales
        self._times = np.array((camera.fast_time, camera.slow_time))
        # Another water type scales depth, so its prior error is proportional to depth.
        slope = (camera.slope * constant_stddev / max(depth, constant_stddev)) ** 2
        covariance = np.zeros((len(SCALES), STATES, STATES))
        covariance[:, CONSTANT, CONSTANT] = (
            (camera.constant * constant_stddev) ** 2 + slope * depth**2)
        covariance[:, CONSTANT, SLOPE] = covariance[:, SLOPE, CONSTANT] = slope * depth
        covariance[:, SLOPE, SLOPE] = slope
        covariance[:, SLOW, SLOW] = self._slow
        self.filter = Filter(np.zeros((len(SCALES), STATES)), covariance)
        self.weights = np.full(len(SCALES), 1.0 / len(SCALES))

    @property
    def constant(self) -> tuple[float, float]:
        """Constant difference at the present depth, and its standard deviation, m."""
        means, covariances = self.filter
        return _moments(self.weights, means[:, CONSTANT], covariances[:, CONSTANT, CONSTANT])

    def predict(self, taken: Taken, confidence: float) -> tuple[float, float]:
        """Predict a difference.

        Returns `mean, gate`, m: the mean, and the distance from it within which the difference of a
        correct sensor is with probability `confidence`.
        """
        means, covariances = self.filter.predict(*self.motion(taken))
        variances = covariances @ SEEN @ SEEN + taken.sensor_variance
        expected = means @ SEEN
        mean, _ = _moments(self.weights, expected, variances)
        kinds = self.observe(taken)
        stddevs = np.sqrt(variances + kinds.burst + kinds.apart)
        weights = kinds.shares[:, np.newaxis] * self.weights
        return mean, _gate(weights, expected - mean, stddevs, confidence)

    def observe(self, taken: Taken, difference: float = math.nan) -> Observation:
        """Return the distribution of a difference: usual, start of a burst, outlier, wild value."""
        bursts = -math.expm1(-self._rate * taken.elapsed)
        alone = (1.0 - WILD) * self._outliers
        others = 1.0 - WILD - alone
        none = np.zeros_like(self._burst)
        return Observation(
            difference, taken.sensor_variance,
            np.array((others * (1.0 - bursts), others * bursts, alone, WILD)),
            np.stack([none, self._burst, none, none]),
            np.stack([none, none, self._outlier, np.full_like(none, FAULT**2)]))

    def update(self, taken: Taken, ahead: Filter, observation: Observation) -> float:
        """Update the predicted filter `ahead` with a difference; return its log density."""
        self._depth = self._smoothed(taken.elapsed, taken.depth)
        self.filter, log_densities = ahead.update(observation)
        log_weights = np.log(self.weights) + log_densities
        log_density = float(np.logaddexp.reduce(log_weights))
        # All hypotheses keep some weight, since a dive may become restless later.
        weights = np.maximum(np.exp(log_weights - log_density), LEAST_WEIGHT)
        self.weights = weights / weights.sum()
        return log_density

    def motion(self, taken: Taken) -> tuple[Array, Array]:
        """Return the transition matrix of the states since the last update, and its covariance."""
        kept = np.exp(-taken.elapsed / self._times)
        deeper = self._smoothed(taken.elapsed, taken.depth) - self._depth
        transition = np.eye(STATES)
        transition[CONSTANT, SLOPE] = deeper
        transition[[FAST, SLOW], [FAST, SLOW]] = kept
        added = np.zeros((len(SCALES), STATES, STATES))
        wander = np.stack([self._fast * taken.variance, self._slow], axis=-1)
        added[:, [FAST, SLOW], [FAST, SLOW]] = wander * (1.0 - kept**2)
        return transition, added

    def _smoothed(self, elapsed: float, depth: float) -> float:
        return depth + math.exp(-elapsed / SMOOTHED) * (self._depth - depth)


class InnovationModel:
    """Evidence of a fault of the sensor, by filters without and with a fault.

    right: filter without a fault.
    evidence: of a fault, s; the mean time until a correct sensor reaches it is at least this.
    """

    def __init__(self, right: RightSensor) -> None:
        self.right = right
        self.evidence = 0.0
        # The oldest first.
        self._faults: list[Fault] = []

    def update(self, taken: Taken, difference: float, most: float) -> None:
        """Update evidence and filters with a difference.

        difference: sensor minus estimate, m.
        most: limit of the evidence, s, so that a sensor that recovers is trusted again.
        """
        right = self.right
        transition, added = right.motion(taken)
        ahead = right.filter.predict(transition, added)
        observation = right.observe(taken, difference)
        begun, log_begun = _fault_from(ahead, taken, observation)
        # Logarithms, since densities of outliers underflow.
        log_begun = log_begun + np.log(max(taken.elapsed, SHORTEST) * right.weights)
        log_right = right.update(taken, ahead, observation)
        transition[OFFSET, DRIFT] = taken.elapsed
        added[:, OFFSET, OFFSET] = WALK * taken.elapsed
        faults = _updated(self._faults, transition, added, observation)
        faults.append(Fault(1, begun, log_begun))
        _merge(faults)
        total = float(np.logaddexp.reduce([fault.log_evidence for fault in faults], None))
        log_evidence = min(total - log_right, math.log(most))
        self._faults = [
            fault._replace(log_evidence=fault.log_evidence + (log_evidence - total))
            for fault in faults
        ]
        self.evidence = math.exp(log_evidence)


class Observation(NamedTuple):
    """A difference, the sensor's variance, and the kinds of frames that it may be of.

    `shares` (K,) are the probabilities of the kinds. Each adds to variances, m², (K, J): `burst` to
    that of the error that varies with the scene, `apart` to that of the frame alone.
    """

    difference: float
    variance: float
    shares: Array
    burst: Array
    apart: Array


class Filter(NamedTuple):
    """Means (..., J, STATES) and covariances (..., J, STATES, STATES) by hypothesis."""

    means: Array
    covariances: Array

    def predict(self, transition: Array, added: Array) -> Filter:
        """Predict by a transition matrix and an added covariance."""
        return Filter(
            self.means @ transition.T,
            transition @ self.covariances @ transition.T + added)

    def update(self, observation: Observation) -> tuple[Filter, Array]:
        """Update with the mixture of kinds of frames; also return its log density (..., J)."""
        difference, variance, shares, bursts, aparts = observation
        residuals = difference - self.means @ SEEN
        cross = self.covariances @ SEEN
        variances = cross @ SEEN + variance
        parts, log_densities = [], []
        for share, burst, apart in zip(shares, bursts, aparts, strict=True):
            crossed = cross.copy()
            crossed[..., FAST] += burst
            total = variances + burst + apart
            gain = crossed / total[..., np.newaxis]
            covariances = self.covariances - _outer(gain, crossed)
            covariances[..., FAST, FAST] += burst
            parts.append(Filter(self.means + gain * residuals[..., np.newaxis], covariances))
            log_density = -0.5 * (residuals**2 / total + np.log(2.0 * math.pi * total))
            log_densities.append(math.log(max(share, LEAST_WEIGHT)) + log_density)
        return _mixed(parts, log_densities)


def _fault_from(ahead: Filter, taken: Taken, observation: Observation) -> tuple[Filter, Array]:
    """Return the filter of a fault that begins with a difference, and its log density.

    The change of the sensor is a condition, not evidence. Only the difference is evidence, so that
    the mean of the evidence does not depend on the vehicle's motion.
    """
    parts, log_densities = [], []
    for share, mean, variance in _onsets(taken):
        means, covariances = ahead.means.copy(), ahead.covariances.copy()
        means[:, OFFSET] = mean
        covariances[:, OFFSET, OFFSET] = variance
        covariances[:, DRIFT, DRIFT] = DRIFTING**2
        part, log_density = Filter(means, covariances).update(observation)
        parts.append(part)
        log_densities.append(math.log(share) + log_density)
    return _mixed(parts, log_densities)


def _onsets(taken: Taken) -> list[tuple[float, float, float]]:
    """Return probabilities, means, m, and variances, m², of the first offset of a fault."""
    if not math.isfinite(taken.sensor_change):
        return [(1.0 - JUMPS, 0.0, 0.0), (JUMPS, 0.0, FAULT**2)]
    moved = (MOTION * taken.elapsed) ** 2 + 2.0 * taken.sensor_variance
    return [
        (1.0 - JUMPS, 0.0, 0.0),
        (JUMPS * (1.0 - WILD), taken.sensor_change, min(moved, FAULT**2)),
        (JUMPS * WILD, 0.0, FAULT**2),
    ]


class Fault(NamedTuple):
    """Fault that began at one of `onsets` successive differences.

    `log_evidence` is the logarithm of its evidence, s, (J,).
    """

    onsets: int
    filter: Filter
    log_evidence: Array


def _updated(
    faults: Sequence[Fault], transition: Array, added: Array, observation: Observation
) -> list[Fault]:
    """Predict faults, and update them with a difference."""
    if not faults:
        return []
    ahead = _stacked([fault.filter for fault in faults]).predict(transition, added)
    updated, log_densities = ahead.update(observation)
    return [
        Fault(fault.onsets, Filter(means, covariances), fault.log_evidence + log_density)
        for fault, means, covariances, log_density in zip(
            faults, *updated, log_densities, strict=True)
    ]


def _merge(faults: list[Fault]) -> None:
    """Merge the oldest faults, until at most two have the same number of onsets."""
    onsets = 1
    while sum(fault.onsets == onsets for fault in faults) > 2:
        at = next(k for k, fault in enumerate(faults) if fault.onsets == onsets)
        two = faults[at:at + 2]
        onsets *= 2
        merged = _mixed(
            [fault.filter for fault in two], [fault.log_evidence for fault in two])
        faults[at:at + 2] = [Fault(onsets, *merged)]


def _stacked(parts: Sequence[Filter]) -> Filter:
    return Filter(
        np.stack([part.means for part in parts]), np.stack([part.covariances for part in parts]))


def _mixed(parts: Sequence[Filter], log_weights: Sequence[Array]) -> tuple[Filter, Array]:
    """Merge Gaussian mixtures by moments; also return the logarithm of their total weight."""
    log_total = np.logaddexp.reduce(log_weights)
    shares = np.exp(log_weights - log_total)
    means, covariances = _stacked(parts)
    mean = (shares[..., np.newaxis] * means).sum(axis=0)
    apart = means - mean
    covariances = covariances + _outer(apart, apart)
    covariances = (shares[..., np.newaxis, np.newaxis] * covariances).sum(axis=0)
    return Filter(mean, covariances), log_total


def _gate(weights: Array, means: Array, stddevs: Array, confidence: float) -> float:
    """Return the distance from zero within which a Gaussian mixture is with a probability."""
    weights = weights / weights.sum()

    def lacking(gate: float) -> float:
        within = ndtr((gate - means) / stddevs) - ndtr((-gate - means) / stddevs)
        return confidence - float((weights * within).sum())

    return float(brentq(lacking, 0.0, float((np.abs(means) + 9.0 * stddevs).max()), rtol=PRECISE))


def _moments(weights: Array, means: Array, variances: Array) -> tuple[float, float]:
    """Mean and standard deviation of a mixture."""
    mean = float(weights @ means)
    return mean, math.sqrt(float(weights @ (variances + (means - mean) ** 2)))


def _outer(one: Array, other: Array) -> Array:
    return one[..., :, np.newaxis] * other[..., np.newaxis, :]
