# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Results of the depth test: comparison, verdict and report."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from uw_visibility.plausibility.samples import DepthSample


class Verdict(str, Enum):
    """Verdict on sensor and estimate."""

    OK = "ok"
    WARN = "warning"
    ERROR = "error"
    STALE = "stale"
    LEARNING = "learning"
    NOT_ASSESSABLE = "not assessable"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class Comparison:
    """Comparison of sensor and estimate at the stamp of an image.

    Attributes
    ----------
    estimate, sensor : DepthSample
        The sensor's is interpolated and without the learned bias.
    innovation : float
        ν = sensor - bias - estimate, m.
    variance : float
        S, m²: of the estimate, the sensor, the model and the learned bias.
    nis : float
        ν²/S.
    gate : float
        Largest magnitude of ν that passes, m.
    conclusive : bool
        Whether the gate is narrow enough to prove anything.
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
    verdict : Verdict
    reason : str
        The verdict in a sentence.
    last : Comparison or None
    compared, failed, inconclusive, unmatched : int
        Comparisons; those beyond their gate; those whose gate was too wide;
        estimates without a sensor's value at their stamp.
    consecutive : int
        Comparisons beyond the gate in a row.
    bias, bias_stddev : float
        Constant difference learned, m; NaN where none is.
    learned : int
        Differences that it was learned from so far.
    """

    verdict: Verdict
    reason: str
    last: Comparison | None
    compared: int
    failed: int
    inconclusive: int
    unmatched: int
    consecutive: int
    bias: float
    bias_stddev: float
    learned: int
