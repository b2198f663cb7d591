# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Matting: closed forms, holes, edges."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.matting import refine

SHAPE = (96, 130)


def textured(seed: int = 0, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*shape, 3)).astype(np.uint8)


def two_surfaces() -> tuple[np.ndarray, np.ndarray]:
    """A bright near disc (40 px) before a dark far wall (10 px)."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    near = (x - 65) ** 2 + (y - 48) ** 2 < 30**2
    truth = np.where(near, 40, 10).astype(np.float32)
    image = np.where(near[..., np.newaxis], (230, 140, 90), (40, 60, 70))
    noise = np.random.default_rng(1).normal(0, 3, image.shape)
    return truth, np.clip(image + noise, 0, 255).astype(np.uint8)


def test_constant_is_kept_exactly_between_single_points() -> None:
    coarse = np.full(SHAPE, np.nan, np.float32)
    coarse[::7, ::9] = 23.5
    matte = refine(coarse, textured())
    np.testing.assert_array_equal(matte, np.float32(23.5))


def test_plane_is_kept_whatever_the_image() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    plane = (20 + 0.11 * x - 0.07 * y).astype(np.float32)
    matte = refine(plane, textured())
    np.testing.assert_allclose(matte, plane, atol=0.02)


def test_plane_continues_into_a_hole_of_half_the_image() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    plane = (20 + 0.11 * x - 0.07 * y).astype(np.float32)
    coarse = plane.copy()
    coarse[:, 40:105] = np.nan
    matte = refine(coarse, np.full((*SHAPE, 3), 90, np.uint8))
    np.testing.assert_allclose(matte, plane, atol=0.1)


def test_linear_function_of_the_guide_is_found() -> None:
    guide = np.repeat(np.repeat(textured(2, (12, 17)), 8, axis=0), 8, axis=1)[:96, :130]
    truth = (10 + guide @ np.array([0.0299, 0.0587, 0.0114])).astype(np.float32)
    coarse = np.where(np.random.default_rng(3).random(SHAPE) < 0.3, truth, np.nan)
    matte = refine(
        coarse.astype(np.float32), guide, EnhancementConfig(matting_smoothness=1e-7))
    assert np.abs(matte - truth).mean() < 0.4 * truth.std() * 0.1


def test_edges_follow_the_image_better_than_a_nearest_or_linear_fill() -> None:
    from scipy.interpolate import griddata

    truth, image = two_surfaces()
    rows, columns = np.mgrid[2:96:9, 3:130:9]
    points = np.column_stack([columns.ravel(), rows.ravel()])
    grid = tuple(np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0])))
    values = truth[rows, columns].ravel()
    linear = griddata(points, values, grid, "linear").astype(np.float32)
    nearest = griddata(points, values, grid, "nearest").astype(np.float32)
    matte = refine(linear, image)
    error = np.abs(matte - truth).mean()
    assert error < 0.5 * np.nanmean(np.abs(linear - truth))
    assert error < 0.7 * np.abs(nearest - truth).mean()


def test_nothing_to_start_from_is_said() -> None:
    matte = refine(np.full(SHAPE, np.nan, np.float32), textured())
    assert np.isnan(matte).all()


@settings(max_examples=30, deadline=None)
@given(
    hnp.arrays(
        np.float32, st.tuples(st.integers(1, 40), st.integers(1, 40)),
        elements=st.one_of(st.just(np.nan), st.floats(0.5, 300, width=32)),
    ),
    st.booleans(),
)
def test_any_data_give_a_finite_map_within_their_extremes(coarse: np.ndarray, grey: bool) -> None:
    guide = textured(4, coarse.shape)
    matte = refine(coarse, guide[..., 0] if grey else guide)
    if np.isfinite(coarse).any():
        assert np.isfinite(matte).all()
        assert matte.min() >= np.nanmin(coarse)
        assert matte.max() <= np.nanmax(coarse)
    else:
        assert np.isnan(matte).all()


def test_sixteen_bit_guide_gives_what_eight_bit_gives() -> None:
    truth, image = two_surfaces()
    coarse = np.where(np.random.default_rng(6).random(SHAPE) < 0.05, truth, np.nan)
    coarse = coarse.astype(np.float32)
    eight = refine(coarse, image)
    sixteen = refine(coarse, image.astype(np.uint16) * 257)
    np.testing.assert_allclose(sixteen, eight, atol=1e-2)


def test_depth_edge_that_the_image_does_not_show_stays_narrow() -> None:
    coarse = np.full(SHAPE, 10, np.float32)
    coarse[:, 64:] = 40
    matte = refine(
        coarse, np.full((*SHAPE, 3), 90, np.uint8), EnhancementConfig(matting_radius=8))
    wrong = np.abs(matte[48] - coarse[48]) > 1
    # 30 px where all windows weigh the same.
    assert wrong.sum() <= 26
