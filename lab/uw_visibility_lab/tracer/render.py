# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Path-traced images of a scene: in water, the veil alone, and surfaces without water."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Image
from uw_visibility_lab.simulation.phase_functions import HENYEY_GREENSTEIN, fournier_forand
from uw_visibility_lab.tracer import engine
from uw_visibility_lab.tracer.files import TRUTH, exposure, truth_of, write_truth, write_view
from uw_visibility_lab.tracer.scene import (
    FIELD_OF_VIEW,
    Description,
    camera_of,
    ground_of,
)

MOST_SCATTERED = 64
"""Largest number of events of a path. From `ROULETTE` on, paths end at random, without bias."""

ROULETTE = 8

AUXILIARY = 4
"""Divisor of the number of samples for black and bare images: veil and irradiance are smooth."""

CLEAR = 1e-3
"""Thickness of the water that remains in front of a bare surface, m."""

PHASE_ENTRIES = 1 << 18
"""Entries of a phase function's table. Light that is scattered by less than its last step, 0.22°,
is spread over that step."""

SKY_LENGTHS, SKY_REACH = 4.0, (15.0, 60.0)
"""Half side of the luminous sea surface in attenuation lengths of the clearest channel, and its
limits in m."""


@dataclass(frozen=True)
class Geometry:
    """First surfaces on the pixels' rays, float32."""

    # (H, W); Euclidean distance along the line of sight at the pixel's centre, m; NaN in open water
    ranges: Array
    reflectance: Array  # (H, W, 3); mean over the pixel; 0 in open water
    normals: Array  # (H, W, 3); mean over the pixel


class Tracer:
    """A scene in Mitsuba.

    width, height: of the image, px.
    Raises `InputError` if Mitsuba is not installed.
    """

    def __init__(
        self, description: Description, width: int, height: int, threads: int = 2
    ) -> None:
        self.mi = engine.mitsuba(threads)
        self.description, self.width, self.height = description, width, height
        self.ground = ground_of(description)
        # Axes of the camera right, down and forward, as columns.
        self._rotation = description.pose.rotation()
        self._eye = np.array(description.pose.position)
        self._scene = self.mi.load_dict(self._described())
        self._values = self.mi.traverse(self._scene)

    def geometry(self, samples: int = 16) -> Geometry:
        """Trace the view without water."""
        ranges = self._ranges()
        reflectance = []
        for channel in range(3):
            self._paint(channel)
            traced = self._traced("first", samples, 0)
            reflectance.append(traced[..., -3])
        seen = np.isfinite(ranges)[..., None]
        stacked = np.where(seen, np.stack(reflectance, -1), 0.0)
        return Geometry(ranges, stacked.astype(np.float32),
                        np.where(seen, traced[..., -6:-3], 0.0).astype(np.float32))

    def radiance(
        self, samples: int, *, black: bool = False, through_water: bool = True,
    ) -> Array:
        """Trace light.

        samples: paths for each pixel and channel.
        black: surfaces reflect nothing, so that the image is the veil.
        through_water: False: surfaces lit as at this depth, without water between them and the
            camera; open water is 0.
        Returns (H, W, 3) float32, in units of the sea surface's radiance.
        """
        image = np.zeros((self.height, self.width, 3), np.float32)
        for channel in range(3):
            self._dye(channel)
            self._paint(channel, black)
            # Every image has its own noise, which depends on the arguments only.
            seed = 2 * (
                (self.description.seed * 3 + channel) * 4 + 2 * black + (not through_water))
            name = "volpath" if through_water else "bare"
            image[..., channel] = self._traced(name, samples, seed + 1)[..., 0]
        return without_gaps(image)

    def _traced(self, name: str, samples: int, seed: int) -> Array:
        made = integrator(self.mi, name)
        image = self.mi.render(self._scene, integrator=made, spp=samples, seed=seed)
        return np.asarray(np.array(image), np.float32)

    def _ranges(self) -> Array:
        """Intersect the rays of pixels' centres, (H, W) float32, NaN without a surface."""
        mi, rig = self.mi, camera_of(self.width, self.height).rig
        rays = rig.ray_directions((self.height, self.width)).reshape(-1, 3) @ self._rotation.T
        start = mi.Point3f(*self._eye.tolist())
        if _jit(mi):
            found = np.array(self._scene.ray_intersect(mi.Ray3f(
                start, mi.Vector3f(rays.T.astype(np.float32)))).t)
        else:
            found = np.array([
                self._scene.ray_intersect(mi.Ray3f(start, mi.Vector3f(*ray))).t
                for ray in rays.tolist()])
        # The luminous sea surface does not count as a surface.
        top = self._eye[2] + found * rays[:, 2] > self._surface() - 1e-2
        found = np.where(np.isfinite(found) & ~top, found, np.nan)
        return np.asarray(found.reshape(self.height, self.width), np.float32)

    def _surface(self) -> float:
        return self.description.altitude + self.description.depth

    def _paint(self, channel: int, black: bool = False) -> None:
        values = self.ground.reflectance[:, channel] * (0.0 if black else 1.0)
        self._values["ground.vertex_rho"] = (
            self.mi.Float(values) if _jit(self.mi) else values.tolist())
        self._values.update()

    def _dye(self, channel: int) -> None:
        """Set water and lights to the values of a channel."""
        water, values = self.description.water, self._values
        values["water.sigma_t.value.value"] = float(water.beam_attenuation[channel])
        values["water.albedo.value.value"] = float(water.albedo[channel])
        if any(self.description.daylight):
            values["sky.emitter.radiance.value"] = self.description.daylight[channel]
        for k, lamp in enumerate(self.description.lamps):
            values[f"lamp{k}.intensity.value"] = lamp.power[channel]
        values.update()

    def _described(self) -> dict[str, Any]:
        mi, given = self.mi, self.description
        transform = mi.ScalarTransform4f
        _, down, forward = self._rotation.T
        phase = {"type": "hg", "g": given.water.asymmetry}
        if given.water.phase != HENYEY_GREENSTEIN:
            table = ",".join(f"{value:.6g}" for value in fournier_forand_table())
            phase = {"type": "tabphase", "values": table}
        scene: dict[str, Any] = {
            "type": "scene",
            "water": {"type": "homogeneous", "albedo": 0.5, "sigma_t": 0.3, "phase": phase},
            "sensor": {
                "type": "perspective", "fov": FIELD_OF_VIEW,
                "to_world": transform().look_at(
                    origin=self._eye.tolist(), target=(self._eye + forward).tolist(),
                    up=(-down).tolist()),
                "medium": {"type": "ref", "id": "water"},
                "film": {"type": "hdrfilm", "width": self.width, "height": self.height,
                         "rfilter": {"type": "box"}, "component_format": "float32",
                         "pixel_format": "luminance" if _jit(mi) else "rgb"},
                "sampler": {"type": "independent"}},
        }
        if any(given.daylight):
            reach = float(np.clip(
                SKY_LENGTHS / given.water.beam_attenuation.min(), *SKY_REACH))
            scene["sky"] = {
                "type": "rectangle",
                "to_world": transform().translate([3.0, 0.0, self._surface()]).rotate(
                    [1, 0, 0], 180).scale([reach, reach, 1.0]),
                "emitter": {"type": "area", "radiance": 1.0}}
        for k, lamp in enumerate(given.lamps):
            place, axis = self._eye + self._rotation @ lamp.position, self._rotation @ lamp.axis
            scene[f"lamp{k}"] = {
                "type": "spot", "cutoff_angle": lamp.beam_angle / 2.0,
                "beam_width": lamp.beam_angle / 4.0, "intensity": 1.0,
                "to_world": transform().look_at(
                    origin=place.tolist(), target=(place + axis).tolist(), up=[0, 0, 1])}
        scene["ground"] = self._meshed()
        return scene

    def _meshed(self) -> Any:
        mi, ground = self.mi, self.ground
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict({"type": "twosided", "surface": {
            "type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_rho"}}})
        mesh = mi.Mesh("ground", len(ground.vertices), len(ground.faces), props=properties)
        mesh.add_attribute("vertex_rho", 1, ground.reflectance[:, 0].astype(np.float32))
        values = mi.traverse(mesh)
        values["vertex_positions"] = ground.vertices.astype(np.float32).ravel()
        values["faces"] = ground.faces.astype(np.uint32).ravel()
        values.update()
        return mesh


def fournier_forand_table(entries: int = PHASE_ENTRIES) -> Array:
    """Fournier-Forand phase function over the cosine of the scattering angle, -1 .. 1.

    The last step has the right integral, although the function has a pole at angle 0.

    Returns (entries,) float64, 1/sr, at equal steps of the cosine; its integral over the sphere,
    linear between entries, is 1.
    """
    step = 2.0 / (entries - 1)
    cosine = np.linspace(-1.0, 1.0, entries)
    table = fournier_forand(np.arccos(cosine[:-1]))
    within = 2.0 * math.pi * step * (table.sum() - 0.5 * (table[0] + table[-1]))
    # The last step, a trapezium, has the rest of the integral, which is 1.
    last = 2.0 * (1.0 - within) / (2.0 * math.pi * step) - table[-1]
    return np.asarray(np.append(table, max(last, table[-1])))


def without_gaps(image: Image) -> Image:
    """Fill pixels that are not finite with the median of their neighbours, (H, W, 3).

    In one of some 10,000 pixels a path hits an edge, so that its direction is undefined.

    Raises `InputError` if more than one in a hundred are not finite.
    """
    gaps = ~np.isfinite(image).all(axis=-1)
    if gaps.mean() > 0.01:
        raise InputError(f"{gaps.mean():.0%} of the traced pixels are not finite: render again")
    filled = image.copy()
    for row, column in np.argwhere(gaps):
        around = image[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].reshape(-1, 3)
        known = around[np.isfinite(around).all(axis=-1)]
        filled[row, column] = np.median(known, axis=0) if len(known) else 0.0
    return filled


def _jit(mi: Any) -> bool:
    return not mi.variant().startswith("scalar")


@lru_cache(maxsize=8)
def integrator(mi: Any, name: str) -> Any:
    """Return Mitsuba's integrator: volpath, bare (see `Bare`), or first (of the first surface)."""
    water = {"type": "volpath", "max_depth": MOST_SCATTERED, "rr_depth": ROULETTE}
    if name == "volpath":
        return mi.load_dict(water)
    if name == "first":
        return mi.load_dict({"type": "aov", "aovs": "nn:sh_normal,al:albedo"})

    class Bare(mi.SamplingIntegrator):
        """Radiance of the first surface, without the water in front of it."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.inner = mi.load_dict(water)

        def sample(
            self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True,
        ) -> tuple[Any, Any, list[Any]]:
            import drjit

            met = scene.ray_intersect(ray, active)
            hit = active & met.is_valid() & (met.emitter(scene) == None)  # noqa: E711
            near = mi.RayDifferential3f(ray)
            near.o = met.p - ray.d * CLEAR
            light, _, _ = self.inner.sample(scene, sampler, near, medium, hit)
            return drjit.select(hit, light, 0.0), hit, []

    mi.register_integrator("bare", lambda properties: Bare(properties))
    return mi.load_dict({"type": "bare"})


def image_guide(surface: Image, geometry: Geometry, description: Description) -> Image:
    """Return the guide of an image in water: the surfaces' unscattered light.

    Reflectance is not suitable: it has edges of surfaces that water hides. They were copied to the
    image, with up to three times the contrast of far surfaces in the raw image, and a horizon.

    surface: (H, W, 3), radiance of the surfaces.
    Returns (H, W, 3), 0 .. 1.
    """
    far = np.where(np.isfinite(geometry.ranges), geometry.ranges, np.inf)[..., None]
    straight = surface * np.exp(-description.water.beam_attenuation * far)
    top = np.maximum(np.quantile(straight, 0.995, axis=(0, 1)), 1e-12)
    return np.asarray(np.clip(straight / top, 0.0, 1.0), np.float32)


def render_scene(
    folder: Path, description: Description, size: tuple[int, int], samples: int, threads: int = 2
) -> bool:
    """Render a scene into a folder, unless it is complete already.

    folder: made if missing.
    size: width and height, px.
    samples: paths for each pixel and channel.
    Returns whether it was rendered.
    """
    if (folder / TRUTH).exists():
        return False
    folder.mkdir(parents=True, exist_ok=True)
    tracer = Tracer(description, *size, threads)
    geometry = tracer.geometry()
    raw = tracer.radiance(samples)
    fewer = max(samples // AUXILIARY, 1)
    raw_black = tracer.radiance(fewer, black=True)
    surface = engine.denoise(
        tracer.radiance(fewer, through_water=False), geometry.reflectance, geometry.normals)
    image = engine.denoise(raw, image_guide(surface, geometry, description))
    gain = exposure(image)
    arrays: dict[str, Array] = {
        "image": np.asarray(image * gain, np.float32), "raw": raw * gain,
        "raw_black": raw_black * gain, "surface": surface * gain, "ranges": geometry.ranges,
        "reflectance": geometry.reflectance}
    write_view(folder, arrays)
    write_truth(folder, truth_of(description, camera_of(*size), gain, samples, arrays))
    return True
