# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Robust statistics: scale by the median absolute deviation, weights of robust losses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# A median absolute deviation of 1 is a standard deviation of this, for a normal distribution.
NORMAL = 1.4826
# Efficiency of 95 % for normal errors (Huber).
HUBER = 1.345
HUBER_ITERATIONS = 30


def median_deviation(residuals: NDArray[np.floating]) -> float:
    """Standard deviation of residuals by their median absolute value."""
    return NORMAL * float(np.median(np.abs(residuals)))


def charbonnier_weight(residual: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights by Charbonnier's loss, for residuals divided by their scale."""
    return np.asarray(1.0 / np.sqrt(1.0 + residual**2))


def huber_mean(values: NDArray[np.float64]) -> tuple[float, float]:
    """Huber's mean of values, and their scale."""
    mean = float(np.median(values))
    scale = max(median_deviation(values - mean), 1e-9)
    for _ in range(HUBER_ITERATIONS):
        weight = 1.0 / np.maximum(np.abs(values - mean) / (HUBER * scale), 1.0)
        mean = float((weight * values).sum() / weight.sum())
    return mean, scale
