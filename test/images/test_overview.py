# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Overview of a frame: three pictures in a row."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.images.overview import overview, viridis


@pytest.mark.parametrize("dtype, top", [(np.uint8, 1), (np.uint16, 256)])
@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3)])
def test_it_shows_before_after_and_what_matched(
    shape: tuple[int, ...], dtype: type, top: int
) -> None:
    before, after = np.full(shape, 50 * top, dtype), np.full(shape, 200 * top, dtype)
    disparity = np.tile(np.linspace(5.0, 9.0, 30, dtype=np.float32), (20, 1))
    disparity[:4] = np.nan
    shown = overview(before, after, disparity)
    assert (shown.shape, shown.dtype) == ((20, 90, 3), np.uint8)
    assert (shown[:, :30] == 50).all()
    assert (shown[:, 30:60] == 200).all()
    drawn = shown[:, 60:].astype(int)
    assert (drawn[:4] == 0).all()
    # Far is dark and near is light, over all that the colours have.
    lightness = drawn[10].sum(axis=1)
    assert lightness[0] == viridis(np.zeros((1, 1))).astype(int).sum()
    assert lightness[-1] == viridis(np.ones((1, 1))).astype(int).sum()
    assert lightness[-1] > lightness[15] > lightness[0]


def test_where_nothing_matched_it_is_black() -> None:
    image = np.full((8, 9, 3), 7, np.uint8)
    assert (overview(image, image, np.full((8, 9), np.nan, np.float32))[:, 18:] == 0).all()
