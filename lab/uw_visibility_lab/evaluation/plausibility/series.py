# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Series of estimated and true depth over rendered transects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.pipeline.pipeline import Pipeline
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
"""A balance that the estimate is not told of, which shifts all its depths."""


@dataclass(frozen=True)
class Seen:
    """What a frame tells of depth, and the truth."""

    time: float  # from the start, s
    truth: float  # true depth, m
    depth: float  # estimated, m; NaN where it is not told
    stddev: float  # standard deviation of `depth`, m
    precision: float  # standard deviation of what of `depth` differs between frames, m


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
"""Transects that the model's constants are fitted to, by way and water."""

LEFT_OUT: dict[str, Transect] = {
    "3 grey, 2 to 6 m": _plan(21, (2.0, 6.0), (0.05, 0.3)),
    "3 type 1C, 3 to 6 m": _plan(
        21, (3.0, 6.0), (0.1, 0.2), water_effects=WaterEffects(water_type="1C")),
    "3 grey, 5 to 7 m, white balance": _plan(21, (5.0, 7.0), (0.1, 0.25), camera_effects=COOL),
}
"""Transects left out of the fit: other ways, other waters."""


def render_series(transect: Transect, workers: Workers | None = None) -> Series:
    """Render a transect, and return what the pipeline tells of each frame's depth."""
    config = PipelineConfig.from_parameters({"stereo.max_disparity": MAX_DISPARITY, "threads": 1})
    pipeline = Pipeline(transect.camera.rig, config)
    series = []
    for time, frame in transect.render(workers):
        told = pipeline.process(frame.left, frame.right, enhance=()).visibility
        series.append(
            Seen(time, frame.depth, told.depth, told.depth_stddev, told.depth_precision))
    return series
