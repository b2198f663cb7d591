# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Random lamps of a vehicle at night, and their light on a view."""

from __future__ import annotations

import math

import cv2
import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array, Map
from uw_visibility.stereo.rig import StereoRig
from uw_visibility_lab.simulation.lamp_light import lamp_array, light_surfaces, scatter
from uw_visibility_lab.simulation.lamps import Lamp, Triple
from uw_visibility_lab.simulation.phase_functions import PHASE_FUNCTIONS
from uw_visibility_lab.worlds.beliefs import count, draw

# Scattered light is smooth: it is calculated in every so many-th row and column.
_STEP = 4


def draw_lamps(rng: np.random.Generator) -> tuple[Lamp, ...]:
    """Draw lamps beside the camera, which point to one place before it."""
    colour = np.array([draw(rng, "lamps.colour") for _ in range(3)])
    beam = draw(rng, "lamps.beam")
    target = np.array((0.0, 0.0, draw(rng, "lamps.target")))
    lamps = []
    for _ in range(count(rng, "lamps.number")):
        aside, around = draw(rng, "lamps.aside"), rng.uniform(0.0, 2.0 * math.pi)
        position = np.array((
            aside * math.cos(around), aside * math.sin(around), draw(rng, "lamps.ahead")))
        power = colour * draw(rng, "lamps.power")
        lamps.append(Lamp(_triple(position), _triple(target - position), beam, _triple(power)))
    return tuple(lamps)


def light_by_lamps(
    rng: np.random.Generator, reflectance: Map, ranges: Map, attenuation: Array
) -> tuple[Map, Map]:
    """Light of random lamps by surfaces and by the water, (H, W, 3) float32 each.

    Parameters
    ----------
    rng : numpy.random.Generator
    reflectance : (H, W, 3) float32 ndarray
    ranges : (H, W) float32 ndarray
        m; inf where nothing is.
    attenuation : (3,) float64 ndarray
        β, 1/m.
    """
    lamps = lamp_array(draw_lamps(rng), 0.0)
    height, width = ranges.shape
    focal = draw(rng, "camera.focal_length") * width
    # Of one camera: the baseline does not matter.
    rays = StereoRig(focal, 1.0, (0.5 * (width - 1), 0.5 * (height - 1))).ray_directions(
        (height, width))
    workers = Workers(1)
    direct = light_surfaces(rays, ranges, reflectance, None, lamps, attenuation, workers)
    scattering = attenuation * np.array([draw(rng, "lamps.albedo") for _ in range(3)])
    phase = PHASE_FUNCTIONS[count(rng, "lamps.phase")]
    some = np.s_[_STEP // 2::_STEP, _STEP // 2::_STEP]
    veil = scatter(
        np.ascontiguousarray(rays[some]), np.ascontiguousarray(ranges[some]), lamps, attenuation,
        scattering, phase, workers)
    return direct, np.asarray(
        cv2.resize(veil, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def _triple(values: Array) -> Triple:
    x, y, z = values.tolist()
    return x, y, z
