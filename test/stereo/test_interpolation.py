# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filling of disparity maps: gaps, large areas."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from uw_visibility.compute.threads import Workers
from uw_visibility.stereo import interpolation
from uw_visibility.stereo.interpolation import inpaint

SHAPE = (40, 60)
NEAR, FAR = 20.0, 8.0
maps = hnp.arrays(
    np.float32, st.tuples(st.integers(1, 30), st.integers(1, 30)),
    elements=st.one_of(st.just(np.nan), st.floats(0.5, 60, width=32)),
)


def fill_gaps(left: np.ndarray, max_gap: int = 40) -> np.ndarray:
    return interpolation.fill_gaps(left, max_gap, Workers(1))


def test_occlusions_get_the_background_and_holes_in_the_foreground_stay_near() -> None:
    truth = np.full(SHAPE, FAR, np.float32)
    truth[10:30, 30:50] = NEAR
    left = truth.copy()
    left[10:30, 18:30] = np.nan
    left[18:22, 36:42] = np.nan
    np.testing.assert_array_equal(fill_gaps(left), truth)


def test_a_gap_over_an_edge_gets_the_background() -> None:
    left = np.full(SHAPE, FAR, np.float32)
    left[:, 30:] = NEAR
    left[10:30, 22:38] = np.nan
    filled = fill_gaps(left)
    np.testing.assert_array_equal(filled[10:30, 22:38], FAR)


def test_at_the_border_a_gap_gets_its_only_side() -> None:
    left = np.full(SHAPE, NEAR, np.float32)
    left[:, :7] = left[:, -5:] = np.nan
    np.testing.assert_array_equal(fill_gaps(left), np.full_like(left, NEAR))


def test_open_areas_beyond_the_reach_stay_open() -> None:
    left = np.full((40, 100), FAR, np.float32)
    left[:20, 20:90] = left[20:, 20:40] = np.nan
    filled = fill_gaps(left, max_gap=10)
    assert np.isnan(filled[:20, 20:90]).all()
    assert (filled[20:] == FAR).all()


@settings(max_examples=60, deadline=None)
@given(maps, st.integers(1, 12))
def test_matched_pixels_stay_and_gaps_take_values_that_were_seen(
    left: np.ndarray, max_gap: int
) -> None:
    filled = fill_gaps(left, max_gap)
    known = np.isfinite(left)
    np.testing.assert_array_equal(filled[known], left[known])
    assert np.isin(filled[np.isfinite(filled)], left[known]).all()


@settings(max_examples=60, deadline=None)
@given(maps)
def test_inpainting_leaves_no_hole_and_invents_no_extremes(disparity: np.ndarray) -> None:
    filled = inpaint(disparity)
    known = np.isfinite(disparity)
    if not known.any():
        assert np.isnan(filled).all()
        return
    np.testing.assert_array_equal(filled[known], disparity[known])
    # Means of equal numbers may be rounded away from them.
    assert filled.min() >= disparity[known].min() * (1 - 1e-6)
    assert filled.max() <= disparity[known].max() * (1 + 1e-6)


def test_inpainting_carries_surroundings_into_a_large_hole() -> None:
    disparity = np.full((120, 200), FAR, np.float32)
    disparity[:, 120:] = NEAR
    disparity[30:90, 20:80] = np.nan
    disparity[30:90, 140:190] = np.nan
    filled = inpaint(disparity)
    np.testing.assert_allclose(filled[30:90, 20:80], FAR, atol=1e-3)
    np.testing.assert_allclose(filled[30:90, 140:190], NEAR, atol=1e-3)


def test_real_occlusions_are_filled_better_than_by_the_mean_of_both_sides(shared_data) -> None:  # type: ignore[no-untyped-def]
    from uw_visibility_lab.evaluation.degrade import load_scene

    scene = load_scene(shared_data / "middlebury" / "dolls")
    truth, right = scene.disparity_left, scene.disparity_right
    height, width = truth.shape
    columns = np.arange(width) - np.round(np.nan_to_num(truth)).astype(int)
    seen = right[np.arange(height)[:, np.newaxis], np.clip(columns, 0, width - 1)]
    left = np.where((np.abs(seen - truth) <= 1) & (columns >= 0), truth, np.nan)
    left = left.astype(np.float32)
    gap = np.isnan(left) & np.isfinite(truth)
    gap[:, :80] = False
    assert gap.sum() > 1000
    linear = left.copy()
    for row in linear:
        known = np.isfinite(row)
        row[~known] = np.interp(np.flatnonzero(~known), np.flatnonzero(known), row[known])
    filled = inpaint(fill_gaps(left))
    error = np.abs(filled - truth)[gap].mean()
    assert error < 0.6 * np.abs(linear - truth)[gap].mean()
