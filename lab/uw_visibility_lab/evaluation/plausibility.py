# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit the camera's error model in the check of a depth sensor.

Renders twelve transects of 240 frames, which takes twenty minutes of computing, and fits
`uw_visibility.plausibility.model.CAMERA` to nine of them by maximum likelihood. Prints it, and its
likelihood and that of the package's constants, over these nine and over the three others, which
have another path.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig, PlausibilityConfig
from uw_visibility.images.arrays import Array
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.plausibility.comparison import DepthSample
from uw_visibility.plausibility.model import CAMERA, INTERVAL, Camera, RightSensor, Taken
from uw_visibility_lab.simulation.camera import CameraEffects, StereoCamera
from uw_visibility_lab.simulation.frame import Effects
from uw_visibility_lab.simulation.transect import Transect
from uw_visibility_lab.simulation.water import WaterEffects

FRAMES = 240
MAX_DISPARITY = 48
"""Largest disparity that is searched, px: ranges from 0.56 m with the camera below."""
STEREO = StereoCamera(240, 180, 225.0, 0.12)
"""Small: depth comes from averages, and a transect takes two minutes on one core."""
COOL = CameraEffects(white_balance=(0.65, 1.0, 0.9))
"""An undeclared white balance, which shifts all estimated depths."""


@dataclass(frozen=True)
class Seen:
    """Depth estimated from a frame, and the truth."""

    time: float  # from the start, s
    truth: float  # true depth, m
    depth: float  # estimated, m; NaN without an estimate
    stddev: float  # standard deviation of `depth`, m
    precision: float  # standard deviation of the part of its error that differs by frame, m


Series = list[Seen]


def _plan(
    seed: int, depth: tuple[float, float], attenuation: tuple[float, float], **others: Any
) -> Transect:
    return Transect(FRAMES, 2.0, depth, attenuation, seed=seed, camera=STEREO, **others)


FITTED: dict[str, Transect] = {
    "1 grey, 2 to 6 m": _plan(11, (2.0, 6.0), (0.1, 0.25)),
    "1 type 1C, 3 to 6 m": _plan(
        11, (3.0, 6.0), (0.05, 0.15), water_effects=WaterEffects(water_type="1C")),
    "1 grey, 5 to 7 m, white balance": _plan(11, (5.0, 7.0), (0.05, 0.2), camera_effects=COOL),
    "2 type II, 5 to 12 m": _plan(
        12, (5.0, 12.0), (0.05, 0.15), altitude=(1.0, 2.5),
        water_effects=WaterEffects(water_type="II")),
    "2 grey, 9 to 4 m": _plan(12, (9.0, 4.0), (0.15, 0.1), altitude=(1.0, 2.5)),
    "2 type III, 4 m, snow": _plan(
        12, (4.0, 4.0), (0.05, 0.1), altitude=(1.0, 2.5),
        water_effects=WaterEffects(water_type="III"), effects=Effects(marine_snow=0.01)),
    "4 grey, 5 to 14 m": _plan(22, (5.0, 14.0), (0.05, 0.2)),
    "4 grey, 4 m, caustics": _plan(22, (4.0, 4.0), (0.1, 0.1), effects=Effects(caustics=0.3)),
    "4 type IB, 8 to 3 m, white balance": _plan(
        22, (8.0, 3.0), (0.05, 0.15), water_effects=WaterEffects(water_type="IB"),
        camera_effects=COOL),
}
"""Transects to which the model's constants are fitted, by path and water."""

LEFT_OUT: dict[str, Transect] = {
    "3 grey, 2 to 6 m": _plan(21, (2.0, 6.0), (0.05, 0.3)),
    "3 type 1C, 3 to 6 m": _plan(
        21, (3.0, 6.0), (0.1, 0.2), water_effects=WaterEffects(water_type="1C")),
    "3 grey, 5 to 7 m, white balance": _plan(21, (5.0, 7.0), (0.1, 0.25), camera_effects=COOL),
}
"""Transects left out of the fit: another path, other waters."""


def render_series(transect: Transect, workers: Workers | None = None) -> Series:
    """Render a transect, and return the depths that the pipeline estimates from its frames."""
    config = PipelineConfig.from_parameters({"stereo.max_disparity": MAX_DISPARITY, "threads": 1})
    pipeline = Pipeline(transect.camera.rig, config)
    series = []
    for time, frame in transect.render(workers):
        found = pipeline.process(frame.left, frame.right, enhance=()).visibility
        series.append(
            Seen(time, frame.depth, found.depth, found.depth_stddev, found.depth_precision))
    return series


STEPS = 30
"""Largest number of steps, of a dozen evaluations each: a minute for nine transects."""
DIFFERENCE = 1e-3
"""Difference of logarithms for numerical gradients."""
LARGEST = 9.0
"""Largest magnitude of a logarithm: beyond, nothing changes and numbers overflow."""
TIMES = {"fast_time": (1.0, 10.0), "slow_time": (20.0, 200.0)}
"""Bounds of correlation times, s: between the period of the frames, as for white noise, and the
length of a dive, as for a constant; the two do not overlap."""
START = Camera(
    constant=1.0, slope=1.0, fast=0.5, fast_time=3.0, slow=0.15, slow_time=100.0,
    bursts=0.05, burst=4.0, outliers=0.1, outlier=2.0, spread=2.0)


def log_likelihood(camera: Camera, series: Iterable[Series]) -> float:
    """Return the log density of the innovations of exact sensors over series."""
    return sum(_of_series(camera, each) for each in series)


def fit(series: Sequence[Series], start: Camera = START, steps: int = STEPS) -> Camera:
    """Return the constants of greatest likelihood of the innovations of exact sensors.

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
            right, last = RightSensor(sample, model_stddev, camera), seen.time - 1.0
        elapsed = seen.time - last
        if elapsed < INTERVAL:
            continue
        last = seen.time
        taken = Taken(elapsed, seen.depth, sample.variance, 0.0)
        ahead = right.filter.predict(*right.motion(taken))
        total += right.update(taken, ahead, right.observe(taken, seen.truth - seen.depth))
    return total


def _to_numbers(camera: Camera) -> Array:
    """Return unbounded constants: logarithms, and the log odds of the share of outliers."""
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


def main() -> None:
    """Render, fit, and print."""
    parser = argparse.ArgumentParser(
        prog="python -m uw_visibility_lab.evaluation.plausibility", description=__doc__)
    parser.add_argument(
        "--threads", type=int, default=0, help="threads that render; 0 for one per processor")
    workers = Workers(parser.parse_args().threads)
    fitted, left_out = (
        [render_series(transect, workers) for transect in transects.values()]
        for transects in (FITTED, LEFT_OUT))
    # Two digits: the series do not determine more.
    camera = Camera(*(float(f"{value:.2g}") for value in fit(fitted)))
    print("fitted to " + "; ".join(FITTED))
    print(f"CAMERA = {camera}")
    for name, each in {"fitted": camera, "the package's": CAMERA}.items():
        print(f"log likelihood, {name}: {log_likelihood(each, fitted):.1f}, "
              f"left out {log_likelihood(each, left_out):.1f}")


if __name__ == "__main__":
    main()
