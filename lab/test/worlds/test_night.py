# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames by lamps: the same but for their effects, with beams and phase functions of their own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

from uw_visibility.config.schema import PipelineConfig
from uw_visibility_lab.simulation.lamp_light import Beam, gaussian_beam
from uw_visibility_lab.worlds.lamps import (
    cosine_beam,
    normals_of,
    rays_of,
    rimmed_beam,
    two_terms,
)
from uw_visibility_lab.worlds.night import EFFECTS, Night, draw_night
from uw_visibility_lab.worlds.scenes import Scene

SHAPE = (240, 320)
ROWS = np.linspace(2.0, 1.0, SHAPE[0], dtype=np.float32)[:, np.newaxis]
FLOOR = Scene(
    "floor", "procedural",
    np.random.default_rng(1).uniform(0.1, 0.7, (*SHAPE, 3)).astype(np.float32),
    np.repeat(ROWS, SHAPE[1], axis=1))


def night(*effects: str, daylight: float | None = None) -> Night:
    return draw_night(np.random.default_rng(3), FLOOR, effects, daylight)


@pytest.mark.parametrize("beam", [gaussian_beam, cosine_beam, rimmed_beam])
def test_beams_have_half_of_their_power_at_half_of_their_angle(beam: Beam) -> None:
    assert beam(np.cos(np.zeros(1)), 80.0)[0] == pytest.approx(1.0, abs=0.01)
    half = beam(np.cos(np.array([math.radians(40.0)])), 80.0)[0]
    assert half == pytest.approx(0.5, abs=0.05)


def test_two_terms_scatter_all_light_and_some_of_it_back() -> None:
    phase = two_terms()
    angle = np.linspace(0.0, math.pi, len(phase))
    ring = 2.0 * math.pi * np.sin(angle) * phase
    assert trapezoid(ring, angle) == pytest.approx(1.0, abs=1e-3)
    back = angle > math.pi / 2
    assert 0.018 < trapezoid(ring[back], angle[back]) < 0.03


def test_normals_of_a_wall_face_the_camera() -> None:
    rays = rays_of(SHAPE, 0.9)
    normals = normals_of(rays, (3.0 / rays[..., 2]).astype(np.float32))
    np.testing.assert_allclose(normals[5:-5, 5:-5] - [0.0, 0.0, -1.0], 0.0, atol=1e-3)


def test_effects_change_what_they_are_called_and_nothing_else() -> None:
    plain = night()
    told = PipelineConfig.from_parameters(plain.lighting).lighting
    for effect in EFFECTS:
        other = night(effect)
        np.testing.assert_array_equal(other.attenuation, plain.attenuation)
        changed = {key for key in plain.lighting if other.lighting[key] != plain.lighting[key]}
        of_lamps = {
            "misplaced": {"lighting.positions", "lighting.directions"},
            "beam angle": {"lighting.beam_angles"}, "unequal": {"lighting.colours"}}
        assert changed == of_lamps.get(effect, set()), effect
        same = np.array_equal(other.image, plain.image)
        assert same == (effect in of_lamps or effect == "gaps"), effect
    assert told.model == "lamps"


def test_rough_ground_darkens_less_than_lamberts_and_even_ground_differs_less() -> None:
    # Of the same lamps and water; exposure makes the brightest alike.
    images = {
        name: night(*effects).image.astype(float)
        for name, effects in (("Lambert", ()), ("rough", ("rough",)), ("facing", ("facing",)))}
    far_over_near = {
        name: image[10:40].mean() / image[-40:-10].mean() for name, image in images.items()}
    low, high = sorted((far_over_near["Lambert"], far_over_near["facing"]))
    assert low < far_over_near["rough"] < high
    even = draw_night(np.random.default_rng(3), FLOOR, (), contrast=0.2).image.astype(float)

    def texture(image: np.ndarray) -> float:
        near = image[-40:-10, 100:220, 1]
        return float(np.abs(np.diff(near, axis=1)).mean() / near.mean())

    assert texture(even) < 0.5 * texture(images["Lambert"])


def test_even_ground_before_open_water_is_no_darker_than_uneven_one() -> None:
    # Nothing is there in two thirds of the image, and its reflectance is 0.
    rows = SHAPE[0] * 2 // 3
    reflectance, ranges = FLOOR.reflectance.copy(), FLOOR.range.copy()
    reflectance[:rows], ranges[:rows] = 0.0, np.inf
    shore = replace(FLOOR, reflectance=reflectance, range=ranges)
    ground_over_water = [
        image[-30:].mean() / image[10:40].mean()
        for image in (
            draw_night(np.random.default_rng(3), shore, (), contrast=contrast).image.astype(float)
            for contrast in (1.0, 0.2))]
    assert ground_over_water[1] == pytest.approx(ground_over_water[0], rel=0.02)


def test_clear_water_absorbs_red_and_does_not_scatter_it() -> None:
    # Red is the channel that clear water takes most of, and particles take alike of all.
    shore = replace(FLOOR, range=np.where(np.arange(SHAPE[0])[:, None] < 100, np.inf, FLOOR.range))
    veils = []
    for seed in range(12):
        frame = draw_night(np.random.default_rng(seed), shore, ())
        image = frame.image[10:60].astype(float).mean(axis=(0, 1))
        veils.append(image[0] / image.max())
        assert frame.attenuation[0] > frame.attenuation[2]
    assert np.median(veils) < 0.8


def test_daylight_is_told_and_adds_light() -> None:
    some, much = night(daylight=0.0), night(daylight=0.9)
    assert some.lighting["lighting.model"] == much.lighting["lighting.model"] == "both"
    assert not np.array_equal(some.image, much.image)
