# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Warping of the left view's disparity map to the right view."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers


def in_right_view(
    disparity: NDArray[np.float32], workers: Workers | None = None
) -> NDArray[np.float32]:
    """Warp a disparity map without holes to the right view.

    Of two surfaces at one pixel the nearer is seen. What only the right camera
    sees lies behind, and takes the farther of its two neighbours in the row.

    Parameters
    ----------
    disparity : ndarray
        ``(H, W)`` float32, left-referenced, px; NaN is passed over.
    workers : Workers, optional
        Threads; one by default.

    Returns
    -------
    ndarray
        ``(H, W)`` float32, disparity at the right view's pixels, px; NaN in rows
        that nothing falls into.
    """
    warped = np.empty_like(disparity)
    (workers or Workers(1)).rows(_warp, disparity.shape[0], disparity, warped)
    return warped


@njit(nogil=True)
def _warp(start: int, stop: int, disparity: Any, warped: Any) -> None:
    width = disparity.shape[1]
    nothing = np.float32(-np.inf)
    for y in range(start, stop):
        row = warped[y]
        row[:] = nothing
        for x in range(width):
            d = disparity[y, x]
            other = x - d
            if other > -0.5 and other < width - 0.5:
                at = np.int32(other + np.float32(0.5))
                row[at] = max(row[at], d)
        last = nothing
        x = 0
        while x < width:
            if row[x] != nothing:
                last = row[x]
                x += 1
                continue
            end = x
            while end < width and row[end] == nothing:
                end += 1
            after = row[end] if end < width else nothing
            value = min(last, after)
            if value == nothing:
                value = max(last, after)
            row[x:end] = value if value != nothing else np.float32(np.nan)
            x = end
