# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Semi-global search: paths and tones find disparities in noise that single descriptors miss."""

import numpy as np
import pytest

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas import semi_global
from uw_visibility.stereo.elas.descriptors import BYTES, Descriptors

SETTINGS = StereoConfig(
    plane_radius=2, plane_deviation=1.0, prior_outlier=0.05, likelihood_weight=0.05)
DISPARITIES = 0, 40
NOISE = 15.0


def normalizers(pair, noise=0.0, brighter=0.0):
    """Return both views with noise, in levels, and the right one brighter by some levels."""
    views = []
    for side, pixels in enumerate(pair):
        view = ContrastNormalizer(pixels.shape)
        rng = np.random.default_rng(side)
        levels = 60 + 0.5 * pixels + noise * rng.standard_normal(pixels.shape) + side * brighter
        view.grey[:] = 256 * levels
        view.gain[:] = 1 / 256
        view.noise = NOISE
        views.append(view)
    return views


def search(views, points, *, plane=np.nan, descriptors=True, disparities=DISPARITIES):
    """Return the disparities of both views, and the left ones at sub-pixel resolution."""
    shape, workers = views[0].grey.shape, Workers(1)
    described = []
    for view in views:
        of_view = Descriptors(shape)
        of_view.compute(view.grey, view.gain, workers)
        if not descriptors:
            of_view.horizontal[:] = of_view.vertical[:] = 128
        described.append(of_view)
    best, refined = np.empty((2, *shape), np.int16), np.empty(shape, np.float32)
    semi_global.search(
        SETTINGS, disparities, *views, tuple(described), points,
        np.full(shape, plane, np.float32), np.zeros(shape, np.bool_), best, refined, workers)
    return best, refined


def points_at(*disparities):
    return np.array([(50 + 5 * i, 48, d) for i, d in enumerate(disparities)], np.float32)


def best_descriptors(views):
    """Return the disparity of the best match of each descriptor alone."""
    shape = views[0].grey.shape
    left, right = (Descriptors(shape) for _ in views)
    for described, view in zip((left, right), views, strict=True):
        described.compute(view.grey, view.gain, Workers(1))
    here, there = (d.values.reshape(*shape, BYTES).astype(int) for d in (left, right))
    costs = [np.abs(here - np.roll(there, d, axis=1)).sum(axis=2) for d in range(41)]
    return np.argmin(costs, axis=0)


def test_support_points_beyond_the_limits_leave_the_nearest_disparity_to_try(shifted_pair):
    # The plane of a support point's neighbours may extrapolate.
    best, _ = search(normalizers(shifted_pair(disparity=12)), points_at(48, 49))
    assert set(np.unique(best)) == {-1, DISPARITIES[1]}


def test_paths_match_what_single_descriptors_do_not(shifted_pair):
    views = normalizers(shifted_pair(disparity=12), noise=8.0)
    inner = np.s_[4:-4, 45:-4]
    alone = np.abs(best_descriptors(views)[inner] - 12) <= 1
    best, refined = search(views, points_at(3, 30))
    assert alone.mean() < 0.8
    assert (np.abs(refined[inner] - 12) <= 1).mean() > 0.96
    assert (np.abs(best[1][4:-4, 20:-45] - 12) <= 1).mean() > 0.96


def test_columns_of_repeated_pixels_at_the_border_are_not_matched(shifted_pair):
    best, refined = search(normalizers(shifted_pair(disparity=12), noise=2.0), points_at(3, 30))
    assert (best[0][:, -2:] == -1).all() and np.isnan(refined[:, -2:]).all()
    assert (best[0][4:-4, -3] >= 0).all()


def test_the_mesh_s_plane_tells_where_nothing_else_does():
    blank = np.full((96, 160), 100, np.uint8)
    _, refined = search(normalizers((blank, blank)), points_at(3, 30), plane=17.0)
    np.testing.assert_allclose(refined[:, 45:-2], 17.0, atol=0.1)


@pytest.mark.parametrize("brighter", [0.0, 25.0])
def test_tones_tell_a_smooth_surface_whatever_the_exposure(brighter):
    # Without gradients.
    row = 60 * np.cumsum(np.random.default_rng(2).standard_normal(200)) / 15
    row = np.uint8(np.clip(row - row.min(), 0, 255))
    pair = np.tile(row[:160], (96, 1)), np.tile(row[12:172], (96, 1))
    views = normalizers(pair, brighter=brighter)
    _, refined = search(views, points_at(12, 12, 12, 3, 30), descriptors=False)
    assert (np.abs(refined[:, 45:-4] - 12) <= 1).mean() > 0.9


def test_disparities_are_tried_that_lie_among_those_of_support_points(shifted_pair):
    views = normalizers(shifted_pair(disparity=12))
    best, refined = search(views, points_at(20, 24))
    found = best[0][:, 45:-2]
    assert found.min() >= 16
    assert found.max() <= 29
    assert np.nanmin(refined) > 15


def test_more_disparities_than_a_byte_counts():
    rng = np.random.default_rng(5)
    wide = rng.integers(0, 256, (96, 700)).astype(np.uint8)
    views = normalizers((wide[:, :400], wide[:, 300:]))
    best, refined = search(views, points_at(3, 310), disparities=(0, 320))
    assert (np.abs(refined[4:-4, 310:-4] - 300) <= 1).mean() > 0.99
    assert (np.abs(best[1][4:-4, 10:90] - 300) <= 1).mean() > 0.99


def test_vectors_add_paths_as_the_equation_says():
    rng = np.random.default_rng(6)
    width, count, step, jump = 30, 64, 9, 27
    # The largest costs are those with which three paths still fit 8 bits.
    costs = rng.choice([0, 1, 20, 57], (width, count))
    expected = np.zeros_like(costs)
    for order in (range(width), range(width - 1, -1, -1)):
        path = np.zeros(count, int)
        for x in order:
            beside = np.minimum(np.append(path[1:], 999), np.append(999, path[:-1])) + step
            path = costs[x] + np.minimum(np.minimum(path, beside), path.min() + jump) - path.min()
            expected[x] += path
    paths = np.full((2, 2 * (count + 2)), 200, np.uint8)
    total = np.zeros(width * count, np.uint8)
    semi_global._add_paths(
        costs.astype(np.uint8).ravel(), count, width, np.uint8(step), np.uint8(jump), *paths, total)
    np.testing.assert_array_equal(total.reshape(width, count), expected)


def test_left_of_the_right_view_nothing_is_matched(shifted_pair):
    best, refined = search(normalizers(shifted_pair(disparity=12)), points_at(12, 14))
    # The smallest disparity that is tried is 9, and descriptors extend two pixels.
    np.testing.assert_array_equal(best[0][:, :11], -1)
    assert np.isnan(refined[:, :11]).all()
    assert (best[0][:, 11:-2] >= 0).all()


def test_the_first_matched_column_is_not_drawn_to_smaller_disparities(shifted_pair):
    _, refined = search(normalizers(shifted_pair(disparity=12), noise=2.0), points_at(3, 30))
    assert abs(np.nanmedian(refined[4:-4, 14]) - 12) < 0.2
