# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Depth edges are moved to those of the image, and nothing else is changed."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas.edges import move_edges

SHAPE = (60, 90)
NEAR, FAR = 30.0, 10.0


def contrast(grey, gain=1.0):
    made = ContrastNormalizer(SHAPE)
    made.grey[:] = np.asarray(grey) * 256
    made.gain[:] = gain / 256
    return made


def box():
    """A bright box before a dark wall: image, true disparity, and a map that is 3 px too wide."""
    truth = np.full(SHAPE, FAR, np.float32)
    truth[20:40, 30:60] = NEAR
    grey = np.where(truth == NEAR, 200, 80) + np.random.default_rng(0).integers(-5, 6, SHAPE)
    fat = np.full(SHAPE, FAR, np.float32)
    fat[17:43, 27:63] = NEAR
    return grey, truth, fat


def moved(disparity, image, threads=1):
    result = disparity.copy()
    move_edges(result, image, Workers(threads))
    return result


def test_a_surface_that_grew_over_its_border_shrinks_to_it():
    grey, truth, fat = box()
    result = moved(fat, contrast(grey))
    assert np.mean(fat != truth) > 0.05
    assert np.mean(np.abs(result - truth) > 1) < 0.005


def test_what_would_be_moved_may_be_left_out():
    grey, truth, fat = box()
    dropped = fat.copy()
    move_edges(dropped, contrast(grey), Workers(2), drop=True)
    wrong = fat != truth
    assert np.isnan(dropped[wrong]).mean() > 0.9
    assert np.isnan(dropped[~wrong]).mean() < 0.01
    kept = np.isfinite(dropped)
    np.testing.assert_array_equal(dropped[kept], fat[kept])


def test_contrast_that_water_took_counts_as_it_was():
    grey, truth, fat = box()
    weak = 100 + (grey - 100) / 16
    assert np.mean(np.abs(moved(fat, contrast(weak)) - truth) > 1) > 0.04
    assert np.mean(np.abs(moved(fat, contrast(weak, gain=16)) - truth) > 1) < 0.01


def test_unmatched_pixels_stay_so_and_do_not_vote():
    grey, truth, fat = box()
    holes = np.random.default_rng(1).random(SHAPE) < 0.3
    fat[holes] = np.nan
    result = moved(fat, contrast(grey))
    np.testing.assert_array_equal(np.isnan(result), holes)
    assert np.mean(np.abs(result - truth)[~holes] > 1) < 0.02


def test_a_slanted_surface_is_left_as_it_is():
    slope = np.tile(np.linspace(10, 25, SHAPE[1], dtype=np.float32), (SHAPE[0], 1))
    grey = np.random.default_rng(2).integers(0, 256, SHAPE)
    np.testing.assert_array_equal(moved(slope, contrast(grey)), slope)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_results_lie_within_what_was_seen_for_any_number_of_threads(seed):
    rng = np.random.default_rng(seed)
    disparity = rng.choice([5.0, 9.0, 40.0, np.nan], SHAPE).astype(np.float32)
    image = contrast(rng.integers(0, 256, SHAPE), gain=rng.uniform(0.1, 16))
    one = moved(disparity, image)
    known = np.isfinite(disparity)
    np.testing.assert_array_equal(np.isfinite(one), known)
    assert one[known].min() >= disparity[known].min() - 1e-4
    assert one[known].max() <= disparity[known].max() + 1e-4
    np.testing.assert_array_equal(moved(disparity, image, threads=3), one)


def test_a_surface_of_few_matches_is_not_given_to_the_one_behind():
    """Unmatched pixels do not vote for the far side."""
    grey, truth, _ = box()
    thin = truth.copy()
    near = truth == NEAR
    thin[near & (np.random.default_rng(3).random(SHAPE) < 0.8)] = np.nan
    result = moved(thin, contrast(grey))
    left = near & np.isfinite(thin)
    assert np.mean(result[left] == NEAR) > 0.9
