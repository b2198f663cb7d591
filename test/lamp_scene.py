# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scenes lit by lamps, by quadrature along every ray: nothing is shared with the package."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.stereo.rig import StereoRig

Array = NDArray[np.float64]

SIZE = (144, 208)
FOCAL_LENGTH = 180.0
BASELINE = 0.12
CLEAR_WATER = np.array([0.228, 0.066, 0.025])
# Position, direction, full angle at half the power.
LAMPS = (
    ((-0.6, 0.1, 0.05), (0.2, 0.0, 1.0), 80.0),
    ((0.6, 0.1, 0.05), (-0.2, 0.0, 1.0), 80.0),
)


RIG = StereoRig(FOCAL_LENGTH, BASELINE, ((SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2))


@dataclass(frozen=True)
class LampScene:
    """An image with its truth.

    Attributes
    ----------
    image : (H, W, 3) uint16 ndarray
    range : (H, W) float32 ndarray
    reflectance, direct, scattered : (H, W, 3) float64 ndarray
        E = reflectance * direct + scattered.
    attenuation : (3,) float64 ndarray
    """

    image: NDArray[np.uint16]
    range: NDArray[np.float32]
    reflectance: Array
    direct: Array
    scattered: Array
    attenuation: Array


def parameters(lamps: Any = LAMPS, model: str = "lamps") -> dict[str, Any]:
    """The lamps as parameters."""
    return {
        "lighting.model": model,
        "lighting.positions": [v for lamp in lamps for v in lamp[0]],
        "lighting.directions": [v for lamp in lamps for v in lamp[1]],
        "lighting.beam_angles": [lamp[2] for lamp in lamps],
    }


@lru_cache
def rays() -> Array:
    """Return the unit vectors of all pixels, (H, W, 3); not to be changed."""
    height, width = SIZE
    x = (np.arange(width) - (width - 1) / 2) / FOCAL_LENGTH
    y = (np.arange(height) - (height - 1) / 2) / FOCAL_LENGTH
    directions = np.stack(np.broadcast_arrays(x, y[:, None], 1.0), axis=2)
    return np.asarray(directions / np.linalg.norm(directions, axis=2, keepdims=True))


def ground(altitude: float = 1.5, tilt: float = 25.0) -> Array:
    """Range to a plane below a camera that looks down by an angle, degrees."""
    down = np.array([0.0, math.cos(math.radians(tilt)), math.sin(math.radians(tilt))])
    return np.asarray(np.minimum(altitude / np.maximum(rays() @ down, 1e-3), 12.0))


def texture(seed: int, distance: Array, shift: float | Array = 0.0) -> Array:
    """Reflectance of three channels that depends on the place on the ground alone.

    A vector moves the camera, m; a number changes the ground.
    """
    points = rays() * distance[..., None]
    rng = np.random.default_rng(seed)
    value = np.zeros(SIZE)
    for scale in (0.4, 0.2, 0.1, 0.05):
        for _ in range(6):
            direction = rng.normal(size=3)
            direction /= np.linalg.norm(direction)
            phase = rng.uniform(0, 2 * math.pi)
            along = shift @ direction if isinstance(shift, np.ndarray) else shift
            value += scale**0.5 * np.sin(
                2 * math.pi / scale * (points @ direction + along) + phase)
    value = 0.04 + 0.86 / (1.0 + np.exp(-2.0 * value))
    return np.asarray(value[..., None] * np.array([1.0, 0.95, 0.9]))


def shine(s: Array, position: Any, axis: Array, angle: float) -> tuple[Array, Array, Array]:
    """Distance from a lamp, g/r² and cosine of scattering of points along the rays."""
    position = np.array(position)
    # Products of the unit vector d of each ray; from the lamp leads a = s d - position.
    along_lamp, along_axis = rays() @ position, rays() @ axis
    r = np.sqrt(s * s - 2 * s * along_lamp + position @ position)
    theta = np.degrees(np.arccos(np.clip((s * along_axis - position @ axis) / r, -1, 1)))
    power = np.exp(-math.log(2) * (2 * theta / angle) ** 2) / r**2
    return r, power, (along_lamp - s) / r


def light(
    distance: Array, beta: Array, lamps: Any = LAMPS, asymmetry: float = 0.9
) -> tuple[Array, Array]:
    """D and S of every pixel, (H, W, 3) each, by 60 steps along every ray; not to be changed."""
    return _light(
        np.asarray(distance, np.float64).tobytes(), tuple(beta),
        tuple((tuple(place), tuple(axis), angle) for place, axis, angle in lamps), asymmetry)


# Many images are of one ground in one water, and differ in texture and noise.
@lru_cache
def _light(
    ranges: bytes, attenuation: tuple[float, ...], lamps: Any, asymmetry: float
) -> tuple[Array, Array]:
    distance, beta = np.frombuffer(ranges).reshape(SIZE), np.array(attenuation)
    direct, scattered = np.zeros((*SIZE, 3)), np.zeros((*SIZE, 3))
    steps = (np.arange(60) + 0.5) / 60
    for position, axis, angle in lamps:
        axis = np.array(axis) / np.linalg.norm(axis)
        r, power, _ = shine(distance, position, axis, angle)
        direct += power[..., None] * np.exp(-beta * (r + distance)[..., None])
        for u in steps:
            # Denser near the camera.
            s = u**2 * distance
            r, power, cosine = shine(s, position, axis, angle)
            phase = (1 - asymmetry**2) / (4 * math.pi) / (
                1 + asymmetry**2 - 2 * asymmetry * cosine) ** 1.5
            scattered += (phase * power * 2 * u * distance / 60)[..., None] * np.exp(
                -beta * (r + s)[..., None])
    for each in (direct, scattered):
        each.flags.writeable = False
    return direct, scattered


def render(
    alpha: float, *, seed: int = 0, distance: Array | None = None, lamps: Any = LAMPS,
    albedo: float = 0.7, exposure: float | None = None, noise: float = 1e-3,
    shift: float | Array = 0.0, daylight: float = 0.0,
) -> LampScene:
    """Render an image; `daylight` is its light W, with a veil of half of it."""
    distance = ground() if distance is None else distance
    beta = CLEAR_WATER + alpha
    direct, scattered = light(distance, beta, lamps)
    left = np.exp(-beta * distance[..., None])
    direct = direct + math.pi * daylight * left
    scattered = math.pi * albedo * alpha * scattered + math.pi * daylight / 2 * (1 - left)
    reflectance = texture(seed, distance, shift)
    irradiance = reflectance * direct + scattered
    scale = exposure or 0.8 / np.quantile(irradiance, 0.999)
    noisy = irradiance * scale + np.random.default_rng(seed).normal(0, noise, irradiance.shape)
    return LampScene(
        np.clip(noisy * 65535 + 0.5, 0, 65535).astype(np.uint16), distance.astype(np.float32),
        reflectance, direct * scale, scattered * scale, beta)
