# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filters on the grid of support points."""

import numpy as np
import pytest

from uw_visibility.stereo.elas.support_filter import keep_consistent, mark_vertices, smooth


def slope(rows=30, columns=40, across=0.2, down=0.1, base=20.0):
    y, x = np.mgrid[:rows, :columns]
    return (base + across * x + down * y).astype(np.float32)


def test_an_outlier_goes_and_its_neighbours_stay():
    grid = slope()
    grid[15, 20] += 30
    kept = np.empty_like(grid)
    keep_consistent(0, 30, grid, 5, np.float32(2), 5, kept)
    assert kept[15, 20] < 0
    assert (kept >= 0).sum() == grid.size - 1


def test_a_lonely_pair_of_points_goes():
    grid = np.full((30, 40), -1, np.float32)
    grid[15, 20:22] = 25
    kept = np.empty_like(grid)
    keep_consistent(0, 30, grid, 5, np.float32(2), 5, kept)
    assert (kept < 0).all()


def test_smoothing_leaves_a_plane_as_it_is():
    grid = slope()
    smoothed = np.empty_like(grid)
    smooth(0, 30, grid, np.full_like(grid, 0.2), smoothed)
    np.testing.assert_allclose(smoothed[8:-8, 8:-8], grid[8:-8, 8:-8], atol=1e-3)


def test_smoothing_takes_noise_off_vague_points_only():
    rng = np.random.default_rng(0)
    truth = slope()
    noisy = truth + rng.normal(0, 0.5, truth.shape).astype(np.float32)
    vague, sure = np.empty_like(truth), np.empty_like(truth)
    smooth(0, 30, noisy, np.full_like(truth, 2.0), vague)
    deviation = np.full_like(truth, 2.0)
    deviation[10, 10] = 0.01
    smooth(0, 30, noisy, deviation, sure)
    assert np.std(vague - truth) < 0.3 * np.std(noisy - truth)
    assert abs(sure[10, 10] - noisy[10, 10]) < abs(vague[10, 10] - noisy[10, 10])


def test_smoothing_keeps_a_depth_edge():
    grid = np.full((30, 40), 10, np.float32)
    grid[:, 20:] = 18
    smoothed = np.empty_like(grid)
    smooth(0, 30, grid, np.full_like(grid, 1.0), smoothed)
    np.testing.assert_allclose(smoothed, grid, atol=1e-4)


@pytest.mark.parametrize("step", [0.0, 4.0])
def test_the_mesh_keeps_edges_and_thins_flats(step):
    grid = np.full((40, 40), 10, np.float32)
    grid[:, 20:] += step
    vertices = np.empty(grid.shape, np.bool_)
    mark_vertices(0, 40, grid, vertices)
    inside = vertices[2:-2, 2:-2]
    assert inside.sum() < 0.15 * inside.size
    assert vertices[2:-2, 19:21].all() == bool(step)
