# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Light of lamps along its paths through water to the camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uw_visibility.config.lighting import Lamp
from uw_visibility.images.arrays import Array
from uw_visibility.optics.lamps import incidence, phase_function, shine

# Steps of the integral along the line of sight, by Gauss and Legendre's rule.
STEPS = 10


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
