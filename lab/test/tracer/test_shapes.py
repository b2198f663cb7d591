# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Noise and meshes: closed, of the size they are said to be, the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility_lab.tracer.shapes import (
    fractal,
    grid_faces,
    painted,
    polar_grid,
    rotation,
    sphere,
    value_noise,
)


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


def test_a_rotation_keeps_lengths_and_turns_by_its_angle() -> None:
    turn = rotation(np.array([0.0, 0.0, 2.0]), np.pi / 2.0)
    assert turn @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert turn @ turn.T == pytest.approx(np.eye(3))


def test_noise_is_smooth_bounded_and_its_seeds() -> None:
    points = np.random.default_rng(1).uniform(-50.0, 50.0, (4000, 3))
    values = value_noise(points, 5)
    assert np.abs(values).max() <= 1.0
    assert abs(values.mean()) < 0.05
    assert values.std() > 0.2
    assert np.abs(value_noise(points + 1e-4, 5) - values).max() < 1e-3
    np.testing.assert_array_equal(values, value_noise(points, 5))
    assert abs(np.corrcoef(values, value_noise(points, 6))[0, 1]) < 0.1


def test_octaves_that_samples_cannot_carry_are_left_out() -> None:
    points = np.random.default_rng(2).uniform(0.0, 9.0, (500, 3))
    assert not fractal(points, 1, 1.0, 4, spacing=2.0).any()
    assert fractal(points, 1, 1.0, 4, spacing=0.01).std() > 0.1


def test_paint_stays_within_believable_reflectances() -> None:
    points = np.random.default_rng(3).uniform(0.0, 9.0, (3000, 3))
    palette = np.array([[0.1, 0.1, 0.1], [0.6, 0.5, 0.4]])
    colour = painted(points, palette, 1, 1.0, 0.1, 0.5, 0.01)
    assert colour.min() >= 0.01
    assert colour.max() <= 0.95
    # Both colours of the palette are seen.
    assert np.quantile(colour[:, 0], 0.1) < 0.2 < 0.4 < np.quantile(colour[:, 0], 0.9)
