# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Series that are drawn from the model, with constants that are known."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.plausibility.model import Camera
from uw_visibility_lab.evaluation.plausibility.series import Seen, Series

CONSTANT, PRECISION = 2.0, 0.1


@pytest.fixture
def draw() -> Callable[..., Series]:
    """Return a function that draws a series as a `Camera` of one scale errs."""
    def drawn(camera: Camera, seed: int, frames: int = 240, rate: float = 1.0) -> Series:
        random, stddev = np.random.default_rng(seed), PlausibilityConfig().model_stddev
        constant = camera.constant * CONSTANT * random.standard_normal()
        told = math.hypot(CONSTANT, PRECISION)
        sizes = np.array((camera.fast * PRECISION, camera.slow * CONSTANT))
        kept = np.exp(-1.0 / rate / np.array((camera.fast_time, camera.slow_time)))
        wander = sizes * random.standard_normal(2)
        series = []
        for index in range(frames):
            wander = kept * wander + sizes * np.sqrt(1.0 - kept**2) * random.standard_normal(2)
            if random.random() < -math.expm1(-camera.bursts / rate):
                wander[0] += camera.burst * stddev * random.standard_normal()
            noise = camera.outlier * stddev * random.standard_normal() * (
                random.random() < camera.outliers)
            truth = 6.0 - 3.0 * math.cos(0.02 * index / rate)
            error = constant + float(wander.sum()) + noise
            series.append(Seen(
                index / rate, truth, truth - error, told, PRECISION))
        return series
    return drawn
