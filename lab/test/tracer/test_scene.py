# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Drawn scenes: believable waters, nothing at the camera, the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.tracer.scene import (
    ALBEDO,
    BEAM,
    KINDS,
    draw_scene,
    draw_water,
    grid_faces,
    ground_of,
    polar_grid,
    sphere,
)


def test_waters_are_within_what_is_asked_for_and_red_is_lost_first() -> None:
    random = np.random.default_rng(4)
    waters = [draw_water(random) for _ in range(200)]
    beam = np.array([w.beam_attenuation for w in waters])
    albedo = np.array([w.albedo for w in waters])
    assert beam.min() >= BEAM[0] - 1e-5
    assert beam.max() <= BEAM[1] + 1e-5
    assert albedo.min() >= ALBEDO[0] - 1e-4
    assert albedo.max() <= ALBEDO[1] + 1e-4
    # Clear and thick, blue and green waters are among them.
    assert beam[:, 1].min() < 0.13 < 0.3 < beam[:, 1].max()
    assert 0.2 < (np.argmin(beam, axis=1) == 2).mean() < 0.8
    assert {w.phase for w in waters} == {"henyey-greenstein", "fournier-forand"}


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_scene_is_its_seeds_and_leaves_the_camera_room(kind: str) -> None:
    first, again, other = draw_scene(7, kind), draw_scene(7, kind), draw_scene(8, kind)
    assert first == again
    assert first.water != other.water
    ground = ground_of(first)
    np.testing.assert_array_equal(ground.vertices, ground_of(again).vertices)
    camera = np.array([0.0, 0.0, first.altitude])
    assert np.isfinite(ground.vertices).all()
    assert ground.faces.max() < len(ground.vertices)
    assert ground.reflectance.shape == (len(ground.vertices), 3)
    assert 0.0 <= ground.reflectance.min() < ground.reflectance.max() < 1.0
    assert np.linalg.norm(ground.vertices - camera, axis=1).min() > 0.5
    # All is below the surface.
    assert ground.vertices[:, 2].max() < first.altitude + first.depth


def test_lamps_take_the_place_of_daylight() -> None:
    night = draw_scene(3, "reef", lamps=2)
    assert night.daylight == (0.0, 0.0, 0.0)
    assert len(night.lamps) == 2
    assert night.lamps[0].position[0] == -night.lamps[1].position[0]


def test_an_unknown_kind_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match="boulders, reef"):
        draw_scene(1, "wreck")


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the area of a mesh."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the volume in a closed mesh, above 0 with faces seen from outside."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def test_the_sphere_is_closed_and_faces_one_way() -> None:
    vertices, faces = sphere(24)
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(1.0)
    assert abs(volume(vertices, faces)) == pytest.approx(4.0 * np.pi / 3.0, rel=0.01)
    assert area(vertices, faces) == pytest.approx(4.0 * np.pi, rel=0.01)


def test_the_polar_grid_goes_all_round_without_a_gap() -> None:
    points, spacing = polar_grid(0.5, 2.0, 40, 400)
    assert area(points, grid_faces(40, 400)) == pytest.approx(
        np.pi * (2.0**2 - 0.5**2), rel=0.005)
    assert (spacing > 0.0).all()
