# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image formation under lamps: surfaces, scattered light, and snow that they light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Map
from uw_visibility_lab.simulation import lamp_light
from uw_visibility_lab.simulation.effects import Particle, blot
from uw_visibility_lab.simulation.formation import Geometry, blur_by_range
from uw_visibility_lab.simulation.lamps import Lamp, Lighting
from uw_visibility_lab.simulation.view import View
from uw_visibility_lab.simulation.water import Water

BRIGHT = 99.0
"""Percentile of an image that automatic exposure looks at."""


@dataclass(frozen=True)
class CameraView:
    """One camera of the vehicle, and what it sees in air."""

    view: View
    geometry: Geometry
    rays: Array  # (H, W, 3); unit directions of its pixels in its optical frame
    eye: Array  # (3,); position in the world, m
    rotation: Array  # (3, 3); axes of its optical frame in the world, as columns
    offset: float  # its place on the left camera's x axis, m
    focal_length: float  # px


def check_water(water: Water) -> None:
    """Refuse water that lamps are not simulated in."""
    effects = water.effects
    if effects.water_type is not None or effects.layer > 0.0 or effects.plume > 0.0:
        raise InputError(
            "lamps are simulated in water of one attenuation per channel: leave out the lamps, "
            "or water type, layer and plume"
        )


def form_lamp_image(
    lit: CameraView, water: Water, lighting: Lighting, lamps: tuple[Lamp, ...], workers: Workers
) -> Map:
    """Irradiance of an image by the light of lamps alone; 0 without lamps."""
    view, surfaces = lit.view, lit.view.surfaces
    if surfaces is None:
        raise ValueError("the view has no surfaces: look with surfaces=True")
    beta = water.attenuation()
    scattering = beta * lighting.scattering_albedo
    array = lamp_light.lamp_array(lamps, lit.offset)

    def parts(rays: Array, ranges: Map, reflectance: Map, normals: Map) -> tuple[Map, Map]:
        facing = (normals @ lit.rotation).astype(np.float32) if lighting.shaded else None
        return (
            lamp_light.light_surfaces(rays, ranges, reflectance, facing, array, beta, workers),
            lamp_light.scatter(
                rays, ranges, array, beta, scattering, lighting.phase_function, workers),
        )

    direct, veil = parts(lit.rays, view.range, surfaces.reflectance, surfaces.normals)
    if len(view.edge_range) > 0:
        # A pixel at an edge is the mean of what its quarters see.
        quarters = np.repeat(lit.rays[view.edges][:, np.newaxis], 4, axis=1)
        edges = parts(quarters, view.edge_range, surfaces.edge_reflectance, surfaces.edge_normals)
        direct[view.edges], veil[view.edges] = (part.mean(axis=1) for part in edges)
    if water.effects.blur > 0.0:
        direct = blur_by_range(direct, view.range, water.effects.blur)
    return direct + veil


def add_lit_snow(
    irradiance: Map, lit: CameraView, particles: Sequence[Particle], background: Array,
    brightness: float, lamps: tuple[Lamp, ...], beta: Array,
) -> None:
    """Marine snow in the light of lamps: white particles, bright where lamps are near.

    irradiance: image that they drift before; changed in place.
    background: irradiance of a particle in daylight, RGB.
    brightness: reflectance of the particles, where white is 1.
    """
    if not particles:
        return
    height, width = lit.view.range.shape
    centre = ((width - 1) / 2, (height - 1) / 2)
    shift = lit.focal_length * lit.offset
    u, v, z = (
        np.array([getattr(p, name) for p in particles]) for name in ("column", "row", "depth"))
    u = u - shift / z
    points = np.stack([
        (u - centre[0]) / lit.focal_length * z, (v - centre[1]) / lit.focal_length * z, z,
    ], axis=1)
    light = lamp_light.irradiance_on(points, lamp_light.lamp_array(lamps, lit.offset), beta)
    colours = (brightness * (light + background)).astype(np.float32)
    distances = np.linalg.norm(points, axis=1)
    for k, particle in enumerate(particles):
        column, row = (int(np.clip(round(x), 0, n - 1)) for x, n in ((u[k], width), (v[k], height)))
        if distances[k] > lit.view.range[row, column]:
            continue
        cover = np.zeros((height, width), np.float32)
        window = blot(cover, float(u[k]), float(v[k]), particle.sigma, particle.opacity)
        opacity = cover[window][..., np.newaxis]
        irradiance[window] += opacity * (colours[k] - irradiance[window])


def exposure_for(irradiance: Map, exposed: float) -> float:
    """Gain that brings the 99th percentile of the strongest channel to an irradiance."""
    bright = float(np.percentile(irradiance.max(axis=2), BRIGHT))
    return exposed / bright if bright > 0.0 else 1.0
