# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The pixels of outgoing messages, against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from uw_visibility.messages.pixels import (
    DISPARITY_STEP,
    cloud_of,
    depth_of,
    published_disparity,
)

SHAPE = (4, 7)
DISPARITIES = arrays(
    np.float32, SHAPE,
    elements=st.one_of(st.just(float("nan")), st.floats(-20, 200, width=32)),
)
MASKS = arrays(np.bool_, SHAPE)


@given(DISPARITIES, st.none() | MASKS, st.floats(-5, 5), st.floats(0, 50), st.floats(0, 100))
def test_published_disparity_is_rounded_and_within_its_limits(
    disparity: np.ndarray, valid: np.ndarray | None, offset: float, low: float, extent: float
) -> None:
    high = low + extent
    published = published_disparity(disparity, valid, offset, low, high)
    limits = np.float32([low, high])
    steps = np.rint((disparity - np.float32(offset)) / np.float32(DISPARITY_STEP))
    rounded = (steps * DISPARITY_STEP).astype(np.float32)
    kept = (rounded > 0) & (rounded >= limits[0]) & (rounded <= limits[1])
    if valid is not None:
        kept &= valid
    np.testing.assert_array_equal(published, np.where(kept, rounded, limits[0] - 1))


@given(DISPARITIES, st.floats(0, 50), st.floats(1, 1000))
def test_depth_is_that_of_the_published_disparity(
    disparity: np.ndarray, low: float, scale: float
) -> None:
    published = published_disparity(disparity, None, 0.0, low, 150.0)
    depth = depth_of(published, low, scale)
    kept = published >= np.float32(low)
    assert np.isnan(depth[~kept]).all()
    np.testing.assert_allclose(depth[kept] * published[kept], scale, rtol=1e-6)


@pytest.mark.parametrize(("dtype", "channels"), [
    (np.uint8, 3), (np.uint16, 3), (np.uint8, 1), (np.uint16, 1),
])
def test_cloud_has_each_pixel_s_place_and_colour(dtype: type, channels: int) -> None:
    generator = np.random.default_rng(3)
    depth = generator.uniform(1, 9, SHAPE).astype(np.float32)
    depth[0, 0] = np.nan
    columns, rows = (generator.normal(size=n).astype(np.float32) for n in reversed(SHAPE))
    shape = SHAPE if channels == 1 else (*SHAPE, channels)
    colours = generator.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)
    cloud = cloud_of(depth, columns, rows, colours)
    np.testing.assert_array_equal(cloud[..., 0], depth * columns)
    np.testing.assert_array_equal(cloud[..., 1], depth * rows[:, None])
    np.testing.assert_array_equal(cloud[..., 2], depth)
    rgb = colours.reshape(*SHAPE, channels) >> (8 * np.dtype(dtype).itemsize - 8)
    red, green, blue = np.moveaxis(np.broadcast_to(rgb, (*SHAPE, 3)).astype(np.uint32), -1, 0)
    packed = np.ascontiguousarray(cloud[..., 3]).view(np.uint32)
    np.testing.assert_array_equal(packed, red << 16 | green << 8 | blue)
