# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random lamps of a vehicle at night, and their light on a view.

By `simulation.lamp_light`, without the package's tables, for an independent check of estimates by
them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics.lamps import vector
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.lamp_light import Beam, direct_light, gaussian_beam, scatter
from uw_visibility_lab.simulation.lamps import Lamp
from uw_visibility_lab.simulation.phase_functions import (
    ENTRIES,
    PHASE_FUNCTIONS,
    henyey_greenstein,
    phase_table,
)
from uw_visibility_lab.worlds.beliefs import count, draw

# Forward and backward asymmetry of the two terms, and the weight of the second: 2.3 % is scattered
# back, which is more than Petzold's 1.8 %.
_FORWARD, _BACKWARD, _SECOND = 0.95, -0.4, 0.015
# Rim: added brightness, place and width in half angles; exponent of the fall beyond the beam.
_RIM, _RIM_AT, _RIM_WIDTH, _EDGE = 0.25, 0.75, 0.15, 10
# Largest half angle of a cosine beam, rad: at 90 degrees its exponent is 0.
_WIDEST = math.radians(80.0)
# Scattered light is smooth: it is calculated at every `_STEP`-th row and column.
_STEP = 4


class Rig(NamedTuple):
    """Lamps, the water's scattering b (1/m, RGB) and table of phases, and the beams' shape."""

    lamps: tuple[Lamp, ...]
    scattering: Array
    phase: Array
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
    rig = Rig(lamps, scattering, phase_table(PHASE_FUNCTIONS[count(rng, "lamps.phase")]))
    return (
        reflectance * direct_light(rays, ranges, None, rig.lamps, attenuation),
        scattered_light(rays, ranges, rig, attenuation))


def rays_of(shape: tuple[int, ...], focal_length: float) -> Array:
    """Unit directions of an image's pixels, (H, W, 3); focal length in widths of the image."""
    height, width = shape[:2]
    return StereoCamera(width, height, focal_length * width).rig.ray_directions(shape)


def scattered_light(rays: Array, ranges: Map, rig: Rig, attenuation: Array) -> Map:
    """Light that the water scatters towards the camera, (H, W, 3) float32."""
    some = np.s_[_STEP // 2::_STEP, _STEP // 2::_STEP]
    out = scatter(
        rays[some], ranges[some], rig.lamps, attenuation, rig.scattering, rig.phase, Workers(1),
        rig.beam)
    height, width = ranges.shape
    return np.asarray(cv2.resize(out, (width, height), interpolation=cv2.INTER_LINEAR))


def cosine_beam(cosine: Array, angle: float) -> Array:
    """Beam of bare diodes, a power of the cosine; see `gaussian_beam`."""
    half = min(math.radians(angle) / 2.0, _WIDEST)
    return np.asarray(np.maximum(cosine, 0.0) ** (math.log(0.5) / math.log(math.cos(half))))


def rimmed_beam(cosine: Array, angle: float) -> Array:
    """Beam of a reflector, flat with a bright rim; see `gaussian_beam`."""
    at = np.arccos(np.clip(cosine, -1.0, 1.0)) / (math.radians(angle) / 2.0)
    bright = 1.0 + _RIM * np.exp(-(((at - _RIM_AT) / _RIM_WIDTH) ** 2))
    return np.asarray(bright / (1.0 + at**_EDGE))


def two_terms() -> Array:
    """Phases of two terms of Henyey and Greenstein (Haltrin 2002, doi:10.1364/AO.41.001022).

    Over 0 .. π rad, see `phase_table`.
    """
    angles = np.linspace(0.0, math.pi, ENTRIES)
    forward, backward = (henyey_greenstein(angles, g) for g in (_FORWARD, _BACKWARD))
    return np.asarray((1.0 - _SECOND) * forward + _SECOND * backward)


def normals_of(rays: Array, ranges: Map) -> Array:
    """Unit normals of the surfaces in view, facing the camera, (H, W, 3)."""
    points = rays * np.where(np.isfinite(ranges), ranges, 1e3)[..., np.newaxis]
    points = cv2.GaussianBlur(points.astype(np.float32), (0, 0), 2)
    down, right = np.gradient(points.astype(np.float64), axis=(0, 1))
    normal = np.cross(down, right)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    away = np.einsum("hwk,hwk->hw", normal, rays) > 0
    return np.where(away[..., np.newaxis], -normal, normal)
