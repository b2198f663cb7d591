# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The mesh: points on a plane yield that plane over the image."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.elas.mesh import rasterize, triangulate, with_corners

SHAPE = (60, 80)


def points_on_plane(seed, a=0.1, b=-0.05, c=20.0, count=60):
    rng = np.random.default_rng(seed)
    at = rng.choice(SHAPE[0] * SHAPE[1], count, replace=False)
    v, u = np.divmod(at, SHAPE[1])
    return np.stack([u, v, a * u + b * v + c], 1).astype(np.float32)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.integers(3, 200))
def test_a_plane_is_rendered_exactly_inside_of_the_hull(seed, count):
    points = points_on_plane(seed, count=count)
    disparity = np.empty(SHAPE, np.float32)
    rasterize(triangulate(points, SHAPE), disparity, Workers(1))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    covered = np.isfinite(disparity)
    expected = 0.1 * x - 0.05 * y + 20.0
    np.testing.assert_allclose(disparity[covered], expected[covered], atol=0.02)


def test_the_mesh_covers_the_hull_without_holes():
    """With corners every pixel is in a triangle, except slivers at the edge of the image."""
    points = with_corners(points_on_plane(3), SHAPE)
    disparity = np.empty(SHAPE, np.float32)
    rasterize(triangulate(points, SHAPE), disparity, Workers(1))
    assert np.isfinite(disparity[1:-1, 1:-1]).all()


def test_corners_take_the_nearest_disparity():
    points = np.array([[10, 10, 5], [70, 50, 9]], np.float32)
    corners = with_corners(points, SHAPE)[2:]
    np.testing.assert_array_equal(
        corners, [[0, 0, 5], [79, 0, 9], [0, 59, 5], [79, 59, 9]]
    )


def test_too_few_points_make_no_triangles():
    assert triangulate(np.empty((0, 3), np.float32), SHAPE).shape == (0, 3, 3)
    line = np.array([[10, 10, 5], [20, 20, 5], [30, 30, 5]], np.float32)
    disparity = np.zeros(SHAPE, np.float32)
    rasterize(triangulate(line, SHAPE), disparity, Workers(1))
    assert np.isfinite(disparity).sum() <= 30


def test_where_the_mesh_bridges_a_step_of_depth_is_marked():
    """Between the columns of a wall and of a box in front of it, but not on a slanted floor."""
    y, x = (grid.ravel() for grid in np.mgrid[2:60:5, 2:80:5])
    for slope, step, expected in ((0.1, 0.0, 0), (0.1, 9.0, SHAPE[0] * 5)):
        d = 20 + slope * x + 0.4 * y + np.where(x >= 42, step, 0)
        disparity, steep = np.empty(SHAPE, np.float32), np.empty(SHAPE, np.bool_)
        points = np.stack([x, y, d], 1).astype(np.float32)
        rasterize(triangulate(points, SHAPE), disparity, Workers(1), steep)
        np.testing.assert_allclose(steep.sum(), expected, rtol=0.3)
        assert not steep[:, :36].any()
        assert not steep[:, 43:].any()
