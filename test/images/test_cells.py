# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Cells of pixels, against their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.images.cells import fold, spread


@pytest.mark.parametrize("shape", [(8, 12), (7, 10), (3, 2), (7, 10, 3)])
@pytest.mark.parametrize("how", [np.add, np.maximum])
def test_cells_hold_what_is_in_them(shape: tuple[int, ...], how: np.ufunc) -> None:
    values = np.random.default_rng(0).random(shape)
    nothing = 0.0 if how is np.add else -np.inf
    found = fold(values, 4, nothing, how)
    assert found.shape == (-(-shape[0] // 4), -(-shape[1] // 4), *shape[2:])
    for i, j in np.ndindex(*found.shape[:2]):
        cell = values[4 * i : 4 * i + 4, 4 * j : 4 * j + 4]
        np.testing.assert_allclose(found[i, j], how.reduce(cell, axis=(0, 1)))


def test_without_a_value_for_it_the_border_goes_on() -> None:
    np.testing.assert_array_equal(fold(np.full((5, 6), 2.0), 4), np.full((2, 2), 32.0))


def test_means_of_a_slope_come_back_as_the_slope() -> None:
    slope = np.add.outer(np.arange(8.0), 2.0 * np.arange(12.0))
    pixels = spread(fold(slope, 4) / 16.0, 4, (7, 10))
    assert pixels.shape == (7, 10)
    np.testing.assert_allclose(pixels[2:6, 2:10], slope[2:6, 2:10])
