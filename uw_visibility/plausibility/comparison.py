# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Depth test: samples in time, their comparison, verdict and report."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, Self, TypeVar


@dataclass(frozen=True)
class DepthSample:
    """Depth at a stamp, with its variance.

    Attributes
    ----------
    stamp : int
        In ns.
    depth : float
        m, positive down; NaN if unknown.
    variance : float
        m²; of an estimate, that of errors that differ between frames.
    constant_variance : float
        Variance of the error that all estimates of a dive have in common, m².
    """

    stamp: int
    depth: float
    variance: float
    constant_variance: float = 0.0

    @classmethod
    def estimated(
        cls, stamp: int, depth: float, stddev: float, precision: float
    ) -> DepthSample:
        """Return an estimate of depth, m, with its standard deviation and precision, m.

        All are NaN if depth is unknown.
        """
        if not (math.isfinite(depth) and math.isfinite(precision)):
            return cls(stamp, math.nan, math.nan)
        return cls(stamp, depth, precision**2, max(stddev**2 - precision**2, 0.0))

    @property
    def depth_stddev(self) -> float:
        """Standard deviation of `depth`, m."""
        return self.variance**0.5

    def towards(self, after: DepthSample, share: float, stamp: int) -> DepthSample:
        """Return the depth at a stamp, a share of the way to a later one."""
        # Errors of successive sensor values are correlated, so the mean of two
        # has no smaller variance.
        return DepthSample(
            stamp,
            self.depth + share * (after.depth - self.depth),
            self.variance + share * (after.variance - self.variance),
        )


class Stamped(Protocol):
    """Protocol of a value with a stamp, ns, between which and a later one lie others."""

    @property
    def stamp(self) -> int: ...

    def towards(self, after: Self, share: float, stamp: int) -> Self: ...


Value = TypeVar("Value", bound=Stamped)


def interpolate(values: Sequence[Value], stamp: int, longest_gap: float) -> Value | None:
    """Interpolate linearly at a stamp, ns, between values in the order of theirs.

    None if no values that are at most `longest_gap`, s, apart enclose the stamp.
    """
    index = bisect_left(values, stamp, key=lambda value: value.stamp)
    if index == len(values):
        return None
    after = values[index]
    if after.stamp == stamp:
        return after
    before = values[max(index - 1, 0)]
    gap = after.stamp - before.stamp
    # No extrapolation.
    if not 0 < gap <= longest_gap * 1e9:
        return None
    return before.towards(after, (stamp - before.stamp) / gap, stamp)


class Verdict(StrEnum):
    """Verdict on sensor and estimate."""

    OK = "ok"
    WARN = "warning"
    ERROR = "error"
    STALE = "stale"
    NOT_ASSESSABLE = "not assessable"


@dataclass(frozen=True)
class Comparison:
    """Comparison of sensor and estimate at the stamp of an image.

    Attributes
    ----------
    estimate, sensor : DepthSample
        The sensor's is interpolated.
    innovation : float
        ν, m: sensor minus estimate, minus the prediction of that from earlier frames.
    variance : float
        S, m²: that of the Gaussian with the same gate; it includes estimate, sensor, model and
        prediction.
    nis : float
        ν²/S.
    gate : float
        Largest magnitude of ν that passes, m.
    conclusive : bool
        Whether the gate is narrow enough, or ν beyond it.
    """

    estimate: DepthSample
    sensor: DepthSample
    innovation: float
    variance: float
    nis: float
    gate: float
    conclusive: bool

    @property
    def passed(self) -> bool:
        """Whether ν lies within the gate."""
        return abs(self.innovation) <= self.gate


@dataclass(frozen=True)
class Report:
    """Report of `DepthMonitor` at an instant.

    Attributes
    ----------
    reason : str
        The verdict in a sentence.
    compared, failed, inconclusive, unmatched, repeated : int
        Numbers of comparisons; of those beyond their gate; of those within a gate too wide
        to be conclusive; of estimates without a sensor's value at their stamp; of the sensor's
        values that are not used, because their stamp is not newer than the one before.
    evidence : float
        Of a fault, s: the mean time until a correct sensor shows as much is at least this.
    bias, bias_stddev : float
        Constant difference learned, m; NaN before the first comparison.
    """

    verdict: Verdict
    reason: str
    last: Comparison | None
    compared: int
    failed: int
    inconclusive: int
    unmatched: int
    repeated: int
    evidence: float
    bias: float
    bias_stddev: float
