# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Procedural scene: a sea floor, boulders and corals, placed by a seed.

The world's x points along the transect, y to the left and z up, in metres; the
sea floor lies around z = 0. Terrain is a height field; boulders, plates and
heads of coral are ellipsoids, branches are capsules.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array
from uw_visibility_lab.simulation.noise import fractal_noise, noise_lattice
from uw_visibility_lab.simulation.shapes import (
    CAPSULE,
    ELLIPSOID,
    SHAPE_COLUMNS,
    axes_along,
    shape_row,
    turned_axes,
)

SPACING = 0.04
"""Distance of the height field's samples in m."""


class Scene(NamedTuple):
    """Scene: all surfaces that a ray can hit, as arrays for kernels."""

    lattice: NDArray[np.float32]  # (64, 64, 64); random values of all textures
    heights: NDArray[np.float32]  # (ny, nx); height of the sea floor in m, by y and x
    # (ny, nx); share of the sky's light that reaches the floor, 0 .. 1: low beneath objects
    openness: NDArray[np.float32]
    origin: tuple[float, float]  # x and y of the first sample in m
    highest: float  # height in m above which there is no floor
    steep: float  # 98 % quantile of the floor's slope
    shapes: Array  # (n, SHAPE_COLUMNS); ellipsoids and capsules, m
    # (n, 8); light colour, dark colour (linear RGB reflectance), texture's cell size in m and
    # width of its dark grooves
    appearance: Array


# Light colour, dark colour, cell size, groove width: see `Scene.appearance`.
_ROCK = (0.52, 0.46, 0.36, 0.05, 0.05, 0.04, 0.30, 0.10)
_PALE_ROCK = (0.90, 0.84, 0.70, 0.14, 0.12, 0.09, 0.24, 0.08)
_CORALS = (
    (0.85, 0.42, 0.22, 0.16, 0.05, 0.03, 0.06, 0.10),  # orange
    (0.80, 0.72, 0.30, 0.14, 0.11, 0.03, 0.05, 0.10),  # yellow
    (0.62, 0.34, 0.60, 0.10, 0.04, 0.10, 0.05, 0.08),  # purple
    (0.94, 0.91, 0.82, 0.35, 0.30, 0.22, 0.05, 0.06),  # bleached
    (0.36, 0.46, 0.24, 0.03, 0.05, 0.02, 0.06, 0.12),  # green
    (0.72, 0.26, 0.28, 0.10, 0.02, 0.03, 0.05, 0.10),  # red
)


@functools.lru_cache(maxsize=2)
def reef(
    seed: int = 0, length: float = 10.0, view: float = 30.0, *, boulders: float = 0.11,
    corals: float = 0.28,
) -> Scene:
    """Make a reef: sand and rock with boulders and corals along a transect.

    The transect starts at x = 0, with a length in m; objects are up to `view` m beyond its end.

    boulders, corals: number per square metre.

    Kept, since many a view is of the same reef: not to be changed.
    """
    lattice = noise_lattice(seed)
    origin = (-2.0, -0.6 * view)
    extent = (length + view + 2.0, 1.2 * view)
    heights = _terrain(lattice, origin, extent)
    objects = _Objects(np.random.default_rng(seed), heights, origin, extent)
    area = extent[0] * extent[1]
    for _ in range(int(boulders * area)):
        objects.add_boulder()
    for _ in range(int(corals * area)):
        objects.add_coral()
    # The start of a long transect is representative of all of it.
    slopes = np.hypot(*np.gradient(heights[:, :1000], SPACING))
    return Scene(
        lattice=lattice,
        heights=heights,
        openness=objects.openness,
        origin=origin,
        highest=float(heights.max()),
        steep=float(np.quantile(slopes, 0.98)),
        shapes=np.array(objects.shapes).reshape(-1, SHAPE_COLUMNS),
        appearance=np.array(objects.looks).reshape(-1, 8),
    )


@njit(nogil=True, error_model="numpy")
def _terrain(lattice: Any, origin: tuple[float, float], extent: tuple[float, float]) -> Any:
    nx, ny = int(extent[0] / SPACING), int(extent[1] / SPACING)
    heights = np.empty((ny, nx), np.float32)
    for j in range(ny):
        y = origin[1] + j * SPACING
        # Flatter along the camera's path, with mounds to its sides.
        relief = 0.38 + 0.72 * min(abs(y) / 4.0, 1.0)
        for i in range(nx):
            x = origin[0] + i * SPACING
            swell = fractal_noise(lattice, x, y, 0.0, 3.2, 5, 0.42, 0.02)
            ripple = math.sin(22.0 * (x + 0.35 * y + 0.8 * swell)) * 0.006
            heights[j, i] = relief * swell + ripple
    return heights


class _Objects:
    """Boulders and corals on a floor, and the shade beneath them."""

    def __init__(
        self, random: np.random.Generator, heights: NDArray[np.float32],
        origin: tuple[float, float], extent: tuple[float, float],
    ) -> None:
        self.random = random
        self.heights, self.origin, self.extent = heights, origin, extent
        self.openness = np.ones_like(heights)
        self.shapes: list[Array] = []
        self.looks: list[tuple[float, ...]] = []

    def foot(self, clear: float) -> Array:
        """Draw a point of the floor that is at least `clear` m beside the camera's path."""
        while True:
            x, y = (
                first + 1.0 + self.random.random() * (size - 2.0)
                for first, size in zip(self.origin, self.extent, strict=True))
            if abs(y) > clear:
                i, j = (
                    round((v - first) / SPACING)
                    for v, first in zip((x, y), self.origin, strict=True))
                return np.array([x, y, self.heights[j, i]], np.float64)

    def ellipsoid(
        self, centre: Array, radii: tuple[float, float, float], rotation: Array,
        look: tuple[float, ...],
    ) -> None:
        """Add an ellipsoid; the rotation's rows are its axes."""
        self.shapes.append(shape_row(ELLIPSOID, centre, radii, rotation))
        self.looks.append(look)

    def capsule(self, start: Array, end: Array, radius: float, look: tuple[float, ...]) -> None:
        """Add a capsule."""
        half = (radius, radius, math.dist(start, end) / 2)
        self.shapes.append(
            shape_row(CAPSULE, (start + end) / 2, half, axes_along(*(end - start).tolist())))
        self.looks.append(look)

    def shade(self, foot: Array, radius: float, strength: float) -> None:
        """Darken the floor around a point."""
        i, j, n = (int(v / SPACING) for v in (*(foot[:2] - self.origin), 2.0 * radius))
        ny, nx = self.openness.shape
        rows = slice(max(j - n, 0), min(j + n + 2, ny))
        columns = slice(max(i - n, 0), min(i + n + 2, nx))
        dy = self.origin[1] + np.arange(rows.start, rows.stop) * SPACING - foot[1]
        dx = self.origin[0] + np.arange(columns.start, columns.stop) * SPACING - foot[0]
        squared = (dx[np.newaxis] ** 2 + dy[:, np.newaxis] ** 2) / radius**2
        light = 1.0 - strength * np.exp(-1.4 * squared**2)
        self.openness[rows, columns] *= light.astype(np.float32)

    def add_boulder(self) -> None:
        """Add an irregular boulder: a cluster of overlapping ellipsoids."""
        random, foot = self.random, self.foot(clear=0.9)
        size = 0.14 + 0.42 * random.random() ** 2
        look = _ROCK if random.random() < 0.7 else _PALE_ROCK
        self.shade(foot, 1.25 * size, 0.75)
        for _ in range(random.integers(3, 6)):
            radii = size * random.uniform(0.45, 1.0, 3) * (1.0, 1.0, 0.8)
            offset = random.normal(0.0, 0.38, 3) * size * (1.0, 1.0, 0.5)
            centre = foot + offset + (0.0, 0.0, 0.25 * size)
            self.ellipsoid(centre, tuple(radii), turned_axes(random, 0.5), look)

    def add_coral(self) -> None:
        """Add a coral of one of four growth forms."""
        random, foot = self.random, self.foot(clear=0.5)
        look = _CORALS[random.integers(len(_CORALS))]
        size = random.uniform(0.8, 1.9)
        up = np.array([0.0, 0.0, 1.0])
        form = random.random()
        if form < 0.4:
            self.shade(foot, 0.24 * size, 0.7)
            for _ in range(3):
                self.branch(foot, self.lean(up, 0.5), 0.15 * size, 0.030 * size, 3, look)
        elif form < 0.6:
            radius = 0.17 * size
            self.shade(foot, 1.4 * radius, 0.8)
            self.ellipsoid(
                foot + 0.4 * radius * up, (radius, radius, 0.85 * radius), np.eye(3), look)
        elif form < 0.8:
            top = foot + 0.22 * size * up
            self.shade(foot, 0.34 * size, 0.85)
            self.capsule(foot - 0.05 * up, top, 0.045 * size, look)
            self.ellipsoid(
                top, (0.34 * size, 0.30 * size, 0.035 * size), turned_axes(random, 0.15), look)
        else:
            self.shade(foot, 0.16 * size, 0.6)
            for _ in range(random.integers(3, 7)):
                lean = self.lean(up, 0.4)
                radius = random.uniform(0.025, 0.05) * size
                end = foot + lean * random.uniform(0.15, 0.4) * size
                self.capsule(foot - 0.05 * up, end, radius, look)

    def branch(
        self, start: Array, direction: Array, length: float, radius: float, generations: int,
        look: tuple[float, ...],
    ) -> None:
        """Add a branch and, from its end, thinner ones."""
        end = start + direction * length
        self.capsule(start, end, radius, look)
        if generations > 0:
            for _ in range(2 + (generations == 3)):
                turned = self.lean(direction, 0.75)
                self.branch(end, turned, 0.72 * length, 0.72 * radius, generations - 1, look)

    def lean(self, direction: Array, amount: float) -> Array:
        """Turn a direction at random, with a tendency upwards."""
        turned = direction + self.random.normal(0.0, amount, 3) + (0.0, 0.0, 0.15)
        return np.asarray(turned / math.sqrt(turned @ turned))
