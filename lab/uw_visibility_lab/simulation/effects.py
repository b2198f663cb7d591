# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Marine snow and caustics, which the light model leaves out."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Map
from uw_visibility_lab.simulation.camera import StereoCamera
from uw_visibility_lab.simulation.noise import value_noise


class Particle(NamedTuple):
    """A particle that drifts before the cameras."""

    depth: float  # distance along the optical axis in m
    column: float  # column, row: where it is in the left image, px; the column may lie beyond it
    row: float
    sigma: float  # standard deviation of its image, px
    opacity: float  # share of the light behind its middle that it hides


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


def marine_snow(
    camera: StereoCamera, fraction: float, random: np.random.Generator
) -> tuple[Map, Map]:
    """Marine snow: opacity (0 .. 1) of drifting particles in the left and the right image.

    A particle has the disparity of its distance; they cover a fraction of the pixels of each.
    """
    left = np.zeros((camera.height, camera.width), np.float32)
    right = np.zeros_like(left)
    for particle in drifting_particles(camera, fraction, random):
        disparity = camera.focal_length * camera.baseline / particle.depth
        for image, column in ((left, particle.column), (right, particle.column - disparity)):
            blot(image, column, particle.row, particle.sigma, particle.opacity)
    return left, right


def drifting_particles(
    camera: StereoCamera, fraction: float, random: np.random.Generator
) -> list[Particle]:
    """Draw the particles of `marine_snow`, which takes the same arguments."""
    particles = []
    wanted = fraction * camera.width * camera.height
    covered = 0.0
    while covered < wanted:
        depth = 0.4 * math.exp(random.uniform(0.0, 2.0))
        disparity = camera.focal_length * camera.baseline / depth
        column = random.uniform(0.0, camera.width + disparity)
        row = random.uniform(0.0, camera.height)
        # Near particles are larger, and out of focus.
        sigma = 0.5 + random.exponential(0.5) / depth
        particles.append(Particle(depth, column, row, sigma, random.uniform(0.3, 0.9)))
        covered += math.pi * (1.5 * sigma) ** 2
    return particles


def blot(
    opacity: Map, column: float, row: float, sigma: float, strength: float
) -> tuple[slice, slice]:
    """Draw a particle's opacity into an image, and return the window that it lies in."""
    reach = math.ceil(3.0 * sigma)
    rows = slice(max(int(row) - reach, 0), max(int(row) + reach + 1, 0))
    columns = slice(max(int(column) - reach, 0), max(int(column) + reach + 1, 0))
    window = opacity[rows, columns]
    y = np.arange(rows.start, rows.start + window.shape[0]) - row
    x = np.arange(columns.start, columns.start + window.shape[1]) - column
    squared = (x[np.newaxis] ** 2 + y[:, np.newaxis] ** 2) / (2.0 * sigma**2)
    np.maximum(window, strength * np.exp(-squared).astype(np.float32), out=window)
    return rows, columns
