# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Filling of disparity maps: gaps, the dominant plane, large areas."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from uw_visibility.compute.threads import Workers
from uw_visibility.errors import InputError
from uw_visibility.stereo import interpolation
from uw_visibility.stereo.interpolation import dominant_plane, fill_plane, inpaint

SHAPE = (40, 60)
NEAR, FAR = 20.0, 8.0
maps = hnp.arrays(
    np.float32, st.tuples(st.integers(1, 30), st.integers(1, 30)),
    elements=st.one_of(st.just(np.nan), st.floats(0.5, 60, width=32)),
)


def fill_gaps(
    left: np.ndarray, right: np.ndarray | None = None, max_gap: int = 40, threads: int = 1
) -> np.ndarray:
    """Fill gaps, all of which are occlusions where nothing points at them from the right."""
    pointing = np.full_like(left, np.nan) if right is None else right
    return interpolation.fill_gaps(left, pointing, max_gap, Workers(threads))


def box_before_wall() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True left map, left map with gaps, right map."""
    truth = np.full(SHAPE, FAR, np.float32)
    truth[10:30, 30:50] = NEAR
    right = np.full(SHAPE, FAR, np.float32)
    right[10:30, 10:30] = NEAR
    hidden = np.zeros(SHAPE, bool)
    hidden[10:30, 18:30] = True
    left = truth.copy()
    left[hidden] = np.nan
    left[18:22, 36:42] = np.nan
    right[:, SHAPE[1] - int(FAR):] = np.nan
    return truth, left, right


def test_occlusions_get_the_background_and_holes_in_the_foreground_stay_near() -> None:
    truth, left, right = box_before_wall()
    np.testing.assert_array_equal(fill_gaps(left, right), truth)


def test_without_the_right_map_all_gaps_count_as_occlusions() -> None:
    left = np.full(SHAPE, FAR, np.float32)
    left[:, 30:] = NEAR
    left[10:30, 22:38] = np.nan
    filled = fill_gaps(left)
    np.testing.assert_array_equal(filled[10:30, 22:38], FAR)


def test_second_lowest_is_robust_to_one_low_outlier_and_median_to_more() -> None:
    left = np.full((9, 9), 10, np.float32)
    left[4, 4] = np.nan
    left[4, 3] = 1
    assert fill_gaps(left)[4, 4] == 10
    left[3, 4] = 2
    left[5, 4] = 2
    assert fill_gaps(left)[4, 4] == 2
    pointing = np.full((9, 9), np.nan, np.float32)
    pointing[4, 0] = 4
    assert fill_gaps(left, pointing)[4, 4] == 10


@pytest.mark.parametrize("offset", [(0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1),
                                    (1, -1), (1, 1)])
def test_each_of_the_eight_directions_is_looked_along(offset: tuple[int, int]) -> None:
    left = np.full((21, 21), np.nan, np.float32)
    left[10 + 3 * offset[0], 10 + 3 * offset[1]] = 5
    # Two more, of other directions, so that three meet a disparity.
    for other in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        if other != offset:
            left[10 + 6 * other[0], 10 + 6 * other[1]] = 9
    values = fill_gaps(left, np.tile(np.float32([10] + [np.nan] * 20), (21, 1)))
    alone = left.copy()
    alone[10 + 3 * offset[0], 10 + 3 * offset[1]] = np.nan
    for other in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        alone[10 + 6 * other[0], 10 + 6 * other[1]] = np.nan
    assert np.isfinite(values[10, 10])
    two = alone.copy()
    picked = [o for o in ((-1, 0), (1, 0), (0, -1), (0, 1)) if o != offset][:2]
    for other in picked:
        two[10 + 6 * other[0], 10 + 6 * other[1]] = 9
    assert np.isnan(fill_gaps(two)[10, 10])
    two[10 + 3 * offset[0], 10 + 3 * offset[1]] = 5
    assert fill_gaps(two)[10, 10] == 9


def test_open_areas_beyond_the_reach_stay_open() -> None:
    left = np.full((40, 100), FAR, np.float32)
    left[:, 20:90] = np.nan
    filled = fill_gaps(left, max_gap=10)
    assert np.isnan(filled[:, 31:79]).all()
    assert np.isfinite(filled[20, 25])


@settings(max_examples=60, deadline=None)
@given(maps, st.integers(1, 12))
def test_matched_pixels_stay_and_gaps_take_values_that_were_seen(
    left: np.ndarray, max_gap: int
) -> None:
    filled = fill_gaps(left, None, max_gap)
    known = np.isfinite(left)
    np.testing.assert_array_equal(filled[known], left[known])
    assert np.isin(filled[np.isfinite(filled)], left[known]).all()


def test_same_bits_for_any_number_of_threads() -> None:
    random = np.random.default_rng(0)
    left = np.where(random.random(SHAPE) < 0.5, random.uniform(5, 30, SHAPE), np.nan)
    left = left.astype(np.float32)
    right = random.uniform(5, 30, SHAPE).astype(np.float32)
    np.testing.assert_array_equal(
        fill_gaps(left, right, 40, 3), fill_gaps(left, right, 40, 1))


def test_maps_of_another_shape_are_refused() -> None:
    with pytest.raises(InputError, match="shape"):
        fill_gaps(np.zeros(SHAPE, np.float32), np.zeros((3, 4), np.float32))


def points_on_a_plane(count: int, outliers: int, noise: float = 0.0) -> np.ndarray:
    random = np.random.default_rng(1)
    x, y = random.uniform(0, 640, count), random.uniform(0, 480, count)
    d = 10 + 0.03 * x + 0.08 * y + random.normal(0, noise, count)
    d[:outliers] = random.uniform(0, 100, outliers)
    return np.column_stack([x, y, d])


@pytest.mark.parametrize("count", [3, 200, 5000])
def test_plane_is_recovered_exactly(count: int) -> None:
    plane = dominant_plane(points_on_a_plane(count, 0))
    assert plane is not None
    assert plane == pytest.approx([0.03, 0.08, 10])


def test_plane_survives_more_outliers_than_inliers_and_is_repeatable() -> None:
    points = points_on_a_plane(600, 380, noise=0.2)
    plane = dominant_plane(points)
    assert plane is not None
    np.testing.assert_array_equal(plane, dominant_plane(points))
    y, x = np.mgrid[:480, :640]
    found = plane[0] * x + plane[1] * y + plane[2]
    assert np.abs(found - (10 + 0.03 * x + 0.08 * y)).max() < 0.4


@pytest.mark.parametrize(
    "points",
    [np.empty((0, 3)), np.ones((2, 3)), np.column_stack([np.arange(9.0)] * 3),
     np.full((9, 3), np.nan)],
)
def test_no_plane_through_too_little(points: np.ndarray) -> None:
    assert dominant_plane(points) is None


def test_plane_fills_a_thin_mesh_up_to_the_horizon_and_leaves_a_good_one() -> None:
    y, x = np.mgrid[:100, :80]
    exact = (-4 + 0.2 * y + 0.01 * x).astype(np.float32)
    mesh = np.full((100, 80), np.nan, np.float32)
    mesh[60:90, 20:60] = exact[60:90, 20:60] + np.float32(0.5)
    points = np.column_stack([x[60:, ::7].ravel(), y[60:, ::7].ravel(), exact[60:, ::7].ravel()])
    filled = fill_plane(mesh, points)
    np.testing.assert_array_equal(filled[60:90, 20:60], mesh[60:90, 20:60])
    assert np.isnan(filled[exact <= -0.01]).all()
    away = (exact > 0.01) & np.isnan(mesh)
    np.testing.assert_allclose(filled[away], exact[away], atol=1e-3)
    mesh[:60] = 1.0
    np.testing.assert_array_equal(fill_plane(mesh, points), mesh)


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
    filled = inpaint(fill_gaps(left, right))
    error = np.abs(filled - truth)[gap].mean()
    assert error < 0.6 * np.abs(linear - truth)[gap].mean()
