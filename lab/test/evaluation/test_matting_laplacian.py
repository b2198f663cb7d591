# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The matting Laplacian: closed forms, edges."""

import numpy as np

from uw_visibility.config.schema import EnhancementConfig
from uw_visibility_lab.evaluation.matting_laplacian import laplacian, refine_by_laplacian

SHAPE = (96, 130)
CONFIG = EnhancementConfig()


def textured(seed: int = 0, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*shape, 3)).astype(np.uint8)


def test_constant_is_kept_between_single_points() -> None:
    coarse = np.full(SHAPE, np.nan, np.float32)
    coarse[::7, ::9] = 23.5
    refined = refine_by_laplacian(coarse, textured(), CONFIG)
    np.testing.assert_array_equal(refined, np.float32(23.5))


def test_edges_follow_the_image() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    near = (x - 65) ** 2 + (y - 48) ** 2 < 30**2
    truth = np.where(near, 40, 10).astype(np.float32)
    image = np.where(near[..., np.newaxis], (180, 90, 40), (60, 110, 130))
    noise = np.random.default_rng(1).normal(0, 3, image.shape)
    image = np.clip(image + noise, 0, 255).astype(np.uint8)
    coarse = np.full(SHAPE, np.nan, np.float32)
    coarse[2::9, 3::9] = truth[2::9, 3::9]
    nearest = np.repeat(np.repeat(coarse[2::9, 3::9], 9, 0), 9, 1)[: SHAPE[0], : SHAPE[1]]
    wrong = np.abs(refine_by_laplacian(coarse, image, CONFIG) - truth)[:-6, :-4]
    assert wrong.mean() < 0.7 * np.abs(nearest - truth[: nearest.shape[0]])[:-6, :-4].mean()


def test_without_data_there_is_no_map() -> None:
    refined = refine_by_laplacian(np.full(SHAPE, np.nan, np.float32), textured(), CONFIG)
    assert np.isnan(refined).all()


def test_laplacian_is_symmetric_semidefinite_and_blind_to_constants() -> None:
    guide = textured(7, (6, 7)).astype(np.float32) / 255
    matrix = laplacian(guide, 1e-3).toarray()
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    np.testing.assert_allclose(matrix.sum(axis=1), 0, atol=1e-10)
    assert np.linalg.eigvalsh(matrix).min() > -1e-10


def test_laplacian_is_nearly_blind_to_linear_functions_of_colour() -> None:
    guide = textured(8, (8, 9)).astype(np.float32) / 255
    matrix = laplacian(guide, 1e-6)
    seen = (guide @ np.array([1.0, -2.0, 0.5])).ravel()
    unseen = np.random.default_rng(9).normal(0, seen.std(), seen.size)
    assert seen @ (matrix @ seen) < 1e-3 * (unseen @ (matrix @ unseen))
