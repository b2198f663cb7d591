# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Innovation test (NIS) of a depth sensor against the depth estimated from colour.

The test is the one of a filter's consistency: the innovation ν, its variance S
and the normalised innovation squared ν²/S against the χ² distribution with one
degree of freedom (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications
to Tracking and Navigation", 2001, section 5.4, doi:10.1002/0471221279).
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from scipy.special import chdtri

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.comparison import (
    Comparison,
    DepthSample,
    Report,
    Verdict,
    interpolate,
)
from uw_visibility.status import Status

# Memory is bounded whatever arrives: 10 s of a sensor at 200 Hz.
SENSOR_SAMPLES = 2000
WAITING_ESTIMATES = 100

# A stamp that is older than the newest by more than this is a new recording.
RESTART_NANOSECONDS = 1_000_000_000


class DepthMonitor:
    """Innovation test of a depth sensor, with a verdict over runs of comparisons.

    An estimate waits until the sensor's values enclose its stamp. Times of
    arrival are of any clock that only goes forward, and tell what is stale.

    Parameters
    ----------
    config : PlausibilityConfig

    Attributes
    ----------
    config : PlausibilityConfig
        May be replaced at any time.
    """

    def __init__(self, config: PlausibilityConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget everything, the learned bias too."""
        self._samples: deque[DepthSample] = deque(maxlen=SENSOR_SAMPLES)
        self._waiting: deque[DepthSample] = deque(maxlen=WAITING_ESTIMATES)
        self._differences: list[tuple[float, float]] = []
        self._status = Status.OK
        self._last: Comparison | None = None
        self._sensor_arrival = self._estimate_arrival = -math.inf
        self._compared_arrival = self._conclusive_arrival = -math.inf
        self._compared = self._failed = self._inconclusive = 0
        self._unmatched = self._consecutive = 0

    def add_sensor(self, sample: DepthSample, arrival: float) -> list[Comparison]:
        """Take a value of the sensor.

        Parameters
        ----------
        sample : DepthSample
            Finite.
        arrival : float
            Time of arrival, s.

        Returns
        -------
        list of Comparison
            Those that it completes.
        """
        newest = self._samples[-1].stamp if self._samples else sample.stamp - 1
        self._sensor_arrival = arrival
        if sample.stamp < newest - RESTART_NANOSECONDS:
            self._samples.clear()
        elif sample.stamp <= newest:
            return []
        self._samples.append(sample)
        return self._compare_waiting(arrival)

    def add_estimate(self, sample: DepthSample, status: Status, arrival: float) -> list[Comparison]:
        """Take an estimate.

        Parameters
        ----------
        sample : DepthSample
            Depth NaN where it is not assessable.
        status : Status
            Of the estimate.
        arrival : float
            Time of arrival, s.

        Returns
        -------
        list of Comparison
            Those that it completes.
        """
        known = math.isfinite(sample.depth) and math.isfinite(sample.variance)
        self._estimate_arrival = arrival
        self._status = status if known or status is not Status.OK else Status.FIT_FAILED
        if self._status is not Status.OK:
            return []
        if len(self._waiting) == WAITING_ESTIMATES:
            self._unmatched += 1
        self._waiting.append(sample)
        return self._compare_waiting(arrival)

    def report(self, now: float) -> Report:
        """Return the verdict at a time of the clock of the arrivals, s."""
        self._give_up_waiting()
        verdict, reason = self._judge(now)
        learned = self.config.bias_window > 0 and self._learning_done()
        bias, bias_variance = self._bias() if learned else (math.nan, math.nan)
        return Report(
            verdict, reason, self._last, self._compared, self._failed, self._inconclusive,
            self._unmatched, self._consecutive, bias, math.sqrt(bias_variance),
            len(self._differences),
        )

    def _compare_waiting(self, arrival: float) -> list[Comparison]:
        comparisons = []
        for _ in range(len(self._waiting)):
            estimate = self._waiting.popleft()
            if not self._samples or self._samples[-1].stamp < estimate.stamp:
                self._waiting.append(estimate)
                continue
            sensor = interpolate(self._samples, estimate.stamp, self.config.timeout)
            if sensor is None:
                self._unmatched += 1
            else:
                comparisons.append(self._compare(estimate, sensor, arrival))
        return comparisons

    def _give_up_waiting(self) -> None:
        """Let go of estimates that the sensor, or another recording, has left behind."""
        limit = self.config.timeout * 1e9
        while len(self._waiting) > 1 and (
            abs(self._waiting[-1].stamp - self._waiting[0].stamp) > limit
        ):
            self._waiting.popleft()
            self._unmatched += 1

    def _compare(self, estimate: DepthSample, sensor: DepthSample, arrival: float) -> Comparison:
        bias, bias_variance = self._bias() if self._learning_done() else (0.0, 0.0)
        innovation = sensor.depth - bias - estimate.depth
        variance = (
            estimate.variance + sensor.variance + self.config.model_stddev**2 + bias_variance
        )
        # Nothing at all is never certain.
        variance = max(variance, 1e-12)
        gate = math.sqrt(chdtri(1, 1.0 - self.config.confidence) * variance)
        comparison = Comparison(
            estimate, sensor, innovation, variance, innovation**2 / variance, gate,
            conclusive=gate <= self.config.max_gate,
        )
        self._last = comparison
        self._count(comparison, arrival)
        return comparison

    def _count(self, comparison: Comparison, arrival: float) -> None:
        self._compared += 1
        self._compared_arrival = arrival
        if not comparison.conclusive:
            # Passing a wide gate proves nothing, so the row goes on.
            self._inconclusive += 1
            return
        self._conclusive_arrival = arrival
        if not self._learning_done():
            self._differences.append((comparison.innovation, comparison.variance))
            return
        self._failed += not comparison.passed
        self._consecutive = 0 if comparison.passed else self._consecutive + 1

    def _learning_done(self) -> bool:
        return len(self._differences) >= self.config.bias_window

    def _bias(self) -> tuple[float, float]:
        """Return the learned bias (weighted mean of the first differences) and its variance."""
        if self.config.bias_window == 0:
            return 0.0, 0.0
        values, variances = np.array(self._differences[: self.config.bias_window]).T
        weights = 1.0 / variances
        mean = float(np.average(values, weights=weights))
        scatter = float(np.average((values - mean) ** 2, weights=weights)) / len(values)
        return mean, max(1.0 / float(weights.sum()), scatter)

    def _judge(self, now: float) -> tuple[Verdict, str]:
        config = self.config
        stale = self._stale(now)
        if stale:
            return Verdict.STALE, stale
        if self._status is not Status.OK:
            return Verdict.NOT_ASSESSABLE, f"the depth is not assessable: {self._status}"
        if self._last is None or now - self._compared_arrival > config.timeout:
            return Verdict.STALE, (
                "no depth_sensor value at the stamps of the images: are both on one clock?"
            )
        if now - self._conclusive_arrival > config.timeout:
            return Verdict.NOT_ASSESSABLE, (
                f"too uncertain: a difference of {self._last.gate:.2f} m would pass"
            )
        if not self._learning_done():
            return Verdict.LEARNING, (
                f"learning the constant bias, {len(self._differences)} of {config.bias_window} "
                "differences: nothing is judged yet"
            )
        found = (
            f"sensor {self._last.innovation:+.2f} m from the estimate, gate {self._last.gate:.2f} m"
        )
        if config.bias_window:
            found += f", after a learned bias of {self._bias()[0]:+.2f} m"
        row = f"{found}, {self._consecutive} in a row beyond their gate"
        if self._consecutive >= config.error_after:
            return Verdict.ERROR, row
        if self._consecutive >= config.warn_after:
            return Verdict.WARN, row
        return Verdict.OK, found

    def _stale(self, now: float) -> str:
        for what, arrival in (
            ("depth_sensor", self._sensor_arrival), ("estimate", self._estimate_arrival),
        ):
            if arrival == -math.inf:
                return f"no {what} yet"
            if now - arrival > self.config.timeout:
                return f"no {what} for {now - arrival:.1f} s"
        return ""
