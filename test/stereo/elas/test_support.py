# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Support points are found where texture is unique, and only there."""

import numpy as np
import pytest

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.stereo.elas.matcher import Matcher
from uw_visibility.stereo.elas.support import (
    keep_consistent,
    mark_vertices,
    smooth,
    vertex_of_parabola,
)


def search(pair, contrast_of, disparities=(0, 40), **config):
    left, right = pair
    matcher = Matcher(left.shape, disparities, StereoConfig(**config), Workers(1))
    for side, view in enumerate((contrast_of(left), contrast_of(right))):
        matcher.describe_view(side, view)
    return matcher.support_points()


def test_a_textured_plane_gives_its_disparity_nearly_everywhere(shifted_pair, contrast_of):
    support = search(shifted_pair(disparity=12), contrast_of)
    assert len(support) > 0.8 * (96 // 5) * ((160 - 12) // 5)
    np.testing.assert_allclose(support.points[:, 2], 12, atol=0.5)
    assert np.mean(np.abs(support.points[:, 2] - 12) < 0.1) > 0.95


def test_a_half_pixel_is_seen(texture, contrast_of):
    """The left view is the mean of two shifts, so that its disparity is between them."""
    wide = texture((96, 400))
    smooth = wide.astype(float)
    smooth = (np.roll(smooth, 1, 1) + 2 * smooth + np.roll(smooth, -1, 1)) / 4
    fine = np.repeat(smooth, 2, 1)
    left = fine[:, 2:322:2].astype(np.uint8)
    shifted = (fine[:, 21:341:2] + fine[:, 22:342:2]) / 2
    support = search((left, shifted.astype(np.uint8)), contrast_of)
    assert 9.3 < np.median(support.points[:, 2]) < 10.2
    assert abs(np.median(support.points[:, 2]) - 9.75) < 0.35


def test_nothing_is_found_without_texture(contrast_of):
    flat = np.full((96, 160), 90, np.uint8)
    assert len(search((flat, flat), contrast_of)) == 0


def test_nothing_is_found_between_unrelated_images(texture, contrast_of):
    support = search((texture((96, 160), 1), texture((96, 160), 2)), contrast_of)
    assert len(support) <= 0.01 * (96 // 5) * (160 // 5)


def test_a_pattern_that_repeats_is_refused(texture, contrast_of):
    """Two disparities fit equally well: neither is accepted where both are in the image."""
    tile = texture((96, 16))
    pattern = np.tile(tile, (1, 12))
    left, right = pattern[:, :160].copy(), pattern[:, 8:168].copy()
    support = search((left, right), contrast_of)
    assert np.count_nonzero(support.points[:, 0] > 24 + 5) == 0


def test_negative_disparities_are_not_matched(shifted_pair, contrast_of):
    left, right = shifted_pair(disparity=12)
    assert len(search((right, left), contrast_of)) <= 5


def test_parabola_finds_its_vertex():
    costs = [(d - 0.3) ** 2 for d in (-1, 0, 1)]
    assert abs(vertex_of_parabola(*costs) - 0.3) < 1e-12
    assert vertex_of_parabola(1.0, 1.0, 1.0) == 0.0


def test_an_earlier_match_decides_where_a_pattern_repeats(texture, contrast_of):
    """Tiles differ slightly, so that the best match is the true one, but only just."""
    pattern = np.tile(texture((96, 16)), (1, 12)).astype(float)
    pattern += 0.03 * texture(pattern.shape, 5)
    pattern = np.clip(pattern, 0, 255).astype(np.uint8)
    left, right = pattern[:, :160].copy(), pattern[:, 8:168].copy()
    matcher = Matcher((96, 160), (0, 40), StereoConfig(), Workers(1))
    for side, view in enumerate((contrast_of(left), contrast_of(right))):
        matcher.describe_view(side, view)
    u, v = (grid.ravel() for grid in np.meshgrid(np.arange(60, 140, 8), np.arange(20, 80, 8)))

    def inside(earlier_disparity):
        earlier = None
        if earlier_disparity is not None:
            earlier = np.stack([u, v, np.full(len(u), earlier_disparity)], 1).astype(np.float32)
        points = matcher.support_points(earlier=earlier).points
        kept = (points[:, 0] > 58) & (points[:, 0] < 142)
        return points[kept & (points[:, 1] > 18) & (points[:, 1] < 82)]

    alone = inside(None)
    assert len(alone) < 0.2 * 16 * 12
    assert len(inside(8.3)) > 0.8 * 16 * 12
    np.testing.assert_allclose(inside(8.3)[:, 2], 8, atol=0.5)
    # An earlier match at another disparity does not make that the best match.
    np.testing.assert_allclose(inside(24.0), alone, atol=0.1)


def test_beside_an_earlier_match_only_disparities_around_it_are_tried(shifted_pair, contrast_of):
    left, right = shifted_pair(disparity=30)
    matcher = Matcher(left.shape, (0, 60), StereoConfig(), Workers(1))
    for side, view in enumerate((contrast_of(left), contrast_of(right))):
        matcher.describe_view(side, view)
    u, v = (grid.ravel() for grid in np.meshgrid(np.arange(60, 150, 5), np.arange(5, 95, 5)))

    def found(earlier_disparity):
        earlier = np.stack([u, v, np.full(len(u), earlier_disparity)], 1).astype(np.float32)
        points = matcher.support_points(earlier=earlier).points
        return np.count_nonzero((points[:, 0] > 62) & (points[:, 0] < 148))

    for near in (15.0, 30.0, 45.0):
        assert found(near) > 250
    assert found(10.0) < 40 and found(50.0) < 40


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
