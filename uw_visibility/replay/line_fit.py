# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit of a straight line to a sensor over an estimate, with errors in both."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, astuple, dataclass
from pathlib import Path

import numpy as np

from uw_visibility.config.documents import read_document
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array

FEWEST = 8
"""Least number of frames for a fit."""
LARGEST = float(np.finfo(np.float32).max)
"""Largest value of a sensor: that of single precision, so that its powers are finite doubles."""
JACKKNIFE_BLOCKS = 10
# Margin of extrapolation beyond the fitted values, as a part of their range.
BEYOND = 0.25


@dataclass(frozen=True)
class LineFit:
    """Line y = intercept + slope · x through estimates x and values y of a sensor."""

    source: str  # topic and field of the sensor
    against: str  # column of the estimates
    intercept: float
    slope: float
    # intercept_stddev, slope_stddev, covariance: by jackknife over blocks of frames, since errors
    # of neighbouring frames are correlated
    intercept_stddev: float
    slope_stddev: float
    covariance: float
    # standard deviation of the sensor's values about the line, beyond errors of the estimates
    residual_stddev: float
    correlation: float  # of estimates and sensor
    # low, high: least and largest estimate
    low: float
    high: float
    frames: int

    def predict(self, x: float, stddev: float) -> tuple[float, float]:
        """Return the predicted value of the sensor and its standard deviation.

        NaN if the estimate is unknown, or far outside the fitted range.
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
        """Read a file of `write`.

        Raises `InputError` if the file is not a fit.
        """
        content = read_document(path, "fit")
        try:
            fit = cls(**content)
            source, against, *numbers = astuple(fit)
            if not (isinstance(source, str) and isinstance(against, str)):
                raise TypeError("source and against are names")
            if not all(abs(number) <= LARGEST for number in numbers):
                raise ValueError("a number is too large")
            return fit
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{path} is not a fit of a joined topic, {error}: give fit_….json of replay --join"
            ) from error


def fit_line(
    x: Array, x_stddev: Array, y: Array, source: str = "", against: str = ""
) -> LineFit | None:
    """Fit a line with errors in both coordinates: slope S_xy / (S_xx − σ²).

    Errors of x flatten the line of y on x, so their variance σ² is subtracted from that of x, at
    most until all values lie on the line: a part of σ may be common to all frames (W. A. Fuller,
    Measurement Error Models, Wiley, 1987, section 1.2).

    x, x_stddev: (n,) float64, estimates and their standard deviations.
    y: (n,) float64, values of the sensor.
    source, against: names for the result.
    Returns None for too few frames, or if all estimates or all values are the same.
    """
    known = np.isfinite(x) & np.isfinite(x_stddev) & np.isfinite(y)
    x, x_stddev, y = x[known], x_stddev[known], y[known]
    # Variance may underflow for tiny differences, and rounding may give equal values a variance.
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
    # Unknown part of the errors that is common to all frames.
    covariance[1, 1] += (slope - plain) ** 2 / 12.0
    turn = np.array([[1.0, -centre], [0.0, 1.0]])
    covariance = turn @ covariance @ turn.T
    return LineFit(
        source, against, level - slope * centre, slope,
        math.sqrt(covariance[0, 0]), math.sqrt(covariance[1, 1]), float(covariance[0, 1]),
        scatter, float(np.corrcoef(x, y)[0, 1]), float(x.min()), float(x.max()), len(x),
    )


def _line(x: Array, x_stddev: Array, y: Array) -> tuple[float, float, float, float]:
    """Return level at x = 0, slope, scatter of y, and slope of the regression of y on x."""
    (s_xx, s_xy), (_, s_yy) = np.cov(x, y)
    if s_xx == 0.0 or s_yy == 0.0:
        return float(y.mean()), 0.0, math.sqrt(s_yy), 0.0
    most = s_xx - s_xy**2 / s_yy
    noise = min(float(np.mean(x_stddev**2)), most)
    slope = float(s_xy / (s_xx - noise))
    # With the most noise all values lie on the line; rounding leaves some scatter.
    scatter = 0.0 if noise == most else math.sqrt(max(float(s_yy) - slope * float(s_xy), 0.0))
    return float(y.mean() - slope * x.mean()), slope, scatter, float(s_xy / s_xx)
