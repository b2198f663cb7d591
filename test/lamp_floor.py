# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Points of a lamp-lit floor that a camera passes, as frames see them."""

from __future__ import annotations

import math

import numpy as np
from lamp_scene import LAMPS, Array, parameters

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.water.lamps.tracks import Sightings

BETA = np.array([0.42, 0.26, 0.2])
LIGHTING = PipelineConfig.from_parameters(parameters()).lighting
POINTS = 400


def sightings(
    exponent: float = 1.0, noise: float = 0.02, brighter: float = 0.0, frames: int = 24,
    power: float = 0.0, outshone: float | None = None,
) -> list[Sightings]:
    """Points of a floor that a camera passes, rising and sinking.

    `brighter`: slope of their reflectance's logarithm over the place along the line, 1/m;
    `power`: deviation of the logarithm of power from frame to frame; `outshone`: part of the
    points that are nearly black, in water that shines; without it the water does not.
    """
    rng = np.random.default_rng(0)
    floor = np.stack([rng.uniform(-1.5, 6.0, POINTS), rng.uniform(-0.8, 0.8, POINTS)], axis=1)
    reflectance = rng.lognormal(-1.2, 0.5, (POINTS, 1)) * np.exp(brighter * floor[:, :1])
    black = np.random.default_rng(1).random(POINTS) < (outshone or 0.0)
    reflectance[black] *= 0.03
    out = []
    for k in range(frames):
        altitude = 2.0 + 0.5 * math.sin(0.6 * k)
        points = np.column_stack([floor - [0.2 * k, 0.0], np.full(POINTS, altitude)])
        seen = (np.abs(points[:, 0]) < 0.6 * altitude) & (np.abs(points[:, 1]) < 0.45 * altitude)
        points = points[seen]
        distance = np.linalg.norm(points, axis=1)
        direct = np.zeros((len(points), 3))
        for place, axis, angle in LAMPS:
            away = points - place
            r, lit = _lit(away, np.array(axis), angle)
            lit = lit * (away[:, 2] / r) ** exponent
            direct += lit[:, None] * np.exp(-BETA * (r + distance)[:, None])
        light = reflectance[seen] * direct * np.exp(
            rng.normal(0, noise, direct.shape) + power * rng.normal())
        if outshone is not None:
            light += _scattered(points, distance)
        number = np.flatnonzero(seen)
        normal = np.tile([0.0, 0.0, -1.0], (len(points), 1))
        out.append(Sightings(
            light, points / distance[:, None], normal, distance, np.zeros(len(number)), number,
            number % 16))
    return out


def _lit(away: Array, axis: Array, angle: float) -> tuple[Array, Array]:
    """Distance from a lamp, and g/r²."""
    r = np.linalg.norm(away, axis=1)
    theta = np.degrees(np.arccos(away @ axis / np.linalg.norm(axis) / r))
    return r, np.exp(-math.log(2) * (2 * theta / angle) ** 2) / r**2


def _scattered(points: Array, distance: Array, albedo: float = 0.7, g: float = 0.9) -> Array:
    """What water adds in front of points, by 40 steps along every ray, (N, 3)."""
    out = np.zeros((len(points), 3))
    directions = points / distance[:, None]
    for place, axis, angle in LAMPS:
        for u in (np.arange(40) + 0.5) / 40:
            s = u * distance
            away = directions * s[:, None] - np.array(place)
            r, lit = _lit(away, np.array(axis), angle)
            cosine = -(away * directions).sum(axis=1) / r
            phase = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cosine) ** 1.5)
            out += (lit * phase * distance / 40)[:, None] * np.exp(-BETA * (r + s)[:, None])
    return np.asarray(math.pi * albedo * BETA * out)
