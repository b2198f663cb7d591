# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Disparity interpolation: gaps from the background, large areas by inpainting."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.images.cells import fold, spread


def fill_gaps(
    disparity: DisparityMap, max_gap: int, workers: Workers
) -> NDArray[np.float32]:
    """Fill gaps within rows from the background, since most gaps are occlusions.

    Each gap takes the farther of its two sides in the row, as occlusions in Hirschmüller 2008,
    section 2.6.3, unless it is wider than twice `max_gap`, px.

    disparity: (H, W) float32, px; NaN = a gap.
    Returns (H, W) float32, a new map; NaN stays in wider gaps.
    """
    filled = np.empty_like(disparity)
    workers.rows(_fill_rows, disparity.shape[0], disparity, 2 * max_gap, filled)
    return filled


@njit(nogil=True, error_model="numpy")
def _fill_rows(start: int, stop: int, disparity: Any, widest: int, filled: Any) -> None:
    for y in range(start, stop):
        fill_from_farther(disparity[y], widest, filled[y])


@njit(nogil=True, error_model="numpy")
def fill_from_farther(row: Any, widest: int, filled: Any) -> None:
    """Copy a row and fill its gaps, NaN or -inf, with the farther of their two sides.

    At the border there is one side only. Gaps of more than `widest` px become NaN.
    """
    width = row.size
    nothing = np.float32(-np.inf)
    last = nothing
    x = 0
    while x < width:
        if row[x] > nothing:
            last = row[x]
            filled[x] = last
            x += 1
            continue
        end = x
        while end < width and not row[end] > nothing:
            end += 1
        after = row[end] if end < width else nothing
        value = min(last, after)
        if value == nothing:
            value = max(last, after)
        filled[x:end] = value if value != nothing and end - x <= widest else np.float32(np.nan)
        x = end


# Side of the cells of the grid on which large areas are inpainted, px.
CELL = 8
# Radius of the inpainting's neighbourhood, cells.
REACH = 3.0


def inpaint(disparity: DisparityMap) -> NDArray[np.float32]:
    """Fill all unknown pixels by inpainting (Bertalmio et al., doi 10.1109/CVPR.2001.990497).

    A coarse grid of cells is inpainted: the holes are large, without detail to restore. OpenCV's
    other method, by Telea, does not even continue a constant into a hole, and differs between
    versions of OpenCV.

    Returns a new map: known pixels are unchanged, the others lie within the limits of the known
    ones; all are NaN if none is known.
    """
    known = np.isfinite(disparity)
    count = fold(known.astype(np.float32), CELL, 0.0)
    holes = count == 0
    if holes.all():
        return disparity.copy()
    low, high = disparity[known].min(), disparity[known].max()
    total = fold(np.where(known, disparity, np.float32(0)), CELL, 0.0)
    small = np.where(holes, low, total / np.maximum(count, np.float32(1)))
    if holes.any():
        small = cv2.inpaint(small, holes.astype(np.uint8), REACH, cv2.INPAINT_NS)
        # OpenCV may divide 0 by 0 beside single known cells.
        small[~np.isfinite(small)] = low
    return np.where(
        known, disparity, np.clip(spread(small, CELL, disparity.shape), low, high))
