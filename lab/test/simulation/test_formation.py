# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water that departs from the paper's changes the image as the closed form says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.camera import Pose, StereoCamera
from uw_visibility_lab.simulation.formation import (
    effective_attenuation,
    form_image,
    path_transmission,
)
from uw_visibility_lab.simulation.view import View
from uw_visibility_lab.simulation.water import Water, WaterEffects

SHAPE = (24, 32)
RANGES = np.linspace(1.0, 8.0, 24 * 32, dtype=np.float32).reshape(SHAPE)
RADIANCE = np.random.default_rng(1).uniform(0.0, 1.0, (*SHAPE, 3)).astype(np.float32)


CAMERA, POSE = StereoCamera(32, 24, 16.0), Pose((0.0, 0.0, 1.5))
"""Of 90 degrees, looking ahead."""

RISE = -CAMERA.rig.ray_directions(SHAPE)[..., 1]


def view_of(radiance=RADIANCE, ranges=RANGES) -> View:
    """Take an image in daylight and its ranges, each pixel a sample of one surface."""
    colours, rays = radiance.reshape(-1, 3), CAMERA.rig.ray_directions(SHAPE)
    return View(
        SHAPE, np.arange(ranges.size), rays.reshape(-1, 3), ranges.ravel(), colours, colours,
        np.zeros_like(colours), np.array(POSE.position), POSE.rotation())


def image(effects: WaterEffects, radiance=RADIANCE, ranges=RANGES, alpha=0.2) -> np.ndarray:
    return form_image(view_of(radiance, ranges), Water(alpha, 3.0, 1.0, effects))


def closed_form(water: Water, added=0.0, seen=1.0) -> np.ndarray:
    """E = W ρ e^(−T) + B (1 − e^(−T)), with T = βd and what is added."""
    path = water.attenuation() * RANGES[..., np.newaxis] + np.asarray(added)
    transmission = np.exp(-path)
    return (water.scene_light() * RADIANCE * transmission
            + water.ambient_light() * seen * (1.0 - transmission))


@pytest.mark.parametrize("veil", [(1.0, 1.0, 1.0), (0.4, 0.4, 0.4), (0.3, 0.5, 1.2)])
def test_veil_apart_from_light(veil: tuple[float, float, float]) -> None:
    water = Water(0.2, 3.0, 1.0, WaterEffects(veil=veil))
    np.testing.assert_allclose(water.ambient_light(), water.scene_light() * veil)
    np.testing.assert_allclose(image(water.effects), closed_form(water), rtol=1e-5)
    # Open water is the veil.
    open_water = image(water.effects, ranges=np.full(SHAPE, np.inf, np.float32))
    np.testing.assert_allclose(
        open_water, np.broadcast_to(water.ambient_light(), open_water.shape), rtol=1e-6)


def test_a_layer_attenuates_what_is_seen_through_it() -> None:
    effects = WaterEffects(layer=0.3, layer_height=1.0)
    inside = np.empty(SHAPE)
    for index in np.ndindex(SHAPE):
        rise, distance = RISE[index], RANGES[index]
        # From 1.5 m above the floor, down through the layer's top at 1 m.
        crossing = 0.5 / -rise if rise < 0 else math.inf
        inside[index] = max(distance - crossing, 0.0)
    assert 0.2 < (inside > 0.0).mean() < 0.6
    expected = closed_form(Water(0.2, 3.0, 1.0), 0.3 * inside[..., np.newaxis])
    np.testing.assert_allclose(image(effects), expected, rtol=1e-5)
    # From within it, up and out.
    deep = WaterEffects(layer=0.3, layer_height=2.0)
    up = RISE > 0
    leaving = np.where(up, 0.5 / np.where(up, RISE, 1.0), np.inf)
    expected = closed_form(
        Water(0.2, 3.0, 1.0), 0.3 * np.minimum(RANGES, leaving)[..., np.newaxis])
    np.testing.assert_allclose(image(deep), expected, rtol=1e-5)


def test_a_plume_is_in_its_part_of_the_view() -> None:
    added = np.zeros((*SHAPE, 1))
    added[:, 24:] = 0.4 * RANGES[:, 24:, np.newaxis]
    expected = closed_form(Water(0.2, 3.0, 1.0), added)
    effects = WaterEffects(plume=0.4, plume_share=0.25)
    np.testing.assert_allclose(image(effects), expected, rtol=1e-5)


def test_the_veil_is_brighter_above() -> None:
    water = Water(0.2, 3.0, 1.0)
    down = ((np.arange(24) + 0.5) / 24 - 0.5)[:, np.newaxis, np.newaxis]
    np.testing.assert_allclose(
        image(WaterEffects(veil_gradient=0.6)), closed_form(water, seen=1 - 0.6 * down),
        rtol=1e-5)


def test_blur_spreads_a_point_by_its_range_and_leaves_the_veil() -> None:
    radiance = np.zeros((*SHAPE, 3), np.float32)
    radiance[12, 16] = 1.0
    for distance in (2.0, 4.0):
        ranges = np.full(SHAPE, distance, np.float32)
        sharp = image(WaterEffects(veil=(0.5,) * 3), radiance, ranges)
        soft = image(WaterEffects(veil=(0.5,) * 3, blur=0.5), radiance, ranges)
        veil = image(WaterEffects(veil=(0.5,) * 3), np.zeros_like(radiance), ranges)
        point, spread = (sharp - veil)[..., 1], (soft - veil)[..., 1]
        assert spread.sum() == pytest.approx(point.sum(), rel=1e-3)
        columns = np.arange(32) - 16
        stddev = math.sqrt((spread * columns**2).sum() / spread.sum())
        assert stddev == pytest.approx(0.5 * distance, rel=0.03)


def test_the_effective_attenuation_is_the_best_exponential() -> None:
    plain = Water(0.2, 3.0)
    np.testing.assert_array_equal(
        effective_attenuation(view_of(), plain), plain.attenuation())
    for effects in (
        WaterEffects(water_type="II"), WaterEffects(plume=0.4), WaterEffects(layer=0.3),
    ):
        water = Water(0.1, 3.0, None, effects)
        beta = effective_attenuation(view_of(), water)
        transmission, _ = path_transmission(view_of(), water)
        for c in range(3):
            def misfit(rate: float, c: int = c, t: np.ndarray = transmission) -> float:
                return float(np.square(t[:, c] - np.exp(-rate * RANGES.ravel())).sum())

            assert misfit(beta[c]) < min(misfit(1.005 * beta[c]), misfit(0.995 * beta[c]))


@pytest.mark.parametrize("changed", [
    {"veil": (0.0, 1.0, 1.0)}, {"blur": -1.0}, {"water_type": "9C"}, {"plume_share": 1.5},
    {"veil_gradient": 3.0}, {"layer": math.nan}, {"layer_height": math.inf},
])
def test_what_no_water_does_is_refused(changed: dict) -> None:
    with pytest.raises(InputError):
        WaterEffects(**changed)
