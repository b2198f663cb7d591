# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Rays against shapes whose distance is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import flat_floor

from uw_visibility_lab.simulation.raycast import floor_distance
from uw_visibility_lab.simulation.scene import SPACING, reef
from uw_visibility_lab.simulation.shapes import (
    CAPSULE,
    ELLIPSOID,
    NOWHERE,
    axes_along,
    meet_shape,
    shape_row,
)

DIRECTION = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda d: np.linalg.norm(d) > 0.1)


def unit(direction: tuple[float, ...]) -> np.ndarray:
    return np.array(direction) / np.linalg.norm(direction)


def test_floor_is_where_the_ray_says() -> None:
    scene = flat_floor()
    eye = np.array([0.0, 0.0, 1.5])
    for direction in ((1.0, 0.2, -0.5), (-0.3, 0.9, -2.0), (0.0, 0.0, -1.0)):
        dx, dy, dz = unit(direction)
        assert floor_distance(scene, eye, dx, dy, dz, 40.0) == pytest.approx(-1.5 / dz, abs=1e-3)


def test_floor_is_not_met_upwards_or_beyond_the_limit() -> None:
    scene = flat_floor()
    eye = np.array([0.0, 0.0, 1.5])
    assert floor_distance(scene, eye, 1.0, 0.0, 0.0, 40.0) == NOWHERE
    assert floor_distance(scene, eye, *unit((1.0, 0.0, 0.1)), 40.0) == NOWHERE
    assert floor_distance(scene, eye, *unit((1.0, 0.0, -0.5)), 3.0) == NOWHERE


def test_rough_floor_is_met_at_its_first_crossing() -> None:
    scene = reef(3, 2.0, 8.0)
    eye = np.array([0.0, 0.0, 1.5])
    steps = np.arange(0.2, 8.0, 0.0005)
    for heading in np.linspace(-0.6, 0.6, 9):
        direction = unit((math.cos(heading), math.sin(heading), -0.3))
        points = eye + steps[:, np.newaxis] * direction
        column, row = ((points[:, k] - scene.origin[k]) / SPACING for k in (0, 1))
        inside = (column < scene.heights.shape[1] - 2) & (row < scene.heights.shape[0] - 2)
        i, j = column.astype(int)[inside], row.astype(int)[inside]
        u, v, h = column[inside] - i, row[inside] - j, scene.heights
        floor = (1 - v) * ((1 - u) * h[j, i] + u * h[j, i + 1]) + v * (
            (1 - u) * h[j + 1, i] + u * h[j + 1, i + 1]
        )
        below = np.flatnonzero(points[inside, 2] < floor)
        assert floor_distance(scene, eye, *direction, 40.0) == pytest.approx(
            steps[below[0]], abs=0.002
        )


@settings(deadline=None)
@given(DIRECTION)
def test_a_ball_as_ellipsoid(direction: tuple[float, ...]) -> None:
    aim = unit(direction)
    centre = 5.0 * aim
    ball = shape_row(ELLIPSOID, centre, (2.0, 2.0, 2.0))
    assert meet_shape(ball, 0.0, 0.0, 0.0, *aim) == pytest.approx(3.0)
    assert meet_shape(ball, 0.0, 0.0, 0.0, *-aim) == NOWHERE


@settings(max_examples=50, deadline=None)
@given(DIRECTION, DIRECTION, st.floats(0.0, 1.0), st.floats(0.05, 0.5))
def test_a_capsule_is_met_on_its_surface(
    axis: tuple[float, ...], direction: tuple[float, ...], share: float, radius: float
) -> None:
    start = np.array([0.5, -0.3, 0.2])
    end = start + np.array(axis)
    aim = unit(direction)
    eye = start + share * (end - start) - 6.0 * aim
    half = (radius, radius, np.linalg.norm(end - start) / 2)
    capsule = shape_row(CAPSULE, (start + end) / 2, half, axes_along(*(end - start)))
    distance = meet_shape(capsule, *eye, *aim)
    hit = eye + distance * aim
    along = np.clip((hit - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
    assert np.linalg.norm(hit - start - along * (end - start)) == pytest.approx(radius, abs=1e-6)
    # It is the near side: the ray was aimed at the axis.
    assert distance < 6.0
