# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Renderer of one stereo frame under water, with its ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import check_range
from uw_visibility.images.arrays import Array, Image8, Map
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.simulation.camera import CameraEffects, Pose, Sensor, StereoCamera
from uw_visibility.simulation.effects import add_caustics, drifting_particles, marine_snow
from uw_visibility.simulation.formation import Geometry, effective_attenuation, form_image
from uw_visibility.simulation.lamp_image import (
    LitView,
    add_lit_snow,
    check_water,
    exposure_for,
    form_lamp_image,
)
from uw_visibility.simulation.lamps import Lamp, Lighting
from uw_visibility.simulation.scene import Scene
from uw_visibility.simulation.view import View, look
from uw_visibility.simulation.water import EXPOSED, RESPONSE, Water


@dataclass(frozen=True)
class Effects:
    """Disturbances of the light model: marine snow and caustics.

    Attributes
    ----------
    marine_snow : float
        Share of the pixels that drifting particles cover, 0 .. 0.5.
    caustics : float
        Relative change of light by waves at the surface, 0 .. 1.
    snow_brightness : float
        Radiance of the particles, where open water's is 1.
    """

    marine_snow: float = 0.0
    caustics: float = 0.0
    snow_brightness: float = 1.0

    def __post_init__(self) -> None:
        """Refuse shares that are none."""
        check_range("share of marine snow", self.marine_snow, 0.0, 0.5)
        check_range("strength of caustics", self.caustics, 0.0, 1.0)
        check_range("brightness of marine snow", self.snow_brightness, 0.0, 20.0)


@dataclass(frozen=True)
class RenderedFrame:
    """Rendered stereo frame and its ground truth.

    Attributes
    ----------
    left, right : ndarray, shape (H, W, 3), uint8
        The images, RGB; linear unless the camera's effects say otherwise.
    range_left, range_right : ndarray, shape (H, W), float32
        Distance along the line of sight in m; inf = open water.
    disparity_left, disparity_right : ndarray, shape (H, W), float32
        Disparity in px, positive in both; NaN = open water.
    radiance_left, radiance_right : ndarray, shape (H, W, 3), float32
        Normalised radiance of the scene; 1 for open water. With lamps, its reflectance.
    attenuation : ndarray, shape (3,), float64
        β in 1/m, RGB; effective over the left image's ranges where the water has a
        spectrum, a layer or a plume, see `effective_attenuation`.
    ambient_light : ndarray, shape (3,), float64
        I∞ as irradiance in the image, RGB: the veil B.
    mean_attenuation : float
        α in 1/m, eq. 9.
    depth : float
        Depth of the camera in m, positive down.
    scene_light : ndarray, shape (3,), float64
        W, which lights the scene, as irradiance in the image, RGB; I∞ in the paper's water.
        Both are daylight's: 0 at night.
    lamps : tuple of Lamp
        Those that fired, with power as irradiance in the image.
    """

    left: Image8
    right: Image8
    range_left: Map
    range_right: Map
    disparity_left: Map
    disparity_right: Map
    radiance_left: Map
    radiance_right: Map
    attenuation: Array
    ambient_light: Array
    mean_attenuation: float
    depth: float
    scene_light: Array
    lamps: tuple[Lamp, ...] = ()


@dataclass(frozen=True)
class Renderer:
    """Renders frames of scenes; the same arguments give the same bits.

    Attributes
    ----------
    camera : StereoCamera
        The pair of cameras.
    sensor : Sensor
        Their noise.
    effects : Effects
        What disturbs the light model.
    workers : Workers
        Threads that do the work; their number changes nothing in the result.
    camera_effects : CameraEffects
        What the cameras do beside.
    lighting : Lighting
        Daylight, lamps, or both.
    """

    camera: StereoCamera = StereoCamera()
    sensor: Sensor = Sensor()
    effects: Effects = Effects()
    workers: Workers = field(default_factory=Workers)
    camera_effects: CameraEffects = CameraEffects()
    lighting: Lighting = Lighting()

    def render(
        self, scene: Scene, pose: Pose, water: Water, *, seed: int = 0, time: float = 0.0,
        index: int = 0,
    ) -> RenderedFrame:
        """Render one frame.

        Parameters
        ----------
        scene : Scene
            What there is to see.
        pose : Pose
            Where the left camera is.
        water : Water
            What is between.
        seed : int
            Seed of noise and marine snow; another one for each frame.
        time : float
            Time in s, for the caustics.
        index : int
            Number of the frame, for lamps that do not fire with each.

        Returns
        -------
        RenderedFrame

        Raises
        ------
        InputError
            If lamps are to light water that they are not simulated in, or are at a camera.
        """
        if self.lighting.lamps:
            check_water(water)
        rotation = pose.rotation()
        eyes = [np.array(pose.position) + k * self.camera.baseline * rotation[:, 0] for k in (0, 1)]
        rig = self.camera.rig
        rays = rig.ray_directions((self.camera.height, self.camera.width))
        with_lamps = bool(self.lighting.lamps)
        views = [
            look(scene, self.camera, eye, rotation, self.workers, surfaces=with_lamps)
            for eye in eyes
        ]
        if self.effects.caustics > 0.0:
            for view, eye in zip(views, eyes, strict=True):
                self._shine(view, scene, eye, rays @ rotation.T, time)
        geometry = Geometry.of_rays(rays, rotation[2], pose.position[2])
        lamps = self.lighting.of_frame(index, seed)
        exposure = 1.0
        if with_lamps:
            lit = [
                LitView(view, rays, rotation, k * self.camera.baseline, self.camera.focal_length)
                for k, view in enumerate(views)
            ]
            light, exposure = self._expose_lamps(lit, geometry, water, lamps, seed)
        else:
            light = self.daylight(views, geometry, water, seed)
        images, gains = self.record(light, seed)
        disparities = [
            rig.disparity_from_range(np.where(np.isfinite(view.range), view.range, np.nan))
            for view in views
        ]
        radiances = [
            np.where(
                np.isfinite(v.range)[..., np.newaxis],
                v.radiance if v.surfaces is None else v.surfaces.reflectance, np.float32(1.0),
            )
            for v in views
        ]
        attenuation = effective_attenuation(views[0].range, geometry, water)
        daylight = replace(water, exposure=1.0) if with_lamps else water
        scale = exposure * gains * float(self.lighting.daylight)
        return RenderedFrame(
            images[0], images[1], views[0].range, views[1].range, disparities[0], disparities[1],
            radiances[0], radiances[1], attenuation, scale * daylight.ambient_light(),
            mean_attenuation(attenuation, water), water.depth, scale * daylight.scene_light(),
            tuple(lamp.scaled(exposure * gains) for lamp in lamps),
        )

    def daylight(
        self, views: Sequence[View], geometry: Geometry, water: Water, seed: int
    ) -> list[Map]:
        """Return the irradiance of the left view, or of both, with marine snow in it."""
        snow = marine_snow(
            self.camera, self.effects.marine_snow, np.random.default_rng([seed, 2]))
        particles = (self.effects.snow_brightness * water.ambient_light()).astype(np.float32)
        light = []
        for view, cover in zip(views, snow, strict=False):
            irradiance = form_image(view, geometry, water)
            irradiance += cover[..., np.newaxis] * (particles - irradiance)
            light.append(irradiance)
        return light

    def record(self, light: Sequence[Map], seed: int) -> tuple[list[Image8], Array]:
        """Return what the camera makes of the views' irradiance, and its gains."""
        gains = self.camera_effects.gains(light[0])
        images = [
            self.camera_effects.record(
                irradiance, self.sensor, np.random.default_rng([seed, side]), gains,
                right=side == 1,
            )
            for side, irradiance in enumerate(light)
        ]
        return images, gains

    def exposure_for(self, scene: Scene, pose: Pose, water: Water) -> float:
        """Return the exposure that suits a frame under lamps, from a small picture of it."""
        width, height = (max(8, n // 8) for n in (self.camera.width, self.camera.height))
        small = StereoCamera(
            width, height, self.camera.focal_length * width / self.camera.width,
            self.camera.baseline,
        )
        rotation = pose.rotation()
        view = look(
            scene, small, np.array(pose.position), rotation, self.workers, surfaces=True)
        rays = small.rig.ray_directions((height, width))
        geometry = Geometry.of_rays(rays, rotation[2], pose.position[2])
        lit = LitView(view, rays, rotation, 0.0, small.focal_length)
        light = self._lamp_light(lit, geometry, replace(water, exposure=1.0), self.lighting.lamps)
        return exposure_for(light, EXPOSED)

    def _shine(
        self, view: View, scene: Scene, eye: Array, rays: Array, time: float
    ) -> None:
        amplitude = self.effects.caustics
        with np.errstate(invalid="ignore"):  # open water is infinitely far
            points = eye + view.range[..., np.newaxis] * rays
            quarters = eye + view.edge_range[..., np.newaxis] * rays[view.edges][:, np.newaxis]
        for radiance, where in ((view.radiance, points), (view.edge_radiance, quarters)):
            add_caustics(
                radiance.reshape(-1, 3), where.reshape(-1, 3), scene.lattice, amplitude, time
            )

    def _expose_lamps(
        self, lit: list[LitView], geometry: Geometry, water: Water, lamps: tuple[Lamp, ...],
        seed: int,
    ) -> tuple[list[Map], float]:
        """Return both images' irradiance under lamps, with snow, and the exposure."""
        source = replace(water, exposure=1.0)
        light = [self._lamp_light(view, geometry, source, lamps) for view in lit]
        exposure = water.exposure
        if exposure is None:
            exposure = exposure_for(light[0], EXPOSED)
        particles = drifting_particles(
            self.camera, self.effects.marine_snow, np.random.default_rng([seed, 2]))
        background = float(self.lighting.daylight) * source.ambient_light()
        for view, irradiance in zip(lit, light, strict=True):
            add_lit_snow(
                irradiance, view, particles, background, self.effects.snow_brightness, lamps,
                source.attenuation(),
            )
            irradiance *= np.float32(exposure)
        return light, exposure

    def _lamp_light(
        self, lit: LitView, geometry: Geometry, water: Water, lamps: tuple[Lamp, ...]
    ) -> Map:
        irradiance = form_lamp_image(lit, water, self.lighting, lamps, self.workers)
        if self.lighting.daylight:
            irradiance += form_image(lit.view, geometry, water)
        return irradiance


def mean_attenuation(attenuation: Array, water: Water) -> float:
    """Return α (eq. 9) of an effective attenuation; of the paper's water as it was given."""
    grey = water.effects.water_type is None and not any(water.effects.channel_attenuation)
    if grey and np.array_equal(attenuation, water.attenuation()):
        return water.mean_attenuation
    clear = clear_water_attenuation(load_response(RESPONSE))
    return float(np.mean(attenuation - clear))
