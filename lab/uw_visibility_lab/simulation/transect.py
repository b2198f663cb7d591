# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Transect: a camera that moves over a reef while depth and turbidity change."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError, check_range
from uw_visibility_lab.simulation.camera import CameraEffects, Pose, Sensor, StereoCamera
from uw_visibility_lab.simulation.frame import Effects, RenderedFrame, Renderer
from uw_visibility_lab.simulation.lamps import Lighting
from uw_visibility_lab.simulation.scene import Scene, reef
from uw_visibility_lab.simulation.water import Water, WaterEffects

# More than eleven days at ten frames a second.
MOST_FRAMES = 10_000_000

RISE_PERIOD = 16.0
"""Period of the camera's rise and descent in s, where its altitude changes."""

METERED = 7
"""Number of frames from which the exposure of a transect under lamps is set."""


@dataclass(frozen=True)
class Transect:
    """Plan of a transect."""

    frames: int = 20  # number of stereo frames
    rate: float = 2.0  # frames per second
    # depth at the start and at the end in m. The reef is at the same distance below the camera at
    # any depth, as on a slope
    depth: tuple[float, float] = (2.0, 6.0)
    # mean attenuation α at the start and at the end in 1/m
    attenuation: tuple[float, float] = (0.05, 0.3)
    speed: float = 0.4  # speed over ground in m/s
    # heights above the mean sea floor in m, between which the camera rises and sinks
    altitude: tuple[float, float] = (1.5, 1.5)
    tilt: float = 16.0  # downward tilt of the camera in degrees; 90 for a survey of the floor
    seed: int = 0  # seed of reef, noise and particles
    # see `Water`; under lamps, None sets one exposure for all frames, by the brightest of some
    exposure: float | None = None
    # camera, sensor, effects, camera_effects, lighting: see `Renderer`
    camera: StereoCamera = StereoCamera()
    sensor: Sensor = Sensor()
    effects: Effects = Effects()
    camera_effects: CameraEffects = CameraEffects()
    water_effects: WaterEffects = WaterEffects()  # see `Water`
    lighting: Lighting = Lighting()

    def __post_init__(self) -> None:
        check_range("number of frames", self.frames, 1, MOST_FRAMES)
        check_range("rate", self.rate, 1e-3, 1000.0, "Hz")
        check_range("speed", self.speed, 0.0, 10.0, "m/s")
        check_range("seed", self.seed, 0)
        check_range("ends of the altitude", self.altitude, 0.5, 20.0, "m")
        for progress in (0.0, 1.0):
            water = self._water(progress)
            # The veil relative to no light is no number.
            if self.lighting.daylight and not replace(water, exposure=1.0).scene_light().all():
                raise InputError(
                    f"no daylight of some channel is left at a depth of {water.depth:g} m: give "
                    "less depth or attenuation, or lamps at night")

    @property
    def length(self) -> float:
        """Distance from the first to the last frame in m."""
        return self.speed * (self.frames - 1) / self.rate

    def render(self, workers: Workers | None = None) -> Iterator[TransectFrame]:
        """Render the frames in order; without `workers`, with a thread for each processor."""
        renderer = Renderer(
            self.camera, self.sensor, self.effects, workers or Workers(), self.camera_effects,
            self.lighting,
        )
        scene = reef(self.seed, self.length)
        exposure = self.exposure
        if self.lighting.lamps and exposure is None:
            exposure = self._meter(renderer, scene)
        for index in range(self.frames):
            time = index / self.rate
            progress = index / max(self.frames - 1, 1)
            frame = renderer.render(
                scene, self._pose(time), self._water(progress, exposure),
                seed=self.seed * 1_000_003 + index, time=time, index=index,
            )
            yield TransectFrame(time, frame)

    def _meter(self, renderer: Renderer, scene: Scene) -> float:
        """Return one exposure for all frames under lamps, so that their colours agree."""
        last = self.frames - 1
        indices = {round(last * k / (METERED - 1)) for k in range(METERED)}
        return min(
            renderer.exposure_for(
                scene, self._pose(index / self.rate), self._water(index / max(last, 1)))
            for index in sorted(indices)
        )

    def _water(self, progress: float, exposure: float | None = None) -> Water:
        """Return the water at a share of the transect, 0 .. 1; it changes smoothly."""
        depth = _ease(self.depth, progress)
        alpha = _ease(self.attenuation, progress)
        return Water(alpha, depth, exposure or self.exposure, self.water_effects)

    def _pose(self, time: float) -> Pose:
        """Return the camera's pose: a straight path with a vehicle's sway."""
        low, high = self.altitude
        rise = 0.5 - 0.5 * math.cos(2.0 * math.pi * time / RISE_PERIOD)
        return Pose(
            position=(
                self.speed * time,
                0.12 * math.sin(0.5 * time),
                low + (high - low) * rise + 0.06 * math.sin(0.9 * time + 1.0),
            ),
            heading=math.radians(4.0) * math.sin(0.35 * time),
            tilt=math.radians(self.tilt + 1.5 * math.sin(0.8 * time)),
            roll=math.radians(2.0) * math.sin(0.6 * time + 0.5),
        )


class TransectFrame(NamedTuple):
    """A frame and its time in s from the start."""

    time: float
    frame: RenderedFrame


def _ease(ends: tuple[float, float], progress: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * (0.5 - 0.5 * math.cos(math.pi * progress))
