# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Renderer of one stereo frame under water, with its ground truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.errors import check_range
from uw_visibility.images.arrays import Array, Image8, Map
from uw_visibility_lab.simulation.camera import CameraEffects, Pose, Sensor, StereoCamera
from uw_visibility_lab.simulation.formation import effective_attenuation, form_image
from uw_visibility_lab.simulation.lamp_light import (
    check_water,
    direct_light,
    exposure_for,
    form_lamp_image,
    seen_from,
)
from uw_visibility_lab.simulation.lamps import Lamp, Lighting
from uw_visibility_lab.simulation.noise import value_noise
from uw_visibility_lab.simulation.scene import Scene
from uw_visibility_lab.simulation.view import View, look
from uw_visibility_lab.simulation.water import CLEAR_WATER, Water


@dataclass(frozen=True)
class Effects:
    """Disturbances of the light model: marine snow and caustics."""

    marine_snow: float = 0.0  # share of the pixels that drifting particles cover, 0 .. 0.5
    caustics: float = 0.0  # relative change of light by waves at the surface, 0 .. 1
    snow_brightness: float = 1.0  # radiance relative to open water, or to white under lamps

    def __post_init__(self) -> None:
        check_range("share of marine snow", self.marine_snow, 0.0, 0.5)
        check_range("strength of caustics", self.caustics, 0.0, 1.0)
        check_range("brightness of marine snow", self.snow_brightness, 0.0, 20.0)


@dataclass(frozen=True)
class RenderedFrame:
    """Rendered stereo frame and its ground truth."""

    # left, right: (H, W, 3); the images, RGB; linear unless the camera's effects encode them
    left: Image8
    right: Image8
    # range_left, range_right: (H, W); distance along the line of sight in m; inf = open water
    range_left: Map
    range_right: Map
    # disparity_left, disparity_right: (H, W); disparity in px, positive in both; NaN = open water
    disparity_left: Map
    disparity_right: Map
    # radiance_left, radiance_right: (H, W, 3); normalised radiance of the scene; 1 for open water.
    # With lamps, its reflectance
    radiance_left: Map
    radiance_right: Map
    # (3,); β in 1/m, RGB; effective over the left image's ranges where the water has a spectrum, a
    # layer or a plume, see `effective_attenuation`
    attenuation: Array
    ambient_light: Array  # (3,); I∞ as irradiance in the image, RGB: the veil B
    mean_attenuation: float  # α in 1/m, eq. 9
    depth: float  # depth of the camera in m, positive down
    # (3,); W, which lights the scene, as irradiance in the image, RGB; I∞ in the paper's water.
    # Both are daylight's: 0 at night
    scene_light: Array
    lamps: tuple[Lamp, ...] = ()  # those that fired, with power as irradiance in the image


@dataclass(frozen=True)
class Renderer:
    """Renders frames of scenes; equal arguments give bit-identical frames."""

    camera: StereoCamera = StereoCamera()  # the pair of cameras
    sensor: Sensor = Sensor()  # their noise
    effects: Effects = Effects()  # disturbances of the light model
    # threads; their number does not change the result
    workers: Workers = field(default_factory=Workers)
    camera_effects: CameraEffects = CameraEffects()  # effects of the cameras, apart from noise
    lighting: Lighting = Lighting()  # daylight, lamps, or both

    def render(
        self, scene: Scene, pose: Pose, water: Water, *, seed: int = 0, time: float = 0.0,
        index: int = 0,
    ) -> RenderedFrame:
        """Render one frame; strobes depend on its `index`, caustics on its `time`, s."""
        lamps, with_lamps = self.lighting.of_frame(index, seed), bool(self.lighting.lamps)
        if with_lamps:
            check_water(water)
        views = [look(scene, self.camera, pose, self.workers, right=side) for side in (False, True)]
        if self.effects.caustics > 0.0:
            for view in views:
                with np.errstate(invalid="ignore"):  # open water is infinitely far
                    points = view.eye + view.ranges[:, np.newaxis] * (view.rays @ view.rotation.T)
                add_caustics(
                    view.radiance, points, scene.lattice, self.effects.caustics, time)
        light, exposure = self.expose(views, water, lamps, seed)
        gains = self.camera_effects.gains(light[0])
        images = [
            self.camera_effects.record(
                irradiance, self.sensor, np.random.default_rng([seed, side]), gains)
            for side, irradiance in enumerate(light)
        ]
        disparities = [
            self.camera.rig.disparity_from_range(
                np.where(np.isfinite(view.range), view.range, np.nan))
            for view in views
        ]
        radiances = [
            np.where(
                np.isfinite(v.range)[..., np.newaxis],
                v.middles(v.reflectance if with_lamps else v.radiance), np.float32(1.0),
            )
            for v in views
        ]
        attenuation = effective_attenuation(views[0], water)
        daylight = replace(water, exposure=1.0) if with_lamps else water
        scale = exposure * gains * float(self.lighting.daylight)
        return RenderedFrame(
            images[0], images[1], views[0].range, views[1].range, disparities[0], disparities[1],
            radiances[0], radiances[1], attenuation, scale * daylight.ambient_light(),
            mean_attenuation(attenuation, water), water.depth, scale * daylight.scene_light(),
            tuple(lamp.scaled(exposure * gains) for lamp in lamps),
        )

    def expose(
        self, views: Sequence[View], water: Water, lamps: tuple[Lamp, ...], seed: int
    ) -> tuple[list[Map], float]:
        """Return the irradiance of both views, with marine snow, and the exposure.

        By daylight alone the exposure is 1: that of the water is applied before.
        """
        source = replace(water, exposure=1.0) if self.lighting.lamps else water
        # The lamps in each camera's frame.
        seen = [seen_from(lamps, side * self.camera.baseline) for side in range(len(views))]
        light = [self._light(*each, source) for each in zip(views, seen, strict=True)]
        exposure = 1.0
        if self.lighting.lamps:
            exposure = exposure_for(light[0]) if water.exposure is None else water.exposure
        if self.effects.marine_snow > 0.0:
            self._add_snow(light, views, seen, source, seed)
        return [irradiance * np.float32(exposure) for irradiance in light], exposure

    def exposure_for(self, scene: Scene, pose: Pose, water: Water) -> float:
        """Return the automatic exposure of a frame under lamps, from a small rendering."""
        width, height = (max(8, n // 8) for n in (self.camera.width, self.camera.height))
        small = StereoCamera(
            width, height, self.camera.focal_length * width / self.camera.width,
            self.camera.baseline,
        )
        view = look(scene, small, pose, self.workers)
        light = self._light(view, self.lighting.lamps, replace(water, exposure=1.0))
        return exposure_for(light)

    def _light(self, view: View, lamps: Sequence[Lamp], water: Water) -> Map:
        """Return the irradiance of an image by daylight and lamps."""
        if not self.lighting.lamps:
            return form_image(view, water)
        irradiance = form_lamp_image(view, water, self.lighting, lamps, self.workers)
        if self.lighting.daylight:
            irradiance += form_image(view, water)
        return irradiance

    def _add_snow(
        self, light: Sequence[Map], views: Sequence[View], seen: Sequence[tuple[Lamp, ...]],
        water: Water, seed: int,
    ) -> None:
        """Draw white particles into images, lit by daylight and lamps (in each camera's frame).

        Those behind a surface are left out.
        """
        camera = self.camera
        places, sigma, opacity = drift(
            camera, self.effects.marine_snow, np.random.default_rng([seed, 2]))
        background = float(self.lighting.daylight) * water.ambient_light()
        for side, (irradiance, view, lamps) in enumerate(zip(light, views, seen, strict=True)):
            points = places - np.array([side * camera.baseline, 0.0, 0.0])
            away = np.linalg.norm(points, axis=1)
            colours = self.effects.snow_brightness * (background + direct_light(
                points / away[:, np.newaxis], away, None, lamps, water.attenuation()))
            pixels = points[:, :2] / points[:, 2:] * camera.focal_length + camera.principal_point
            last = (camera.width - 1, camera.height - 1)
            inside = np.clip(np.rint(pixels), 0, last).astype(int)
            hidden = away > view.range[inside[:, 1], inside[:, 0]]
            for k in np.flatnonzero(~hidden):
                draw_particle(irradiance, pixels[k], sigma[k], opacity[k], colours[k])


def mean_attenuation(attenuation: Array, water: Water) -> float:
    """Return α (eq. 9) of an effective attenuation; for the paper's water the given α."""
    if water.effects.water_type is None and np.array_equal(attenuation, water.attenuation()):
        return water.mean_attenuation
    return float(np.mean(attenuation - CLEAR_WATER))


@njit(nogil=True, error_model="numpy")
def add_caustics(radiance: Any, points: Any, lattice: Any, amplitude: float, time: float) -> None:
    """Caustics: modulate radiance (n, 3) in place as waves at the surface focus the light.

    points: (n, 3), points of the scene in m; not finite = open water.
    amplitude: largest relative change, 0 .. 1. time: in s; the pattern moves.
    """
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        if not math.isfinite(x):
            continue
        # Bright lines are where the noise is near zero: they form a net, as real caustics do.
        net = value_noise(lattice, 3.1 * x + 0.4 * time, 3.1 * y, 0.9 * time)
        fine = value_noise(lattice, 7.3 * y, 7.3 * x - 0.6 * time, 1.3 * time + 20.0)
        line = math.exp(-6.0 * abs(net + 0.3 * fine))
        gain = 1.0 + amplitude * (2.0 * line - 1.0)
        for channel in range(3):
            radiance[k, channel] *= gain


def drift(
    camera: StereoCamera, fraction: float, random: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Draw the particles of marine snow, which cover a fraction of the pixels of each image.

    Returns their places in the left camera's optical frame, m, the standard deviations of their
    images, px, and the opacity of the middle of these, 0 .. 1.
    """
    rows = []
    wanted = fraction * camera.width * camera.height
    covered = 0.0
    centre = np.array(camera.principal_point)
    while covered < wanted:
        depth = 0.4 * math.exp(random.uniform(0.0, 2.0))
        disparity = camera.focal_length * camera.baseline / depth
        # Particles beyond the left image's right edge may be in the right image.
        column = random.uniform(0.0, camera.width + disparity)
        row = random.uniform(0.0, camera.height)
        # Near particles are larger, and out of focus.
        sigma = 0.5 + random.exponential(0.5) / depth
        place = (np.array([column, row]) - centre) / camera.focal_length * depth
        rows.append([*place, depth, sigma, random.uniform(0.3, 0.9)])
        covered += math.pi * (1.5 * sigma) ** 2
    found = np.array(rows).reshape(-1, 5)
    return found[:, :3], found[:, 3], found[:, 4]


def draw_particle(
    irradiance: Map, pixel: Array, sigma: float, opacity: float, colour: Array
) -> None:
    """Draw a particle at a pixel (column, row) into an image, in place."""
    column, row = pixel
    reach = math.ceil(3.0 * sigma)
    rows = slice(max(int(row) - reach, 0), max(int(row) + reach + 1, 0))
    columns = slice(max(int(column) - reach, 0), max(int(column) + reach + 1, 0))
    window = irradiance[rows, columns]
    y = np.arange(rows.start, rows.start + window.shape[0]) - row
    x = np.arange(columns.start, columns.start + window.shape[1]) - column
    squared = (x[np.newaxis] ** 2 + y[:, np.newaxis] ** 2) / (2.0 * sigma**2)
    cover = (opacity * np.exp(-squared)).astype(np.float32)[..., np.newaxis]
    window += cover * (colour.astype(np.float32) - window)
