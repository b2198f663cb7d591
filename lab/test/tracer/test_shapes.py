# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Meshes: closed, and of the size they are said to be."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility_lab.tracer.shapes import grid_faces, polar_grid, sphere


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
