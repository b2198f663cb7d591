# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Disparity interpolation: large areas, by inpainting (section II-E)."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap

# Pixels per cell of the grid that large areas are inpainted on.
CELL = 8
# Radius (cells) that the inpainting takes values from.
REACH = 3.0


def inpaint(disparity: DisparityMap, workers: Workers | None = None) -> NDArray[np.float32]:
    """Inpainting of all that is open (Bertalmio et al., doi 10.1109/CVPR.2001.990497).

    Done on a coarse grid of cells: what is left at this stage is large and has
    no detail to restore. OpenCV's other method, Telea's, does not even carry a
    constant into a hole, and differs between its versions.

    Parameters
    ----------
    disparity : (H, W) float32 ndarray
        px; NaN = open.
    workers : Workers, optional
        Threads; one by default.

    Returns
    -------
    (H, W) float32 ndarray
        A new map: known pixels unchanged, the others within the extremes of
        those known. NaN everywhere if none is known.
    """
    workers = workers or Workers(1)
    height, width = disparity.shape
    small = np.empty((-(-height // CELL), -(-width // CELL)), np.float32)
    workers.rows(_average_cells, small.shape[0], disparity, small)
    holes = np.isnan(small)
    if holes.all():
        return disparity.copy()
    low, high = float(np.nanmin(disparity)), float(np.nanmax(disparity))
    if holes.any():
        small[holes] = low
        small = cv2.inpaint(small, holes.astype(np.uint8), REACH, cv2.INPAINT_NS)
        # Beside single known cells OpenCV may divide nothing by nothing.
        small[~np.isfinite(small)] = low
    filled = np.empty_like(disparity)
    workers.rows(_fill_open, height, disparity, small, np.float32(low), np.float32(high), filled)
    return filled


@njit(nogil=True, error_model="numpy")
def _average_cells(start: int, stop: int, disparity: Any, small: Any) -> None:
    """Average the known pixels of each cell; NaN where there is none."""
    height, width = disparity.shape
    for i in range(start, stop):
        for j in range(small.shape[1]):
            total = np.float32(0)
            count = np.float32(0)
            for y in range(i * CELL, min((i + 1) * CELL, height)):
                for x in range(j * CELL, min((j + 1) * CELL, width)):
                    d = disparity[y, x]
                    if not np.isnan(d):
                        total += d
                        count += 1
            small[i, j] = total / count if count > 0 else np.float32(np.nan)


@njit(nogil=True, error_model="numpy")
def _fill_open(
    start: int, stop: int, disparity: Any, small: Any, low: Any, high: Any, filled: Any
) -> None:
    """Interpolate open pixels bilinearly between cell centres."""
    last_row = small.shape[0] - 1
    last_column = small.shape[1] - 1
    half = np.float32(0.5)
    zero = np.float32(0)
    step = np.float32(1 / CELL)
    for y in range(start, stop):
        v = min(max((np.float32(y) + half) * step - half, zero), np.float32(last_row))
        i = int(v)
        below = min(i + 1, last_row)
        t = v - np.float32(i)
        for x in range(disparity.shape[1]):
            d = disparity[y, x]
            if np.isnan(d):
                u = min(max((np.float32(x) + half) * step - half, zero), np.float32(last_column))
                j = int(u)
                after = min(j + 1, last_column)
                s = u - np.float32(j)
                upper = small[i, j] + s * (small[i, after] - small[i, j])
                lower = small[below, j] + s * (small[below, after] - small[below, j])
                d = min(max(upper + t * (lower - upper), low), high)
            filled[y, x] = d
