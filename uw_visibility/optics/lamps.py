# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Light of lamps in water: what reaches a surface, and what the water scatters back.

A lamp of power P at p lights the point X at r = |X − p|, seen at range d from the camera,
so that (Jaffe 1990, doi:10.1109/48.50695, without forward scattering)

    E = ρ P D + π b P S
    D = Σ g(θ) e^(−β (r + d)) / r²
    S = Σ ∫₀ᵈ g(θ) p(ψ) e^(−β (r + s)) / r² ds

over the lamps, with the beam g, the phase function p of the scattering angle ψ (Henyey and
Greenstein 1941, doi:10.1086/144246), attenuation β and scattering b. Both are tabulated over
direction, range and attenuation once for a rig, and interpolated: a frame costs no integral.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from uw_visibility.config.lighting import Lamp, beam_falloff
from uw_visibility.optics.light_model import transmission

Array = NDArray[np.float64]
Table = NDArray[np.float32]

ASYMMETRY = 0.9
"""Mean cosine of the scattering angle in sea water, of the phase function."""

# Nodes over the image, over range (of equal ratio, m) and over attenuation, 1/m.
COLUMNS, ROWS = 24, 18
RANGES = np.geomspace(0.2, 25.0, 30)
ATTENUATIONS = np.array([0.0, 0.05, 0.1, 0.2, 0.32, 0.48, 0.7, 1.0, 1.5, 2.2])
# Steps of the integral between two ranges, and before the first.
SUBSTEPS, FIRST_STEPS = 6, 24
# Steps of the integral to surfaces at any range, by Gauss and Legendre's rule.
STEPS = 10
# Least distance from a lamp, where its glass begins, m; least light, for logarithms.
LEAST_DISTANCE = 0.02
DARKNESS = 1e-12
# Least cosine of incidence.
LEAST_COSINE = 0.05
# Place of the left camera, the origin of the lamps' frame.
LEFT_EYE = (0.0, 0.0, 0.0)


class LampTables(NamedTuple):
    """Direct and scattered light of a rig's lamps, of their relative power, for a camera.

    Tables, (K, 3, Y, X, R), are over `ATTENUATIONS`, channel, row, column and `RANGES`.
    """

    columns: Array  # (X,), px, of equal distance
    rows: Array  # (Y,), px, of equal distance
    log_direct: Table  # ln D
    log_scattered: Table  # ln S

    def by_range(self, attenuation: Array) -> Array:
        """Geometric mean of D over the image at `RANGES`, (3, R), at attenuations (3,), 1/m."""
        log_direct = at_attenuation(self.log_direct, attenuation)
        return np.exp(log_direct.mean(axis=(1, 2), dtype=np.float64))

    def scattered_at(self, column: Array, row: Array, distance: Array) -> Array:
        """Interpolate ln S at points (px, px, m), (K, 3, N) float64; the nearest node beyond."""
        depth = np.log(distance / RANGES[0]) / math.log(RANGES[1] / RANGES[0])
        at = row / self.rows[1], column / self.columns[1], depth
        return np.array([
            [map_coordinates(each, at, np.float64, order=1, mode="nearest") for each in channels]
            for channels in self.log_scattered])

    def field(
        self, attenuation: Array, power: Array, scattering: Array, daylight: Array, veil: Array,
    ) -> LightField:
        """Light of the lamps, and of daylight beside them, in water of attenuation β, (3,), 1/m.

        `power` P (3,) is the irradiance of white at 1 m of a lamp of relative power 1, `scattering`
        (3,) the factor of S; `daylight` and `veil` (3,) are W and B of daylight.
        """
        direct = np.exp(at_attenuation(self.log_direct, attenuation)) * _of_channels(power)
        scattered = np.exp(
            at_attenuation(self.log_scattered, attenuation)) * _of_channels(scattering)
        if np.any(daylight > 0):
            left = transmission(attenuation[:, np.newaxis], RANGES)[:, np.newaxis, np.newaxis]
            direct = direct + _of_channels(daylight) * left
            scattered = scattered + _of_channels(veil) * (1.0 - left)
        return LightField(
            self.columns, self.rows, np.log(direct).astype(np.float32),
            scattered.astype(np.float32))


class LightField(NamedTuple):
    """Direct and scattered light over channel, row, column and `RANGES`, (3, Y, X, R)."""

    columns: Array  # (X,), px
    rows: Array  # (Y,), px
    log_direct: Table  # ln of the irradiance of white
    scattered: Table  # irradiance by the water in front of it


def between(attenuation: Any) -> tuple[Any, Any, Any]:
    """Node below an attenuation, 1/m, interpolation weight of the next one, and their distance."""
    low = np.clip(np.searchsorted(ATTENUATIONS, attenuation) - 1, 0, len(ATTENUATIONS) - 2)
    step = ATTENUATIONS[low + 1] - ATTENUATIONS[low]
    return low, (attenuation - ATTENUATIONS[low]) / step, step


def at_attenuation(table: NDArray[Any], attenuation: Array) -> NDArray[Any]:
    """Interpolate a table (K, 3, ...) over `ATTENUATIONS` at the channels' values, (3,), 1/m.

    Attenuation is clipped to the table's range; NaN counts as 0.
    """
    low, share, _ = between(
        np.clip(np.nan_to_num(attenuation), ATTENUATIONS[0], ATTENUATIONS[-1]))
    share = share.astype(table.dtype).reshape(3, *[1] * (table.ndim - 2))
    channel = np.arange(3)
    return np.asarray((1 - share) * table[low, channel] + share * table[low + 1, channel])


def _of_channels(values: Array) -> Table:
    return np.asarray(values, np.float32)[:, np.newaxis, np.newaxis, np.newaxis]


# The cache has room for both cameras at two image sizes.
@lru_cache(maxsize=4)
def tabulate(
    rays_at: Callable[[Array, Array], Array], shape: tuple[int, int], lamps: tuple[Lamp, ...],
    eye: tuple[float, float, float],
) -> LampTables:
    """Tabulate the light of lamps for a camera; the last tables are cached.

    `rays_at` gives unit directions, (Y, X, 3), through a grid of columns and rows, px; `shape` is
    height and width of the images, px. `lamps` are in the left camera's frame, to whose axes the
    camera's are parallel, and `eye` is the camera's position in it, m.
    """
    columns, rows = np.linspace(0.0, shape[1] - 1, COLUMNS), np.linspace(0.0, shape[0] - 1, ROWS)
    directions = rays_at(columns, rows).reshape(-1, 3)
    distance, weight = _nodes()
    size = (len(ATTENUATIONS), 3, len(directions), len(RANGES))
    direct, scattered = np.full(size, DARKNESS), np.full(size, DARKNESS)
    at = FIRST_STEPS + SUBSTEPS * np.arange(len(RANGES)) - 1
    # The surface is at the end of a step, the water in its middle.
    ends, middles = (
        directions[:, np.newaxis] * along[:, np.newaxis] for along in (RANGES, distance))
    for lamp in lamps:
        surface, lit, _ = shine(ends, directions, lamp, eye)
        r, power, forward = shine(middles, directions, lamp, eye)
        back = power * phase_function(forward) * weight
        colour = np.array(lamp.colour)[:, np.newaxis, np.newaxis]
        for k, beta in enumerate(ATTENUATIONS):
            direct[k] += colour * (lit * np.exp(-beta * (surface + RANGES)))
            summed = np.cumsum(back * np.exp(-beta * (r + distance)), axis=1)
            scattered[k] += colour * summed[:, at]
    return LampTables(
        columns, rows,
        *(np.log(table).astype(np.float32).reshape(*size[:2], ROWS, COLUMNS, len(RANGES))
          for table in (direct, scattered)))


def shine(
    points: Array, directions: Array, lamp: Lamp, eye: tuple[float, float, float] = LEFT_EYE
) -> tuple[Array, Array, Array]:
    """Distance from a lamp, g/r², and the cosine of scattering to the camera, each (N, S).

    The points (N, S, 3), m, lie along lines of sight with unit directions (N, 3) from the camera at
    `eye` in the lamps' frame.
    """
    away = points - (np.array(lamp.position) - np.array(eye))
    r = np.maximum(np.linalg.norm(away, axis=2), LEAST_DISTANCE)
    power = beam(away @ np.array(lamp.direction) / r, lamp.beam_angle) / r**2
    return r, power, np.einsum("nsk,nk->ns", away, -directions) / r


def incidence(points: Array, normals: Array, lamp: Lamp, r: Array) -> Array:
    """Cosine of incidence of a lamp's light at points, (N, 3), at distances from it, (N,).

    At least `LEAST_COSINE`, since the slope of the ground is uncertain.
    """
    away = points - np.array(lamp.position)
    return np.maximum(-np.einsum("nk,nk->n", away, normals) / r, LEAST_COSINE)


class Ways(NamedTuple):
    """K paths of light by way of each of N places to the camera."""

    colour: Array  # (K, 3), relative power of the lamp in R, G, B
    # (K, N), g/r²; for water times the phase function and the length of the line of sight, m
    light: Array
    path: Array  # (K, N), from the lamp to the camera, m
    log_cosine: Array  # (K, N), logarithm of the cosine of incidence; 0 for water

    @classmethod
    def by_ground(
        cls, directions: Array, distance: Array, normals: Array, lamps: Sequence[Lamp]
    ) -> Ways:
        """Paths by ground at unit directions (N, 3), ranges (N,), m, with unit normals (N, 3)."""
        points = directions * distance[:, np.newaxis]
        light, path, log_cosine = [], [], []
        for lamp in lamps:
            r, lit, _ = (each[:, 0] for each in shine(points[:, np.newaxis], directions, lamp))
            light.append(lit)
            path.append(r + distance)
            log_cosine.append(np.log(incidence(points, normals, lamp, r)))
        return cls(
            np.array([lamp.colour for lamp in lamps]), np.array(light), np.array(path),
            np.array(log_cosine))

    @classmethod
    def by_water(cls, directions: Array, distance: Array, lamps: Sequence[Lamp]) -> Ways:
        """Paths by the water before the ground."""
        nodes, weights = np.polynomial.legendre.leggauss(STEPS)
        along = 0.5 * (nodes + 1) * distance[:, np.newaxis]
        points = directions[:, np.newaxis] * along[..., np.newaxis]
        light, path = [], []
        for lamp in lamps:
            r, lit, forward = shine(points, directions, lamp)
            light.append((lit * phase_function(forward) * 0.5 * weights * distance[:, None]).T)
            path.append((r + along).T)
        return cls(
            np.repeat([lamp.colour for lamp in lamps], STEPS, axis=0), np.concatenate(light),
            np.concatenate(path), np.zeros((len(lamps) * STEPS, len(distance))))

    def sum(self, attenuation: Array, exponent: float = 0.0) -> tuple[Array, Array, Array]:
        """Light by all paths, its mean path length and mean logarithm of the cosine, (N, 3) each.

        `attenuation` is β, (3,), 1/m; `exponent` that of the cosine.
        """
        light = self.light * np.exp(exponent * self.log_cosine)
        total, path, log_cosine = np.empty((3, len(attenuation), self.light.shape[1]))
        for c, beta in enumerate(attenuation):
            parts = self.colour[:, c, np.newaxis] * light * np.exp(-beta * self.path)
            total[c] = parts.sum(axis=0) + 1e-30
            path[c] = (parts * self.path).sum(axis=0)
            log_cosine[c] = (parts * self.log_cosine).sum(axis=0)
        return total.T, (path / total).T, (log_cosine / total).T


def displaced(
    lamps: Sequence[Lamp], position_stddev: float, direction_stddev: float
) -> list[list[Lamp]]:
    """Rigs with one lamp off by a standard deviation in one coordinate (m) or axis (degrees)."""
    moved = []
    turn = math.radians(direction_stddev)
    for i, lamp in enumerate(lamps):
        axis = np.array(lamp.direction)
        others = [
            lamp._replace(position=vector(np.array(lamp.position) + position_stddev * unit))
            for unit in np.eye(3)
        ] + [
            lamp._replace(direction=vector(math.cos(turn) * axis + math.sin(turn) * side))
            for side in across(axis)]
        moved += [[*lamps[:i], other, *lamps[i + 1:]] for other in others]
    return moved


def across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors (..., 3), perpendicular to unit vectors (..., 3) and to one another."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=-1)])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return first, np.cross(axis, first)


def vector(values: Array) -> tuple[float, float, float]:
    """Convert an array of three numbers to a tuple of floats, as in `Lamp`."""
    return float(values[0]), float(values[1]), float(values[2])


def beam(cosine: Array, angle: float) -> Array:
    """Relative power g(θ) = exp(−ln 2 (2θ/angle)²) of a lamp, for cos θ."""
    theta = np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.asarray(np.exp(-beam_falloff(angle) * theta**2))


def phase_function(cosine: Array) -> Array:
    """Henyey-Greenstein phase function p(ψ), 1/sr, for cos ψ."""
    g = ASYMMETRY
    return np.asarray((1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cosine) ** 1.5))


def _nodes() -> tuple[Array, Array]:
    """Middles and lengths of the steps of the integral along a line of sight, m."""
    ends = [np.linspace(0.0, RANGES[0], FIRST_STEPS + 1)]
    ends += [np.linspace(low, high, SUBSTEPS + 1)[1:] for low, high in itertools.pairwise(RANGES)]
    edges = np.concatenate(ends)
    return 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
