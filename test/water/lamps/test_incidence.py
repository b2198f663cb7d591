# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""How far ground darkens where the lamps' light falls aslant, and what that does to attenuation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lamp_scene import CLEAR_WATER, LAMPS, RIG, SIZE, light, parameters, rays, shine, texture

from uw_visibility.config.schema import PipelineConfig
from uw_visibility.images.view import View
from uw_visibility.optics.lamps import REFERENCE, nodes_of, tabulate
from uw_visibility.water.lamps.estimation import LampEstimator
from uw_visibility.water.lamps.incidence import (
    CONTRAST_PART,
    Incidence,
    lamp_rows,
    observe_incidence,
    points_along,
    step_of,
)

CONFIG = PipelineConfig.from_parameters(parameters())
# Lamps far below the camera, whose light falls aslant on ground further on.
LOW = tuple(((x, 0.7, 0.2), (0.0, 0.1, 1.0), 100.0) for x in (-0.5, 0.5))


def hills(height: float, tilt: float = 30.0) -> np.ndarray:
    """Range to ground with hills of a height, m, below a camera that looks down by an angle."""
    down = np.array([0.0, math.cos(math.radians(tilt)), math.sin(math.radians(tilt))])
    directions = rays()
    distance = 1.5 / (directions @ down)
    for _ in range(40):
        points = directions * distance[..., None]
        relief = height * np.sin(5.0 * points[..., 0] + 1.0) * np.sin(4.0 * points[..., 2])
        distance += 0.5 * ((1.5 - relief) / (directions @ down) - distance)
    return np.asarray(distance)


def lit(distance: np.ndarray, exponent: float, lamps: tuple = LAMPS, seed: int = 0) -> np.ndarray:
    """8 bit image of ground whose light is in proportion to the cosine to a power."""
    directions = rays()
    points = directions * distance[..., None]
    across, along = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normal = np.cross(along, across)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    normal *= -np.sign((normal * points).sum(axis=2, keepdims=True))
    beta = CLEAR_WATER + 0.1
    direct = np.zeros((*SIZE, 3))
    for place, axis, angle in lamps:
        unit = np.array(axis) / np.linalg.norm(axis)
        r, power, _ = shine(distance, place, unit, angle)
        cosine = -((points - np.array(place)) * normal).sum(axis=2) / r
        each = power * np.maximum(cosine, 0.03) ** exponent
        direct += each[..., None] * np.exp(-beta * (r + distance)[..., None])
    image = texture(seed, distance) * direct + math.pi * 0.07 * light(distance, beta, lamps)[1]
    noisy = 0.8 * image / np.quantile(image, 0.999)
    noisy += np.random.default_rng(seed).normal(0.0, 1e-3, image.shape)
    return np.asarray(np.clip(noisy * 65535, 0, 65535).astype(np.uint16))


def observe(image: np.ndarray, distance: np.ndarray) -> Incidence:
    columns, rows = nodes_of(SIZE)
    lamps = list(CONFIG.lighting.lamps())
    tables = tabulate(RIG.rays_at(columns, rows), columns, rows, lamps)
    step = step_of(SIZE)
    points = RIG.rays_at(points_along(SIZE[1], step), points_along(SIZE[0], step))
    colour = View.of(image).colour
    assert colour is not None
    return observe_incidence(
        colour, distance.astype(np.float32), tables, points, lamp_rows(lamps),
        tables.log_direct[REFERENCE].mean(axis=0), tables.log_scattered[REFERENCE].mean(axis=0))


def test_exponent_is_read_off_hills() -> None:
    distance = hills(0.12)
    found = [observe(lit(distance, exponent), distance) for exponent in (0.0, 0.5, 1.0)]
    exponents = [each.exponent / CONTRAST_PART for each in found]
    assert exponents == pytest.approx([0.0, 0.5, 1.0], abs=0.25)
    assert exponents[0] + 0.25 < exponents[1] < exponents[2] - 0.25


def test_flat_ground_tells_no_exponent_but_its_incidence() -> None:
    distance = hills(0.0)
    found = observe(lit(distance, 1.0), distance)
    rough = observe(lit(hills(0.12), 1.0), hills(0.12))
    assert found.stddev > rough.stddev
    # The lamps are beside the camera: the farther the ground, the more aslant their light.
    log_cosine = found.log_cosine[:, found.log_cosine.shape[1] // 2]
    assert log_cosine[0] < log_cosine[-1] - 0.3
    assert abs(np.median(found.log_cosine)) < 0.05


def test_light_that_falls_aslant_is_no_attenuation() -> None:
    distance = hills(0.12, tilt=22.0)
    config = PipelineConfig.from_parameters(parameters(LOW))
    reader = LampEstimator(config.water, config.lighting, CLEAR_WATER, RIG.rays_at)
    errors = []
    for seed in range(3):
        image = lit(distance, 1.0, LOW, seed)
        found = reader.estimate_view(View.of(image), distance.astype(np.float32))
        errors.append((found.attenuation - CLEAR_WATER - 0.1) / found.attenuation_stddev)
    assert (np.abs(np.mean(errors, axis=0)) < 2.0).all(), errors
