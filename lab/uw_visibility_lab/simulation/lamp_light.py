# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Light of lamps in water: on surfaces, on particles, and scattered towards the camera.

Single scattering, as in J. S. Jaffe, Computer modeling and the design of optimal
underwater imaging systems, IEEE J. Oceanic Engineering 15 (1990), doi 10.1109/48.50695. A
lamp of power P (irradiance of white at 1 m), a range d and the distance r from lamp to
surface give, with Lambertian surfaces,

    E = P ρ cos i g(θ) e^(−β (r + d)) / r²  +  π P b ∫_0^d g(θ) p(ψ) e^(−β (r(s) + s)) / r(s)² ds

where g is the beam's shape and p the phase function. On the ray, the substitution
s − s0 = h tan t, with the distance h of the lamp from the ray, turns ds / r² into dt / h
(C. Kulla and M. Fajardo, Computer Graphics Forum 31 (2012), doi
10.1111/j.1467-8659.2012.03148.x). The rest is smooth: Gauss-Legendre quadrature at every pixel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.config.lighting import beam_falloff
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.lamps import beam as gaussian_beam
from uw_visibility_lab.simulation.formation import blur_by_range
from uw_visibility_lab.simulation.lamps import Lamp, Lighting
from uw_visibility_lab.simulation.phase_functions import ENTRIES, phase_table
from uw_visibility_lab.simulation.view import View
from uw_visibility_lab.simulation.water import EXPOSED, Water

NEAREST = 0.01
"""Least distance of a lamp from a camera in m; at 0 the scattered light is infinite."""

# Surfaces nearer to a lamp are lit as at this distance, m.
_NEAREST_SURFACE = 0.02

Beam = Callable[[Array, float], Array]
"""Relative power by cosine of the angle from the axis, and `Lamp.beam_angle`."""

NODES = 24
"""Quadrature nodes for beams of 60 degrees and more, exact to 1e-5; narrower ones need more."""


def seen_from(lamps: tuple[Lamp, ...], offset: float) -> tuple[Lamp, ...]:
    """Return lamps in the frame of a camera with an offset (m) along the left one's x axis."""
    return tuple(
        replace(lamp, position=(lamp.position[0] - offset, *lamp.position[1:])) for lamp in lamps)


def direct_light(
    rays: Array, ranges: Map, normals: Array | None, lamps: Sequence[Lamp], beta: Array,
    beam: Beam = gaussian_beam, exponent: float = 1.0,
) -> Map:
    """Irradiance at the camera from white surfaces, (..., 3) float32; 0 without a surface.

    rays: (..., 3), unit directions in the camera's frame. ranges: (...), m; inf = no surface.
    normals: in the camera's frame; without them every surface faces every lamp.
    exponent: of the cosine of incidence (Minnaert 1941, doi:10.1086/144279).
    """
    known = np.isfinite(ranges)
    distance = np.where(known, ranges, 1.0).astype(np.float64)
    out = np.zeros((*ranges.shape, 3))
    for lamp in lamps:
        away = rays * distance[..., np.newaxis] - np.array(lamp.position)
        r = np.maximum(np.linalg.norm(away, axis=-1), _NEAREST_SURFACE)
        light = beam(away @ lamp.axis / r, lamp.beam_angle) / r**2
        if normals is not None:
            light *= np.maximum(-np.einsum("...k,...k->...", away, normals) / r, 0.0)**exponent
        path = (r + distance)[..., np.newaxis]
        out += np.array(lamp.power) * light[..., np.newaxis] * np.exp(-beta * path)
    out[~known] = 0.0
    return out.astype(np.float32)


def scatter(
    rays: Array, ranges: Map, lamps: Sequence[Lamp], beta: Array, scattering: Array,
    phase: Array, workers: Workers, beam: Beam = gaussian_beam,
) -> Map:
    """Backscatter: light of the lamps that the water scatters to the camera.

    rays, ranges: as in `direct_light`. scattering: b in 1/m, RGB. phase: as `phase_table` has it.
    """
    scattered = np.zeros((*ranges.shape, 3), np.float32)
    if not scattering.any():
        return scattered
    if any(np.linalg.norm(lamp.position) < NEAREST for lamp in lamps):
        raise InputError(
            f"a lamp lies within {NEAREST:g} m of a camera: move it, or set the scattering "
            "albedo to 0"
        )
    rows = np.array([[*lamp.position, *lamp.axis, *lamp.power] for lamp in lamps]).reshape(-1, 9)
    cosines = np.cos(np.linspace(0.0, math.pi, ENTRIES))
    beams = np.array([beam(cosines, lamp.beam_angle) for lamp in lamps]).reshape(-1, ENTRIES)
    # Narrower beams light a shorter part of a ray, for which the nodes must be denser.
    narrowest = max((beam_falloff(lamp.beam_angle) for lamp in lamps), default=0.0)
    widening = math.sqrt(narrowest / beam_falloff(60.0))
    nodes, weights = np.polynomial.legendre.leggauss(math.ceil(NODES * max(1.0, widening)))
    workers.rows(
        _scatter, ranges.size, rays.reshape(-1, 3), ranges.ravel(), rows, beams, beta, scattering,
        phase, nodes, weights, scattered.reshape(-1, 3),
    )
    return scattered


@njit(nogil=True, error_model="numpy")
def _at_angle(table: Any, angle: float) -> float:
    """Interpolate a table over 0 .. π rad."""
    place = angle * ((len(table) - 1) / math.pi)
    index = index_of(place, 0, len(table) - 2)
    return table[index] + (place - index) * (table[index + 1] - table[index])


@njit(nogil=True, error_model="numpy")
def _scatter(
    start: int, stop: int, rays: Any, ranges: Any, lamps: Any, beams: Any, beta: Any,
    scattering: Any, phase: Any, nodes: Any, weights: Any, scattered: Any,
) -> None:
    for sample in range(start, stop):
        ray, distance = rays[sample], float(ranges[sample])
        for number in range(len(lamps)):
            lamp, beam = lamps[number], beams[number]
            along = lamp[0] * ray[0] + lamp[1] * ray[1] + lamp[2] * ray[2]
            # Vector from the lamp to the nearest point of the ray.
            ax, ay, az = (
                along * ray[0] - lamp[0], along * ray[1] - lamp[1], along * ray[2] - lamp[2])
            h = max(math.sqrt(ax * ax + ay * ay + az * az), 1e-6)
            across = (ax * lamp[3] + ay * lamp[4] + az * lamp[5]) / h
            onwards = ray[0] * lamp[3] + ray[1] * lamp[4] + ray[2] * lamp[5]
            first, last = math.atan(-along / h), math.atan((distance - along) / h)
            half, middle = 0.5 * (last - first), 0.5 * (last + first)
            red = green = blue = 0.0
            for k in range(len(nodes)):
                t = middle + half * nodes[k]
                sine, cosine = math.sin(t), math.cos(t)
                angle = math.acos(min(max(across * cosine + onwards * sine, -1.0), 1.0))
                light = weights[k] * _at_angle(beam, angle) * _at_angle(phase, t + 0.5 * math.pi)
                path = along + h * (sine + 1.0) / cosine
                red += light * math.exp(-beta[0] * path)
                green += light * math.exp(-beta[1] * path)
                blue += light * math.exp(-beta[2] * path)
            scale = math.pi * half / h
            scattered[sample, 0] += scale * lamp[6] * scattering[0] * red
            scattered[sample, 1] += scale * lamp[7] * scattering[1] * green
            scattered[sample, 2] += scale * lamp[8] * scattering[2] * blue


def check_water(water: Water) -> None:
    """Refuse water in which lamps cannot be simulated."""
    effects = water.effects
    if effects.water_type is not None or effects.layer > 0.0 or effects.plume > 0.0:
        raise InputError(
            "lamps are simulated in water of one attenuation per channel: leave out the lamps, "
            "or water type, layer and plume"
        )


def form_lamp_image(
    view: View, water: Water, lighting: Lighting, lamps: Sequence[Lamp], workers: Workers
) -> Map:
    """Irradiance of an image by lamps alone; `lamps` are in the camera's frame."""
    beta = water.attenuation()
    facing = view.normals @ view.rotation if lighting.shaded else None
    direct = view.image(
        view.reflectance * direct_light(view.rays, view.ranges, facing, lamps, beta))
    veil = view.image(scatter(
        view.rays, view.ranges, lamps, beta, beta * lighting.scattering_albedo,
        phase_table(lighting.phase_function), workers))
    if water.effects.blur > 0.0:
        direct = blur_by_range(direct, view.range, water.effects.blur)
    return direct + veil


def exposure_for(irradiance: Map) -> float:
    """Gain that brings the 99th percentile of the pixels' brightest channel to `EXPOSED`."""
    bright = float(np.percentile(irradiance.max(axis=2), 99.0))
    return EXPOSED / bright if bright > 0.0 else 1.0
