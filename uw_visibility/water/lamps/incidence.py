# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Incidence of the lamps' light on the ground, and the exponent of its effect on brightness.

A plane is fitted to the ranges around each node of a grid: on it n·u = 1/d holds for the directions
u of the lines of sight. Ground reflects in proportion to cosᵏ of the incidence, with an exponent
from 0 for rough ground to 1 for Lambert's (Minnaert 1941, doi:10.1086/144279). The exponent is
fitted to the light of neighbours at equal range; at one incidence per range, as on flat ground, a
prior tells it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.robust import cauchy_weight, median_deviation
from uw_visibility.config.lighting import Lamp
from uw_visibility.images.arrays import Array
from uw_visibility.images.view import ColourSamples
from uw_visibility.optics.lamps import ATTENUATIONS, REFERENCE, LampTables, Table
from uw_visibility.optics.transfer import linear_table
from uw_visibility.water.lamps.observations import look_up, table_grid

Map = NDArray[np.float32]

# Nodes along a row of the image; half the width of what a plane is fitted to, in halves of
# their distance; samples of light along a side about each.
NODES, SIDE, SAMPLES = 60, 3, 4
# Points of a plane are as far as its middle but for this part; so many are needed.
ALIKE, FEWEST_POINTS = 0.25, 12
# Less than this is no incidence that a plane tells of.
LEAST_COSINE = 0.03
# Neighbours that are compared, nodes apart, and what they differ by at most: logarithms of range
# and of the cosine.
APART, MOST_RANGE, MOST_COSINE = 3, 0.25, 1.5
# Part of the light that is the ground's own; least light, parts of the largest value.
OWN_PART, DARKEST = 0.4, 4.0 / 255
# Part of the nodes that show scattered light alone, or hardly more.
DARK_QUANTILE = 0.02
# Mean and deviation of the exponent beforehand; how well it is known at best, for planes are not
# what is lit; and how much less sure neighbours that share a node are than so many single ones.
USUAL_EXPONENT, EXPONENT_DEVIATION, LEAST_DEVIATION, SHARED = 0.1, 0.3, 0.15, 3.0
# Exponent of contrast over that of light: where light falls more aslant, relief takes the place
# of what patches differ by.
CONTRAST_PART = 0.4
# Cauchy's scale, in deviations of a difference.
TAIL, ITERATIONS = 2.0, 6
FEWEST = 30


@dataclass(frozen=True)
class Incidence:
    """Incidence of light on the ground in front of a camera.

    Attributes
    ----------
    log_cosine : (h, w) float32 ndarray
        At the nodes, minus the median over them; 0 where no plane fits.
    exponent, stddev : float
        Of the cosine that the ground's contrast is proportional to.
    """

    log_cosine: Map
    exponent: float
    stddev: float


def step_of(shape: tuple[int, ...]) -> int:
    """Distance of the nodes for a height and width, samples; an even number."""
    return 2 * max(1, round(shape[1] / (2 * NODES)))


def points_along(size: int, step: int) -> Array:
    """Points that planes are fitted to, along a side, samples; every second is a node."""
    return np.arange(0, size, step // 2, dtype=np.float64)


def lamp_rows(lamps: Sequence[Lamp]) -> Array:
    """Lamps as kernels take them, (L, 8): place, axis, fall of the beam, mean power."""
    return np.array([
        [*lamp.position, *lamp.direction, lamp.falloff, float(np.mean(lamp.colour))]
        for lamp in lamps])


def observe_incidence(
    samples: ColourSamples, ranges: Map, tables: LampTables, rays: Array, lamps: Array,
    log_direct: Table, log_scattered: Table,
) -> Incidence:
    """Observe incidence, and fit its exponent.

    `rays` (h, w, 3) are unit directions of `points_along`, `lamps` those of `lamp_rows`, and
    `log_direct`, `log_scattered` (Y, X, R) tables at the reference attenuation.
    """
    step = step_of(ranges.shape)
    seen = np.full((5, rays.shape[0] // 2, rays.shape[1] // 2), np.nan, np.float32)
    table = linear_table(samples.transfer, samples.pixels.dtype)
    _observe(
        samples.pixels, ranges, table, rays, lamps, ATTENUATIONS[REFERENCE], step,
        table_grid(tables, samples.scale), log_direct, log_scattered, seen)
    cosine = seen[0]
    known = np.isfinite(cosine)
    if not known.any():
        return Incidence(np.zeros_like(cosine), 0.0, 0.0)
    exponent, stddev = _fit_exponent(seen)
    even = np.where(known, cosine - np.median(cosine[known]), np.float32(0.0))
    return Incidence(
        even, CONTRAST_PART * exponent, CONTRAST_PART * max(stddev, LEAST_DEVIATION))


def _fit_exponent(seen: Map) -> tuple[float, float]:
    """Exponent and its deviation, with the prior."""
    cosine, light, direct, scattered, distance = seen
    added = np.exp(scattered)
    lit = np.isfinite(light)
    if not lit.any():
        return USUAL_EXPONENT, EXPONENT_DEVIATION
    own = light - np.quantile((light / added)[lit], DARK_QUANTILE) * added
    clear = (own > OWN_PART * light) & (light > DARKEST)
    level = np.where(clear, np.log(np.where(clear, own, 1.0)) - direct, np.nan)
    differences = []
    for far, near in (
        (np.s_[APART:], np.s_[:-APART]), (np.s_[:, APART:], np.s_[:, :-APART]),
    ):
        differences.append(np.stack([
            (each[far] - each[near]).ravel() for each in (level, cosine, np.log(distance))]))
    joined = np.concatenate(differences, axis=1).astype(np.float64)
    y, x, along = joined[:, (
        np.isfinite(joined).all(axis=0) & (np.abs(joined[2]) < MOST_RANGE)
        & (np.abs(joined[1]) < MOST_COSINE))]
    prior = 1.0 / EXPONENT_DEVIATION**2
    if len(y) < FEWEST:
        return USUAL_EXPONENT, EXPONENT_DEVIATION
    terms = np.stack([x, along])
    p, weight, scatter = np.zeros(2), np.ones(len(y)), 1.0
    for _ in range(ITERATIONS):
        residual = y - p @ terms
        scatter = median_deviation(residual) + 1e-6
        weight = cauchy_weight(residual, TAIL * scatter)
        p = np.linalg.solve((terms * weight) @ terms.T + 1e-6 * np.eye(2), (terms * weight) @ y)
    curvature = (terms * weight) @ terms.T
    # What is left of the cosine's differences beside those of range.
    free = curvature[0, 0] - curvature[0, 1] ** 2 / max(curvature[1, 1], 1e-9)
    told = max(float(free), 0.0) / (SHARED * scatter) ** 2
    return (
        float((told * p[0] + prior * USUAL_EXPONENT) / (told + prior)),
        1.0 / math.sqrt(told + prior))


@njit(nogil=True, error_model="numpy")
def _observe(
    image: Any, ranges: Any, irradiance: Any, rays: Any, lamps: Any, beta: float, step: int,
    grid: Any, direct: Any, scattered: Any, seen: Any,
) -> None:
    """Logarithm of the cosine, light, ln D, ln S and range of each node."""
    height, width = ranges.shape
    top = irradiance.size - 1
    half = step // 2
    stride = max(step // SAMPLES, 1)
    a, b, n = np.empty((3, 3)), np.empty(3), np.zeros(3)
    for j in range(seen.shape[1]):
        for i in range(seen.shape[2]):
            y, x = half * (2 * j + 1), half * (2 * i + 1)
            ray = rays[2 * j + 1, 2 * i + 1]
            d = ranges[y, x]
            # Written so that unknown ranges fail.
            if not (d > 0 and d < np.inf):
                continue
            middle = 1.0 / d
            a[:] = 0.0
            b[:] = 0.0
            count = 0
            for v in range(-SIDE, SIDE + 1):
                for u in range(-SIDE, SIDE + 1):
                    row, column = y + v * half, x + u * half
                    if row < 0 or row >= height or column < 0 or column >= width:
                        continue
                    inverse = 1.0 / ranges[row, column]
                    if not abs(inverse - middle) < ALIKE * middle:
                        continue
                    r = rays[2 * j + 1 + v, 2 * i + 1 + u]
                    count += 1
                    for k in range(3):
                        b[k] += r[k] * inverse
                        for m in range(k + 1):
                            a[k, m] += r[k] * r[m]
            if count < FEWEST_POINTS or not _solve(a, b, n):
                continue
            length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
            summed, weights = 0.0, 1e-30
            for lamp in lamps:
                ax, ay, az = d * ray[0] - lamp[0], d * ray[1] - lamp[1], d * ray[2] - lamp[2]
                distance = max(math.sqrt(ax * ax + ay * ay + az * az), 1e-3)
                theta = math.acos(min(max(
                    (ax * lamp[3] + ay * lamp[4] + az * lamp[5]) / distance, -1.0), 1.0))
                weight = lamp[7] * math.exp(
                    -lamp[6] * theta * theta - beta * distance) / (distance * distance)
                cosine = (ax * n[0] + ay * n[1] + az * n[2]) / (distance * length)
                summed += weight * max(cosine, LEAST_COSINE)
                weights += weight
            seen[0, j, i] = math.log(max(summed / weights, LEAST_COSINE))
            seen[4, j, i] = d
            total, number, full = 0.0, 0, False
            for row in range(y - half, min(y + half, height), stride):
                for column in range(x - half, min(x + half, width), stride):
                    code = image[row, column, 1]
                    full |= code >= top
                    total += irradiance[code]
                    number += 1
            if full or number == 0:
                continue
            z = (math.log(d) - grid[4]) * grid[5]
            seen[1, j, i] = total / number
            seen[2, j, i] = look_up(direct, grid[0] + grid[1] * y, grid[2] + grid[3] * x, z)
            seen[3, j, i] = look_up(scattered, grid[0] + grid[1] * y, grid[2] + grid[3] * x, z)


@njit(nogil=True, error_model="numpy")
def _solve(a: Any, b: Any, n: Any) -> bool:
    """Solve a symmetric system of three by Cholesky; return whether it is regular."""
    if not a[0, 0] > 0:
        return False
    l00 = math.sqrt(a[0, 0])
    l10, l20 = a[1, 0] / l00, a[2, 0] / l00
    d1 = a[1, 1] - l10 * l10
    if not d1 > 1e-9 * a[1, 1]:
        return False
    l11 = math.sqrt(d1)
    l21 = (a[2, 1] - l20 * l10) / l11
    d2 = a[2, 2] - l20 * l20 - l21 * l21
    if not d2 > 1e-9 * a[2, 2]:
        return False
    l22 = math.sqrt(d2)
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    n[2] = (b[2] - l20 * y0 - l21 * y1) / l22 / l22
    n[1] = (y1 - l21 * n[2]) / l11
    n[0] = (y0 - l10 * n[1] - l20 * n[2]) / l00
    return True
