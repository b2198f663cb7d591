# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Innovation test (NIS) of a depth sensor against the depth estimated from colour.

The test is the one of a filter's consistency: the innovation ν, its variance S and the
normalised innovation squared ν²/S against the χ² distribution with one degree of freedom
(Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation",
2001, section 5.4, doi:10.1002/0471221279). The prediction of the difference and the evidence of
a fault are those of `uw_visibility.plausibility.model`.
"""

from __future__ import annotations

import math
from collections import deque

from scipy.special import chdtri

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.comparison import (
    Comparison,
    DepthSample,
    Report,
    Verdict,
    interpolate,
)
from uw_visibility.plausibility.model import (
    CAMERA,
    INTERVAL,
    InnovationModel,
    RightSensor,
    Taken,
)
from uw_visibility.status import Status

# Limit of memory: 10 s of a sensor at 200 Hz.
SENSOR_SAMPLES = 2000
WAITING_ESTIMATES = 100

HOUR = 3600.0
# Tolerance for rounding at the limit of evidence.
REACHED = 1.0 - 1e-9
NO_SENSOR = "no depth_sensor yet"
OTHER_STAMPS = "no depth_sensor value at the stamps of the images: are both on one clock?"
# Step by which a comparison changes the logarithm of the gate, so that in the long run the
# configured share passes, whatever the camera's errors are: that of Angelopoulos, Candes and
# Tibshirani (2023, doi:10.48550/arXiv.2307.16895), relative to the gate.
WIDENING = 0.1

# A stamp older than the newest by more than this starts a new recording, ns.
RESTART_NANOSECONDS = 1_000_000_000


class DepthMonitor:
    """Innovation test of a depth sensor, with a verdict by the evidence of all comparisons.

    An estimate waits until the sensor's values enclose its stamp. Times of arrival, s, are of any
    monotonic clock, and show what is stale. `config` may be replaced at any time.
    """

    def __init__(self, config: PlausibilityConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Discard all samples, verdicts and the learned bias."""
        self._samples: deque[DepthSample] = deque(maxlen=SENSOR_SAMPLES)
        self._waiting: deque[DepthSample] = deque(maxlen=WAITING_ESTIMATES)
        self._model: InnovationModel | None = None
        # Stamp and the sensor's depth of the last comparison that has updated the model.
        self._taken, self._sensor_taken = 0, math.nan
        # Logarithm of the factor by which the gates of the model are widened.
        self._widening = 0.0
        self._status = Status.OK
        self._last: Comparison | None = None
        self._sensor_arrival = self._estimate_arrival = -math.inf
        self._compared_arrival = self._conclusive_arrival = -math.inf
        self._compared = self._failed = self._inconclusive = 0
        self._unmatched = self._repeated = 0

    def add_sensor(self, sample: DepthSample, arrival: float) -> list[Comparison]:
        """Add a finite value of the sensor; return the comparisons that it completes."""
        newest = self._samples[-1].stamp if self._samples else sample.stamp - 1
        self._sensor_arrival = arrival
        if sample.stamp < newest - RESTART_NANOSECONDS:
            self._samples.clear()
        elif sample.stamp <= newest:
            self._repeated += 1
            return []
        self._samples.append(sample)
        return self._compare_waiting(arrival)

    def add_estimate(self, sample: DepthSample, status: Status, arrival: float) -> list[Comparison]:
        """Add an estimate, NaN if not assessable; return the comparisons that it completes."""
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
        """Return the verdict at a time, s, of the clock of the arrivals."""
        # Waiting estimates that are too old, or of another recording, are given up.
        limit = self.config.timeout * 1e9
        while len(self._waiting) > 1 and (
            abs(self._waiting[-1].stamp - self._waiting[0].stamp) > limit
        ):
            self._waiting.popleft()
            self._unmatched += 1
        verdict, reason = self._judge(now)
        model = self._model
        bias, bias_stddev = model.right.constant if model is not None else (math.nan, math.nan)
        return Report(
            verdict, reason, self._last, self._compared, self._failed, self._inconclusive,
            self._unmatched, self._repeated, model.evidence if model is not None else 0.0,
            bias, bias_stddev,
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

    def _compare(self, estimate: DepthSample, sensor: DepthSample, arrival: float) -> Comparison:
        config, model = self.config, self._model
        if model is None or model.right.stddev != config.model_stddev:
            model = self._model = InnovationModel(
                RightSensor(estimate, config.model_stddev, CAMERA))
            self._taken, self._sensor_taken = estimate.stamp - RESTART_NANOSECONDS, math.nan
        elapsed = 1e-9 * abs(estimate.stamp - self._taken)
        difference = sensor.depth - estimate.depth
        # Avoids a zero variance.
        taken = Taken(
            elapsed, estimate.depth, max(estimate.variance, 1e-12), sensor.variance,
            sensor.depth - self._sensor_taken)
        expected, gate = model.right.predict(taken, config.confidence)
        if elapsed >= INTERVAL:
            model.update(taken, difference, HOUR * config.error_interval)
            self._taken, self._sensor_taken = estimate.stamp, sensor.depth
        gate *= math.exp(self._widening)
        innovation = difference - expected
        variance = gate**2 / float(chdtri(1, 1.0 - config.confidence))
        comparison = Comparison(
            estimate, sensor, innovation, variance, innovation**2 / variance, gate,
            conclusive=gate <= config.max_gate or abs(innovation) > gate,
        )
        if model.evidence < HOUR * config.warn_interval:
            self._widening += WIDENING * ((not comparison.passed) - (1.0 - config.confidence))
        self._last = comparison
        self._compared += 1
        self._compared_arrival = arrival
        if comparison.conclusive:
            self._conclusive_arrival = arrival
            self._failed += not comparison.passed
        else:
            self._inconclusive += 1
        return comparison

    def _judge(self, now: float) -> tuple[Verdict, str]:
        config = self.config
        for what, arrival in (
            ("depth_sensor", self._sensor_arrival), ("estimate", self._estimate_arrival),
        ):
            if arrival == -math.inf:
                return Verdict.STALE, f"no {what} yet"
            if now - arrival > config.timeout:
                return Verdict.STALE, f"no {what} for {now - arrival:.1f} s"
        if self._status is not Status.OK:
            return Verdict.NOT_ASSESSABLE, f"the depth is not assessable: {self._status}"
        model, last = self._model, self._last
        if model is None or last is None or now - self._compared_arrival > config.timeout:
            return Verdict.STALE, OTHER_STAMPS
        bias, bias_stddev = model.right.constant
        found = (
            f"sensor {last.innovation:+.2f} m from the prediction, gate {last.gate:.2f} m, "
            f"after a learned bias of {bias:+.2f} ± {bias_stddev:.2f} m"
        )
        for verdict, hours in (
            (Verdict.ERROR, config.error_interval), (Verdict.WARN, config.warn_interval),
        ):
            if model.evidence >= REACHED * HOUR * hours:
                return verdict, (
                    f"{found}; a correct sensor shows as much at most once in {hours:g} h"
                )
        if now - self._conclusive_arrival > config.timeout:
            return Verdict.NOT_ASSESSABLE, (
                f"too uncertain: a difference of {last.gate:.2f} m would pass"
            )
        return Verdict.OK, found
