# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Consistency check, segments, gaps and the adaptive mean."""

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.elas.dense import meeting_of_lines
from uw_visibility.stereo.elas.postprocess import (
    check,
    fill_small_gaps,
    remove_occluded,
    remove_segments,
    smooth,
)

NAN = np.float32(np.nan)


def checked(left, right, tolerance=1):
    disparity = left.astype(np.float32)
    check(np.stack([left, right]), tolerance, disparity, Workers(1))
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


def test_the_right_view_tells_disparities_that_lead_into_its_border():
    columns = np.arange(30)
    left = np.tile(np.minimum(9, columns - 2), (4, 1)).astype(np.int16)
    left[:, :2] = -1
    right = np.full((4, 30), 9, np.int16)
    disparity = checked(left, right, tolerance=2)
    # At columns 9 and 10, the pixels of the right view are those of its border, 0 and 1.
    np.testing.assert_array_equal(disparity[:, 9:], 9)
    assert np.isnan(disparity[:, :9]).all()
    right[:, 2] = 7
    np.testing.assert_array_equal(checked(left, right, tolerance=2)[:, 9:11], [[7, 8]] * 4)


def test_small_segments_go_and_large_ones_stay():
    disparity = np.full((40, 50), 10, np.float32)
    disparity[5:9, 5:9] = 30
    disparity[20:32, 20:32] = 30
    remove_segments(disparity, 100, 1.0)
    assert np.isnan(disparity[5:9, 5:9]).all()
    assert (disparity[20:32, 20:32] == 30).all()
    assert np.isnan(disparity).sum() == 16


def test_a_winding_segment_is_one_segment():
    """The parts of a spiral are connected late in scan order."""
    disparity = np.full((30, 30), NAN)
    disparity[2:28, 3] = disparity[27, 3:25] = disparity[5:28, 24] = disparity[5, 8:25] = 7
    count = np.isfinite(disparity).sum()
    remove_segments(disparity, int(count), 1.0)
    assert np.isfinite(disparity).sum() == count


def test_a_slope_is_one_segment():
    slope = np.tile(np.arange(40, dtype=np.float32) * 0.9, (5, 1))
    remove_segments(slope, 200, 1.0)
    assert np.isfinite(slope).all()


def test_gaps_are_bridged_and_edges_take_the_far_side():
    row = np.array([[NAN, 10, NAN, NAN, 13, NAN, NAN, 30, NAN, NAN, NAN, NAN, 32]], np.float32)
    fill_small_gaps(row, 3, 3.0, Workers(1))
    np.testing.assert_allclose(
        row[0], [NAN, 10, 11, 12, 13, 13, 13, 30, NAN, NAN, NAN, NAN, 32], rtol=1e-6
    )


def test_gaps_in_one_surface_may_be_three_times_as_wide():
    row = np.full((1, 24), NAN)
    row[0, [0, 10, 23]] = 10, 10.5, 10
    fill_small_gaps(row, 3, 3.0, Workers(1))
    np.testing.assert_allclose(row[0, :11], np.linspace(10, 10.5, 11), rtol=1e-6)
    assert np.isnan(row[0, 11:23]).all()


def test_gaps_are_bridged_along_columns_too():
    column = np.array([[10, NAN, 10], [NAN, NAN, NAN], [10, NAN, 10]], np.float32).repeat(1, 0)
    fill_small_gaps(column, 1, 3.0, Workers(1))
    assert (column == 10).all()


def test_what_something_nearer_hides_from_the_right_view_goes():
    """Left of a box as many pixels of the wall as the disparities differ by, and no others."""
    disparity = np.full((3, 60), 5, np.float32)
    disparity[:, 30:45] = 12
    disparity[1, 33:35] = NAN
    remove_occluded(disparity, Workers(1))
    hidden = np.zeros(disparity.shape, bool)
    hidden[:, 23:30] = hidden[:, :5] = True
    # The right view may see the wall through a hole in the box.
    hidden[1, 26:28] = False
    hidden[1, 33:35] = True
    np.testing.assert_array_equal(np.isnan(disparity), hidden)


def test_a_slanted_wall_hides_nothing_of_itself():
    slant = np.tile(20 + 0.6 * np.arange(60, dtype=np.float32), (2, 1))
    seen = slant <= np.arange(60) + 0.5
    remove_occluded(slant, Workers(1))
    np.testing.assert_array_equal(np.isfinite(slant), seen)


def test_the_mean_takes_noise_off_and_keeps_edges_and_holes():
    rng = np.random.default_rng(0)
    truth = np.full((40, 60), 10, np.float32)
    truth[:, 30:] = 20
    noisy = truth + rng.normal(0, 0.3, truth.shape).astype(np.float32)
    noisy[10:14, 40:44] = NAN
    smoothed = noisy.copy()
    smooth(smoothed, 5, 3.0, Workers(1))
    np.testing.assert_array_equal(np.isnan(smoothed), np.isnan(noisy))
    known = np.isfinite(noisy)
    assert np.std((smoothed - truth)[known]) < 0.35 * np.std((noisy - truth)[known])
    assert np.abs(smoothed - truth)[known].max() < 1


def test_the_mean_leaves_a_slope_as_it_is():
    y, x = np.mgrid[:40, :60]
    slope = (20 + 0.2 * x - 0.1 * y).astype(np.float32)
    smoothed = slope.copy()
    smooth(smoothed, 5, 3.0, Workers(1))
    np.testing.assert_allclose(smoothed[5:-5, 5:-5], slope[5:-5, 5:-5], atol=1e-4)


def test_lines_meet_between_costs():
    assert abs(meeting_of_lines(*(7.0 * abs(d - 0.3) + 2.0 for d in (-1, 0, 1))) - 0.3) < 1e-12
    assert abs(meeting_of_lines(*(7.0 * abs(d + 0.4) + 2.0 for d in (-1, 0, 1))) + 0.4) < 1e-12
    assert meeting_of_lines(1.0, 1.0, 1.0) == 0.0
