# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The disparity map of the right view."""

import numpy as np

from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.views import in_right_view

NAN = np.float32(np.nan)


def test_of_two_surfaces_the_nearer_is_seen_and_behind_it_the_farther():
    row = np.array([[2, 2, 2, 2, 5, 5, 5, 2, 2, 2]], np.float32)
    # Positions: -2 -1 0 1 | -1 0 1 | 5 6 7
    expected = [[5, 5, 2, 2, 2, 2, 2, 2, 2, 2]]
    np.testing.assert_array_equal(in_right_view(row), expected)


def test_a_slope_stays_without_cracks():
    x = np.tile(np.arange(100), (20, 1))
    left = (5 + 0.1 * x).astype(np.float32)
    right = in_right_view(left, Workers(3))
    inside = right[:, 5:80]
    # A pixel x' of the right view sees x = (x' + 5) / 0.9.
    truth = 5 + 0.1 * (x[:, 5:80] + 5) / 0.9
    assert np.abs(inside - truth).max() < 0.15


def test_holes_of_the_input_and_empty_rows():
    left = np.full((2, 12), 3, np.float32)
    left[0, 5:8] = NAN
    left[1] = NAN
    right = in_right_view(left)
    assert (right[0] == 3).all()
    assert np.isnan(right[1]).all()


def test_disparities_beyond_the_image_do_not_write_there():
    left = np.full((3, 10), 50, np.float32)
    left[:, 9] = 1
    np.testing.assert_array_equal(in_right_view(left), np.full((3, 10), 1, np.float32))
