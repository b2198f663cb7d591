# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Bayesian model of what a depth sensor says beyond the depth estimated from colour.

The difference of a right sensor and the estimate is

    the camera's constant (white balance, kind of water), which a dive keeps,
    + its slope over the camera's own depth (kind of water),
    + what wanders with the scene, an Ornstein-Uhlenbeck process,
    + what frame and sensor are uncertain by, each for itself;

a faulty sensor adds an offset that begins at any moment, of any size, and walks on. Both are Kalman
filters with what is not known of the wandering as hypotheses (Bar-Shalom, Li and Kirubarajan,
"Estimation with Applications to Tracking and Navigation", 2001, section 11.6,
doi:10.1002/0471221279). The evidence of a fault is the statistic of Shiryaev and Roberts, of which
the mean grows by one second a second while there is none, whatever is assumed of faults: the mean
time to a false alarm is at least the limit that it is held against (Pollak, Annals of Statistics
13, 1985, doi:10.1214/aos/1176346587).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Wander: standard deviation relative to the model's, and correlation times, s.
SIZE = 0.5
TIMES = (4.0, 16.0)
# Frames closer in time see the same scene and have the same error, s.
INTERVAL = 0.9
# Share of outlier frames, and among these the share of wild ones.
OUTLIERS = 0.05
# Standard deviation of a fault or a wild frame, m, and random walk of a fault: a decimetre in a few
# seconds, a metre in some minutes, m²/s.
FAULT = 10.0
WALK = 0.003
# Lower limits that keep logarithms finite: of time, s, and of a weight.
SHORTEST, LEAST_WEIGHT = 1e-6, 1e-12

CONSTANT, SLOPE, WANDER, OFFSET = range(4)


class InnovationModel:
    """Filters of the difference of sensor and estimate, without and with a fault of the sensor.

    Parameters
    ----------
    stddev : float
        Of what the estimate's own does not hold and is not constant, m.
    constant_stddev : float
        Of what is constant over a dive, beforehand, m.
    depth : float
        As the camera tells it at first, m.

    Attributes
    ----------
    stddev : float
        As given.
    evidence : float
        Of a fault, s; a right sensor reaches it once in so long on average at most.
    """

    def __init__(self, stddev: float, constant_stddev: float, depth: float) -> None:
        self.stddev = stddev
        self.evidence = 0.0
        self._times = np.array(TIMES)
        self._weights = np.full(len(TIMES), 1.0 / len(TIMES))
        self._wander = (SIZE * stddev) ** 2
        # Another water type scales depth; an estimate that does not follow depth has a slope of 1.
        slope_stddev = min(constant_stddev / max(depth, constant_stddev), 1.0)
        self._first = self._depth = depth
        covariance = np.diag((constant_stddev**2, slope_stddev**2, self._wander, 0.0))
        self._right = _Filter(np.zeros((len(TIMES), 4)), np.stack([covariance] * len(TIMES)))
        # The oldest first.
        self._faults: list[_Fault] = []

    @property
    def constant(self) -> tuple[float, float]:
        """Constant difference at the present depth, without wander, and its stddev, m."""
        means, covariances = self._right
        seen = self._seen(self._depth)
        seen[WANDER] = 0.0
        return _moments(self._weights, means @ seen, covariances @ seen @ seen)

    def predict(self, elapsed: float, depth: float, variance: float) -> tuple[float, float]:
        """Predict the next difference.

        Parameters
        ----------
        elapsed : float
            Since the last one taken, s.
        depth : float
            As the camera tells it, m.
        variance : float
            Of frame and sensor, m².

        Returns
        -------
        mean, stddev : float
            Of the difference of a right sensor, m. Wild frames are beyond it.
        """
        means, covariances = self._right.predict(self._kept(elapsed), self._wander, 0.0)
        seen = self._seen(self._smoothed(elapsed, depth))
        variances = covariances @ seen @ seen + variance + self.stddev**2
        return _moments(self._weights, means @ seen, variances)

    def update(
        self, elapsed: float, depth: float, difference: float, variance: float, most: float
    ) -> None:
        """Take a difference.

        Parameters
        ----------
        elapsed, depth, variance : float
            See `predict`.
        difference : float
            Of sensor and estimate, m.
        most : float
            The evidence is no more than this, s, so that a sensor that recovers is believed.
        """
        self._depth = self._smoothed(elapsed, depth)
        kept = self._kept(elapsed)
        taken = self._seen(self._depth), difference, variance, self.stddev
        right, log_right = self._right.predict(kept, self._wander, 0.0).update(*taken)
        begun, log_begun = self._right.predict(kept, self._wander, FAULT**2).update(*taken)
        faults = [fault.update(kept, self._wander, WALK * elapsed, taken)
                  for fault in self._faults]
        # In logarithms: densities of outliers underflow.
        log_begun += np.log(max(elapsed, SHORTEST) * self._weights)
        log_right += np.log(self._weights)
        self._right = right
        self._faults = _thinned([*faults, _Fault(1, begun, log_begun)])
        total = float(np.logaddexp.reduce([fault.log_evidence for fault in self._faults], None))
        log_right_total = float(np.logaddexp.reduce(log_right))
        log_evidence = min(total - log_right_total, math.log(most))
        self._faults = [
            fault._replace(log_evidence=fault.log_evidence + (log_evidence - total))
            for fault in self._faults]
        self.evidence = math.exp(log_evidence)
        weights = np.exp(log_right - log_right.max())
        # The wander's correlation time may change later.
        self._weights = np.maximum(weights / weights.sum(), LEAST_WEIGHT)

    def _kept(self, elapsed: float) -> Array:
        return np.exp(-elapsed / self._times)

    def _smoothed(self, elapsed: float, depth: float) -> float:
        # Smoothed: a frame's own error is not depth.
        return depth + math.exp(-elapsed / TIMES[-1]) * (self._depth - depth)

    def _seen(self, depth: float) -> Array:
        """Observation row of the difference at a depth by the camera, m."""
        return np.array((1.0, depth - self._first, 1.0, 1.0))


class _Filter(NamedTuple):
    """Mean (J, 4) and covariance (J, 4, 4) of constant, slope, wander, offset by hypothesis."""

    means: Array
    covariances: Array

    def predict(self, kept: Array, wander: float, walk: float) -> _Filter:
        """Predict: the wander decays by `kept`, and the offset walks."""
        keep = np.ones_like(self.means)
        keep[:, WANDER] = kept
        covariances = self.covariances * keep[:, :, np.newaxis] * keep[:, np.newaxis]
        covariances[:, WANDER, WANDER] += wander * (1.0 - kept**2)
        covariances[:, OFFSET, OFFSET] += walk
        return _Filter(self.means * keep, covariances)

    def update(
        self, seen: Array, difference: float, variance: float, stddev: float
    ) -> tuple[_Filter, Array]:
        """Update by the probability that the difference is no outlier; also log density."""
        residuals = difference - self.means @ seen
        cross = self.covariances @ seen
        variances = cross @ seen + variance
        usual = math.log(1.0 - OUTLIERS) + _log_density(residuals, variances)
        # Outliers together add the model's variance on average.
        off = math.log(OUTLIERS) + _log_density(residuals, variances + stddev**2 / OUTLIERS)
        wild = 2.0 * math.log(OUTLIERS) + _log_density(residuals, variances + FAULT**2)
        log_density = np.logaddexp(np.logaddexp(usual, off), wild)
        taken = np.exp(usual - log_density)
        gain = cross / variances[:, np.newaxis]
        step = gain * residuals[:, np.newaxis]
        covariances = (
            self.covariances - _scale(taken, _outer(gain, cross))
            + _scale(taken * (1.0 - taken), _outer(step, step)))
        return _Filter(self.means + taken[:, np.newaxis] * step, covariances), log_density


class _Fault(NamedTuple):
    """Faults that began at so many neighbouring differences, with their evidence, ln s, (J,)."""

    onsets: int
    filter: _Filter
    log_evidence: Array

    def update(
        self, kept: Array, wander: float, walk: float,
        taken: tuple[Array, float, float, float],
    ) -> _Fault:
        """Predict, and take a difference."""
        updated, log_density = self.filter.predict(kept, wander, walk).update(*taken)
        return _Fault(self.onsets, updated, self.log_evidence + log_density)


def _thinned(faults: list[_Fault]) -> list[_Fault]:
    """Merge neighbours, so that there are two of each power of two of onsets at most."""
    onsets = 1
    while sum(fault.onsets == onsets for fault in faults) > 2:
        at = next(k for k, fault in enumerate(faults) if fault.onsets == onsets)
        one, other = faults[at:at + 2]
        log_evidence = np.logaddexp(one.log_evidence, other.log_evidence)
        share = np.exp(one.log_evidence - log_evidence)
        faults[at:at + 2] = [
            _Fault(2 * onsets, _merge(one.filter, other.filter, share), log_evidence)]
        onsets *= 2
    return faults


def _merge(one: _Filter, other: _Filter, share: Array) -> _Filter:
    """Merge two Gaussian mixtures by moments; the first one has weight `share`."""
    apart = one.means - other.means
    return _Filter(
        other.means + share[:, np.newaxis] * apart,
        _scale(share, one.covariances) + _scale(1.0 - share, other.covariances)
        + _scale(share * (1.0 - share), _outer(apart, apart)))


def _moments(weights: Array, means: Array, variances: Array) -> tuple[float, float]:
    """Mean and standard deviation of a mixture."""
    mean = float(weights @ means) / float(weights.sum())
    spread = float(weights @ (variances + (means - mean) ** 2)) / float(weights.sum())
    return mean, math.sqrt(spread)


def _log_density(residuals: Array, variances: Array) -> Array:
    return np.asarray(-0.5 * (residuals**2 / variances + np.log(2.0 * math.pi * variances)))


def _outer(one: Array, other: Array) -> Array:
    return one[:, :, np.newaxis] * other[:, np.newaxis]


def _scale(share: Array, matrices: Array) -> Array:
    return share[:, np.newaxis, np.newaxis] * matrices
