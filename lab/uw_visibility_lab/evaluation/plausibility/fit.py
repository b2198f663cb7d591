# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit of what the check of a depth sensor believes of the camera: maximum likelihood."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from uw_visibility.config.schema import PlausibilityConfig
from uw_visibility.images.arrays import Array
from uw_visibility.plausibility.comparison import DepthSample
from uw_visibility.plausibility.model import INTERVAL, Camera, RightSensor, Taken
from uw_visibility_lab.evaluation.plausibility.series import Series

STEPS = 30
"""Steps at most, of a dozen evaluations each: a minute of computing for nine transects."""
DIFFERENCE = 1e-3
"""Of logarithms, by which gradients are taken."""
LARGEST = 9.0
"""Magnitude of a logarithm at most: beyond, nothing changes and numbers overflow."""
TIMES = {"fast_time": (1.0, 10.0), "slow_time": (20.0, 200.0)}
"""Bounds of correlation times, s: from that of frames which are taken, which noise has, to that of
a dive, which a constant has; the two apart."""
START = Camera(
    constant=1.0, slope=1.0, fast=0.5, fast_time=3.0, slow=0.15, slow_time=100.0,
    bursts=0.05, burst=4.0, outliers=0.1, outlier=2.0, spread=2.0)


def log_likelihood(camera: Camera, series: Iterable[Series]) -> float:
    """Return the log density of the innovations of exact sensors over series."""
    return sum(_of_series(camera, each) for each in series)


def fit(series: Sequence[Series], start: Camera = START, steps: int = STEPS) -> Camera:
    """Return the constants under which the innovations of exact sensors are likeliest.

    The search is quasi-Newton in logarithms (L-BFGS-B, doi:10.1145/279232.279236).
    """
    first = _to_numbers(start)
    found = minimize(
        lambda numbers: -log_likelihood(_from_numbers(numbers), series), first,
        method="L-BFGS-B", bounds=[
            (math.log(TIMES[name][0]), math.log(TIMES[name][1])) if name in TIMES
            else (-LARGEST, LARGEST) for name in Camera._fields],
        options={"maxiter": steps, "eps": DIFFERENCE})
    return _from_numbers(found.x)


def _of_series(camera: Camera, series: Series) -> float:
    model_stddev = PlausibilityConfig().model_stddev
    right: RightSensor | None = None
    last, total = 0.0, 0.0
    for seen in series:
        sample = DepthSample.estimated(0, seen.depth, seen.stddev, seen.precision)
        if not math.isfinite(sample.depth):
            continue
        if right is None:
            right, last = RightSensor.before(sample, model_stddev, camera), seen.time - 1.0
        elapsed = seen.time - last
        if elapsed < INTERVAL:
            continue
        last = seen.time
        taken = Taken(elapsed, seen.depth, sample.variance, 0.0)
        ahead = right.filter.predict(*right.motion(taken))
        total += right.update(ahead, right.observe(taken, seen.truth - seen.depth))
    return total


def _to_numbers(camera: Camera) -> Array:
    """Return constants without bounds: logarithms, and the share's log odds."""
    values = camera._replace(spread=camera.spread - 1.0)
    return np.array([
        logit(value) if name == "outliers" else math.log(value)
        for name, value in values._asdict().items()])


def _from_numbers(numbers: Array) -> Camera:
    values = dict(zip(Camera._fields, numbers, strict=True))
    found = {
        name: float(expit(value) if name == "outliers" else math.exp(value))
        for name, value in values.items()}
    return Camera(**found)._replace(spread=1.0 + found["spread"])
