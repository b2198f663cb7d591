# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Straight line between an estimate and a sensor, with errors in both."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.config.documents import read_document
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array

FEWEST = 8
"""Frames that a fit needs."""
LARGEST = float(np.finfo(np.float32).max)
"""Largest number of a sensor: that of single precision, whose powers double precision holds."""
JACKKNIFE_BLOCKS = 10
# How far beyond the fitted values the line is taken to go on, as a part of their span.
BEYOND = 0.25


@dataclass(frozen=True)
class LineFit:
    """Line y = intercept + slope · x through estimates x and a sensor's values y."""

    source: str  # topic and field of the sensor
    against: str  # column of the estimates
    intercept: float
    slope: float
    # intercept_stddev, slope_stddev, covariance: of both, by jackknife over blocks of frames, whose
    # errors are alike
    intercept_stddev: float
    slope_stddev: float
    covariance: float
    # what the sensor's values differ by from the line, beyond the estimates' errors
    residual_stddev: float
    correlation: float  # of estimates and sensor
    # low, high: least and largest estimate
    low: float
    high: float
    frames: int

    def predict(self, x: float, stddev: float) -> tuple[float, float]:
        """Return what the sensor would say, and its standard deviation.

        Returns NaN where the estimate is not known, or far outside of those fitted.
        """
        margin = BEYOND * (self.high - self.low)
        if not self.low - margin <= x <= self.high + margin:
            return math.nan, math.nan
        variance = (
            self.intercept_stddev**2 + 2.0 * x * self.covariance + (x * self.slope_stddev) ** 2
            + (self.slope * stddev) ** 2 + self.residual_stddev**2
        )
        return self.intercept + self.slope * x, math.sqrt(max(variance, 0.0))

    def write(self, path: Path) -> None:
        text = json.dumps(asdict(self), indent=1, allow_nan=False)
        path.write_text(text + "\n", encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> LineFit:
        """Read what `write` wrote.

        Raises `InputError` if the file is none.
        """
        content = read_document(path, "fit")
        try:
            texts = ("source", "against")
            values: dict[str, Any] = {
                name: str(value) if name in texts else float(value)
                for name, value in content.items()
            }
            for name, value in values.items():
                if name not in texts and not abs(value) <= LARGEST:
                    raise ValueError(f"{name} is {value:g}")
            return cls(**values | {"frames": int(values["frames"])})
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{path} is no fit of a joined topic, {error}: give a fit_….json of replay --join"
            ) from error


def fit_line(
    x: Array, x_stddev: Array, y: Array, source: str = "", against: str = ""
) -> LineFit | None:
    """Fit a line with errors in both coordinates: slope S_xy / (S_xx − σ²).

    Errors of x flatten the line of y on x, so that their variance is taken from that of x;
    at most so much that all values lie on the line, since a part of σ may be common to all
    frames.

    x, x_stddev: (n,) float64, estimates and their standard deviations.
    y: (n,) float64, values of the sensor.
    source, against: names for the result.
    Returns None where there are too few frames, or estimates or values are all the same.

    References
    ----------
    W. A. Fuller, Measurement Error Models, Wiley, 1987, section 1.2.
    """
    known = np.isfinite(x) & np.isfinite(x_stddev) & np.isfinite(y)
    x, x_stddev, y = x[known], x_stddev[known], y[known]
    # Tiny differences underflow to zero variance, and rounding gives equal values some.
    if len(x) < FEWEST or any(np.ptp(each) ** 2 == 0.0 or np.var(each) == 0.0 for each in (x, y)):
        return None
    # Centred, so that intercept and slope are uncorrelated.
    centre = float(x.mean())
    level, slope, scatter, plain = _line(x - centre, x_stddev, y)
    parts = []
    for block in np.array_split(np.arange(len(x)), min(JACKKNIFE_BLOCKS, len(x))):
        kept = np.ones(len(x), bool)
        kept[block] = False
        parts.append(_line(x[kept] - centre, x_stddev[kept], y[kept])[:2])
    deviation = np.array(parts) - np.mean(parts, axis=0)
    covariance = (len(parts) - 1) / len(parts) * deviation.T @ deviation
    # How much of the errors is alike in all frames is not known.
    covariance[1, 1] += (slope - plain) ** 2 / 12.0
    turn = np.array([[1.0, -centre], [0.0, 1.0]])
    covariance = turn @ covariance @ turn.T
    return LineFit(
        source, against, level - slope * centre, slope,
        math.sqrt(covariance[0, 0]), math.sqrt(covariance[1, 1]), float(covariance[0, 1]),
        scatter, float(np.corrcoef(x, y)[0, 1]), float(x.min()), float(x.max()), len(x),
    )


def _line(x: Array, x_stddev: Array, y: Array) -> tuple[float, float, float, float]:
    """Return level at x = 0, slope, scatter of y, and the slope of y on x alone."""
    (s_xx, s_xy), (_, s_yy) = np.cov(x, y)
    if s_xx == 0.0 or s_yy == 0.0:
        return float(y.mean()), 0.0, math.sqrt(s_yy), 0.0
    noise = min(float(np.mean(x_stddev**2)), s_xx - s_xy**2 / s_yy)
    slope = float(s_xy / (s_xx - noise))
    scatter = math.sqrt(max(float(s_yy) - slope * float(s_xy), 0.0))
    return float(y.mean() - slope * x.mean()), slope, scatter, float(s_xy / s_xx)
