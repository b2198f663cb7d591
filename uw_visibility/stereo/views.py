# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Warping of the left view's disparity map to the right view."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.stereo.elas.postprocess import columns_in_right
from uw_visibility.stereo.interpolation import fill_from_farther


def in_right_view(disparity: DisparityMap, workers: Workers | None = None) -> NDArray[np.float32]:
    """Warp a disparity map (H, W) without holes to the right view.

    Where two surfaces fall on one pixel, the nearer one is kept. Pixels that only the right camera
    sees belong to the background and take the farther of their two neighbours in the row. NaN is
    ignored; rows without any match are NaN.
    """
    warped = np.empty_like(disparity)
    (workers or Workers(1)).rows(_warp, disparity.shape[0], disparity, warped)
    return warped


@njit(nogil=True, error_model="numpy")
def _warp(start: int, stop: int, disparity: Any, warped: Any) -> None:
    width = disparity.shape[1]
    nothing = np.float32(-np.inf)
    # Largest disparity at each pixel of the right row; the first entry is for pixels outside of it.
    nearest = np.empty(width + 1, np.float32)
    column = np.empty(width, np.int32)
    for y in range(start, stop):
        row = disparity[y]
        columns_in_right(row, column)
        nearest[:] = nothing
        for x in range(width):
            at = np.uint32(column[x] + 1)
            nearest[at] = max(nearest[at], row[x])
        fill_from_farther(nearest[1:], width, warped[y])
