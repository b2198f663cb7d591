# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random lamps of a vehicle at night, and their light on a view.

Single scattering (Jaffe 1990, doi:10.1109/48.50695) without the package's tables, for an
independent check of estimates by them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.lamps import vector
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.simulation.lamp_light import Beam, direct_light, gaussian_beam
from uw_visibility_lab.simulation.lamps import Lamp
from uw_visibility_lab.simulation.phase_functions import (
    PHASE_FUNCTIONS,
    henyey_greenstein,
    phase_table,
)
from uw_visibility_lab.worlds.beliefs import count, draw

TWO_TERMS = "two terms"
"""Phase function of two terms of Henyey and Greenstein (Haltrin 2002, doi:10.1364/AO.41.001022)."""

# Forward and backward asymmetry of the two terms, and the weight of the second: 2.3 % is scattered
# back, which is more than Petzold's 1.8 %.
_FORWARD, _BACKWARD, _SECOND = 0.95, -0.4, 0.015
# Rim: added brightness, place and width in half angles; exponent of the fall beyond the beam.
_RIM, _RIM_AT, _RIM_WIDTH, _EDGE = 0.25, 0.75, 0.15, 10
# Largest half angle of a cosine beam, rad: at 90 degrees its exponent is 0.
_WIDEST = math.radians(80.0)
# Scattered light is smooth: it is calculated at every `_STEP`-th row and column.
_STEP = 4
_NODES = 32


class Rig(NamedTuple):
    """Lamps, the water's scattering b (1/m, RGB) and phase function, and the beams' shape."""

    lamps: tuple[Lamp, ...]
    scattering: Array
    phase: str
    beam: Beam = gaussian_beam


def draw_lamps(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """Draw lamps around the camera, which point to one place in front of it."""
    colour = np.array([draw(rng, "lamps.colour") for _ in range(3)])
    beam = draw(rng, "lamps.beam")
    target = np.array((0.0, 0.0, draw(rng, "lamps.target")))
    lamps = []
    for _ in range(count(rng, "lamps.number")):
        aside, around = draw(rng, "lamps.aside"), rng.uniform(0.0, 2.0 * math.pi)
        position = np.array((
            aside * math.cos(around), aside * math.sin(around), draw(rng, "lamps.ahead")))
        power = colour * draw(rng, "lamps.power")
        lamps.append(Lamp(vector(position), vector(target - position), beam, vector(power)))
    return tuple(lamps)


def light_by_lamps(
    rng: np.random.Generator, reflectance: Map, ranges: Map, attenuation: Array
) -> tuple[Map, Map]:
    """Light of random lamps from surfaces and from the water, (H, W, 3) each.

    ranges: (H, W), m; inf in open water. attenuation: β, (3,), 1/m.
    """
    lamps = draw_lamps(rng)
    rays = rays_of(ranges.shape, draw(rng, "camera.focal_length"))
    scattering = attenuation * np.array([draw(rng, "lamps.albedo") for _ in range(3)])
    rig = Rig(lamps, scattering, PHASE_FUNCTIONS[count(rng, "lamps.phase")])
    return (
        reflectance * direct_light(rays, ranges, None, rig.lamps, attenuation),
        scattered_light(rays, ranges, rig, attenuation))


def rays_of(shape: tuple[int, ...], focal_length: float) -> Array:
    """Unit directions of an image's pixels, (H, W, 3); focal length in widths of the image."""
    height, width = shape[:2]
    # The baseline does not matter for the rays.
    rig = StereoRig(focal_length * width, 1.0, (0.5 * (width - 1), 0.5 * (height - 1)))
    return rig.ray_directions((height, width))


def scattered_light(rays: Array, ranges: Map, rig: Rig, attenuation: Array) -> Map:
    """Light that the water scatters towards the camera, (H, W, 3) float32."""
    some = np.s_[_STEP // 2::_STEP, _STEP // 2::_STEP]
    few, distance = rays[some], ranges[some].astype(np.float64)
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    angles = np.linspace(0.0, math.pi, 2048)
    phase = phase_function(rig.phase, angles)
    out = np.zeros((*distance.shape, 3))
    for lamp in rig.lamps:
        place = np.array(lamp.position)
        along = few @ place
        # The substitution s − along = h tan t turns ds / r² into dt / h (Kulla and Fajardo 2012).
        h = np.sqrt(np.maximum(place @ place - along**2, 1e-8))
        first, last = np.arctan2(-along, h), np.arctan((distance - along) / h)
        half, middle = 0.5 * (last - first), 0.5 * (last + first)
        for node, weight in zip(nodes, weights, strict=True):
            t = middle + half * node
            s, r = along + h * np.tan(t), h / np.cos(t)
            away = few * s[..., np.newaxis] - place
            light = rig.beam(away @ lamp.axis / r, lamp.beam_angle)
            light *= np.interp(0.5 * math.pi + t, angles, phase)
            light *= weight * half / h
            out += light[..., np.newaxis] * np.array(lamp.power) * np.exp(
                -attenuation * (r + s)[..., np.newaxis])
    height, width = ranges.shape
    return np.asarray(cv2.resize(
        math.pi * rig.scattering * out, (width, height), interpolation=cv2.INTER_LINEAR),
        np.float32)


def cosine_beam(cosine: Array, angle: float) -> Array:
    """Beam of bare diodes, a power of the cosine; see `gaussian_beam`."""
    half = min(math.radians(angle) / 2.0, _WIDEST)
    return np.asarray(np.maximum(cosine, 0.0) ** (math.log(0.5) / math.log(math.cos(half))))


def rimmed_beam(cosine: Array, angle: float) -> Array:
    """Beam of a reflector, flat with a bright rim; see `gaussian_beam`."""
    at = np.arccos(np.clip(cosine, -1.0, 1.0)) / (math.radians(angle) / 2.0)
    bright = 1.0 + _RIM * np.exp(-(((at - _RIM_AT) / _RIM_WIDTH) ** 2))
    return np.asarray(bright / (1.0 + at**_EDGE))


def phase_function(name: str, angle: Array) -> NDArray[np.float64]:
    """Phase function, 1/sr, at scattering angles in rad."""
    if name == TWO_TERMS:
        forward, backward = (henyey_greenstein(angle, g) for g in (_FORWARD, _BACKWARD))
        return np.asarray((1.0 - _SECOND) * forward + _SECOND * backward)
    table = phase_table(name)
    return np.interp(angle, np.linspace(0.0, math.pi, len(table)), table)


def normals_of(rays: Array, ranges: Map) -> Array:
    """Unit normals of the surfaces in view, facing the camera, (H, W, 3)."""
    points = rays * np.where(np.isfinite(ranges), ranges, 1e3)[..., np.newaxis]
    points = cv2.GaussianBlur(points.astype(np.float32), (0, 0), 2)
    down, right = np.gradient(points.astype(np.float64), axis=(0, 1))
    normal = np.cross(down, right)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    away = np.einsum("hwk,hwk->hw", normal, rays) > 0
    return np.where(away[..., np.newaxis], -normal, normal)
