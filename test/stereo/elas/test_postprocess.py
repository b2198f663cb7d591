# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Consistency check, segments, gaps and the adaptive mean."""

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.elas.postprocess import (
    SegmentFilter,
    check_and_refine,
    fill_small_gaps,
    meeting_of_lines,
)
from uw_visibility.stereo.elas.smoothing import AdaptiveMean

NAN = np.float32(np.nan)


def checked(left, right, tolerance=1):
    descriptors = np.zeros(left.size * 16, np.uint8)
    disparity = np.empty(left.shape, np.float32)
    check_and_refine(
        np.stack([left, right]), (descriptors, descriptors), tolerance, disparity, Workers(1)
    )
    return disparity


def test_views_that_disagree_leave_nothing():
    left = np.full((4, 30), 5, np.int16)
    left[:, :5] = -1
    right = np.full((4, 30), 5, np.int16)
    right[:, 10] = 9
    disparity = checked(left, right)
    assert np.isnan(disparity[:, 15]).all()
    assert np.isnan(disparity[:, :5]).all(), "what was not tried"
    assert (disparity[:, 16:] == 5).all()


def test_small_segments_go_and_large_ones_stay():
    disparity = np.full((40, 50), 10, np.float32)
    disparity[5:9, 5:9] = 30
    disparity[20:32, 20:32] = 30
    SegmentFilter(disparity.shape).remove(disparity, 100, 1.0, Workers(1))
    assert np.isnan(disparity[5:9, 5:9]).all()
    assert (disparity[20:32, 20:32] == 30).all()
    assert np.isnan(disparity).sum() == 16


def test_a_winding_segment_is_one_segment():
    """A spiral is joined late by the scan order."""
    disparity = np.full((30, 30), NAN)
    disparity[2:28, 3] = disparity[27, 3:25] = disparity[5:28, 24] = disparity[5, 8:25] = 7
    count = np.isfinite(disparity).sum()
    SegmentFilter(disparity.shape).remove(disparity, int(count), 1.0, Workers(1))
    assert np.isfinite(disparity).sum() == count


def test_a_slope_is_one_segment():
    slope = np.tile(np.arange(40, dtype=np.float32) * 0.9, (5, 1))
    SegmentFilter(slope.shape).remove(slope, 200, 1.0, Workers(1))
    assert np.isfinite(slope).all()


def test_gaps_are_bridged_and_edges_take_the_far_side():
    row = np.array([[NAN, 10, NAN, NAN, 12, NAN, NAN, 30, NAN, NAN, NAN, NAN, 30]], np.float32)
    fill_small_gaps(row, 3, 3.0, Workers(1))
    np.testing.assert_array_equal(
        row[0], [NAN, 10, 11, 11, 12, 12, 12, 30, NAN, NAN, NAN, NAN, 30]
    )


def test_gaps_are_bridged_along_columns_too():
    column = np.array([[10, NAN, 10], [NAN, NAN, NAN], [10, NAN, 10]], np.float32).repeat(1, 0)
    fill_small_gaps(column, 1, 3.0, Workers(1))
    assert (column == 10).all()


def test_the_mean_takes_noise_off_and_keeps_edges_and_holes():
    rng = np.random.default_rng(0)
    truth = np.full((40, 60), 10, np.float32)
    truth[:, 30:] = 20
    noisy = truth + rng.normal(0, 0.3, truth.shape).astype(np.float32)
    noisy[10:14, 40:44] = NAN
    smoothed = noisy.copy()
    AdaptiveMean(truth.shape, 3.0).smooth(smoothed, 5, Workers(1))
    np.testing.assert_array_equal(np.isnan(smoothed), np.isnan(noisy))
    known = np.isfinite(noisy)
    assert np.std((smoothed - truth)[known]) < 0.35 * np.std((noisy - truth)[known])
    assert np.abs(smoothed - truth)[known].max() < 1


def test_the_mean_leaves_a_slope_as_it_is():
    y, x = np.mgrid[:40, :60]
    slope = (20 + 0.2 * x - 0.1 * y).astype(np.float32)
    smoothed = slope.copy()
    AdaptiveMean(slope.shape, 3.0).smooth(smoothed, 5, Workers(1))
    np.testing.assert_allclose(smoothed[5:-5, 5:-5], slope[5:-5, 5:-5], atol=1e-4)


def test_lines_meet_between_costs():
    assert abs(meeting_of_lines(*(7.0 * abs(d - 0.3) + 2.0 for d in (-1, 0, 1))) - 0.3) < 1e-12
    assert abs(meeting_of_lines(*(7.0 * abs(d + 0.4) + 2.0 for d in (-1, 0, 1))) + 0.4) < 1e-12
    assert meeting_of_lines(1.0, 1.0, 1.0) == 0.0
