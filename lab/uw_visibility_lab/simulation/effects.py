# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Marine snow and caustics, which the light model leaves out."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Map
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.noise import value_noise


class Snow(NamedTuple):
    """Particles that drift before the cameras."""

    places: Array  # (n, 3); in the left camera's optical frame, m
    sigma: Array  # (n,); standard deviation of their images, px
    opacity: Array  # (n,); share of the light behind their middles that they hide


@njit(nogil=True, error_model="numpy")
def add_caustics(radiance: Any, points: Any, lattice: Any, amplitude: float, time: float) -> None:
    """Caustics: modulate radiance (n, 3) in place as waves at the surface focus the light.

    points: (n, 3), where in the scene that light comes from in m; not finite = nowhere.
    amplitude: largest relative change, 0 .. 1. time: in s; the pattern wanders.
    """
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        if not math.isfinite(x):
            continue
        # Bright lines run where the noise is near zero, as in a real caustic net.
        net = value_noise(lattice, 3.1 * x + 0.4 * time, 3.1 * y, 0.9 * time)
        fine = value_noise(lattice, 7.3 * y, 7.3 * x - 0.6 * time, 1.3 * time + 20.0)
        line = math.exp(-6.0 * abs(net + 0.3 * fine))
        gain = 1.0 + amplitude * (2.0 * line - 1.0)
        for channel in range(3):
            radiance[k, channel] *= gain


def drift(camera: StereoCamera, fraction: float, random: np.random.Generator) -> Snow:
    """Draw the particles of marine snow, which cover a fraction of the pixels of each image."""
    rows = []
    wanted = fraction * camera.width * camera.height
    covered = 0.0
    centre = np.array(camera.principal_point)
    while covered < wanted:
        depth = 0.4 * math.exp(random.uniform(0.0, 2.0))
        disparity = camera.focal_length * camera.baseline / depth
        # Beyond the left image's right edge there is what the right one sees.
        column = random.uniform(0.0, camera.width + disparity)
        row = random.uniform(0.0, camera.height)
        # Near particles are larger, and out of focus.
        sigma = 0.5 + random.exponential(0.5) / depth
        place = (np.array([column, row]) - centre) / camera.focal_length * depth
        rows.append([*place, depth, sigma, random.uniform(0.3, 0.9)])
        covered += math.pi * (1.5 * sigma) ** 2
    found = np.array(rows).reshape(-1, 5)
    return Snow(found[:, :3], found[:, 3], found[:, 4])


def add_snow(
    irradiance: Map, ranges: Map, camera: StereoCamera, snow: Snow, points: Array, colours: Array
) -> None:
    """Marine snow: draw particles into an image, in place, but for those behind a surface.

    ranges: (H, W), m. points: (n, 3), the particles' places in the image's own optical frame, m.
    colours: (n, 3), irradiance of each where it hides all.
    """
    last = (camera.width - 1, camera.height - 1)
    pixels = points[:, :2] / points[:, 2:] * camera.focal_length + camera.principal_point
    inside = np.clip(np.rint(pixels), 0, last).astype(int)
    hidden = np.linalg.norm(points, axis=1) > ranges[inside[:, 1], inside[:, 0]]
    for k in np.flatnonzero(~hidden):
        column, row = pixels[k]
        reach = math.ceil(3.0 * snow.sigma[k])
        rows = slice(max(int(row) - reach, 0), max(int(row) + reach + 1, 0))
        columns = slice(max(int(column) - reach, 0), max(int(column) + reach + 1, 0))
        window = irradiance[rows, columns]
        y = np.arange(rows.start, rows.start + window.shape[0]) - row
        x = np.arange(columns.start, columns.start + window.shape[1]) - column
        squared = (x[np.newaxis] ** 2 + y[:, np.newaxis] ** 2) / (2.0 * snow.sigma[k] ** 2)
        opacity = (snow.opacity[k] * np.exp(-squared)).astype(np.float32)[..., np.newaxis]
        window += opacity * (colours[k].astype(np.float32) - window)
