# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Adaptive mean of a disparity map: the last step of ELAS."""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap


class AdaptiveMean:
    """Mean over neighbours of the same surface, in memory that is allocated once.

    A neighbour's weight falls linearly with the difference of the disparities
    and is zero from `difference` on, so that depth edges stay. Rows first, then
    columns.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    difference : float
        px.
    """

    def __init__(self, shape: tuple[int, int], difference: float) -> None:
        self._difference = np.float32(difference)
        self._between = np.empty(shape, np.float32)

    def smooth(self, disparity: DisparityMap, radius: int, workers: Workers) -> None:
        """Smooth a map ``(H, W)`` float32 in place; NaN stays NaN.

        ``radius`` is that of the neighbours to each side; 0 leaves the map as it is.
        """
        if radius == 0:
            return
        height = disparity.shape[0]
        for kernel, source, target in (
            (_along_rows, disparity, self._between),
            (_along_columns, self._between, disparity),
        ):
            workers.rows(kernel, height, source, radius, self._difference, target)


@njit(nogil=True, error_model="numpy")
def _add_both(
    first: int, last: int, shift: int, here: Any, before: Any, after: Any, difference: Any,
    weights: Any, sums: Any,
) -> None:
    """Add the neighbours on both sides of each pixel of a row; what is NaN adds nothing."""
    for x in range(first, last):
        # Unsigned, since numba looks whether other indices are below zero.
        at = np.uint64(x)
        d = here[at]
        step = before[np.uint64(x - shift)] - d
        weight = _weight(step, difference)
        total = weights[at] + weight
        weighted = sums[at] + (weight * step if weight > 0 else np.float32(0))
        step = after[np.uint64(x + shift)] - d
        weight = _weight(step, difference)
        weights[at] = total + weight
        sums[at] = weighted + (weight * step if weight > 0 else np.float32(0))


@njit(nogil=True, error_model="numpy")
def _weight(step: Any, difference: Any) -> Any:
    weight = difference - abs(step)
    return weight if weight > 0 else np.float32(0)


@njit(nogil=True, error_model="numpy")
def _along_rows(
    start: int, stop: int, source: Any, radius: int, difference: Any, target: Any
) -> None:
    width = source.shape[1]
    weights = np.empty(width, np.float32)
    sums = np.empty(width, np.float32)
    for y in range(start, stop):
        weights[:] = 0
        sums[:] = 0
        row = source[y]
        # At the image's border neighbours of one side would draw a slope's mean to it.
        for k in range(1, min(radius, (width - 1) // 2) + 1):
            _add_both(k, width - k, k, row, row, row, difference, weights, sums)
        # The pixel itself adds to the weights only.
        for x in range(width):
            target[y, x] = row[x] + sums[x] / (weights[x] + difference)


@njit(nogil=True, error_model="numpy")
def _along_columns(
    start: int, stop: int, source: Any, radius: int, difference: Any, target: Any
) -> None:
    height, width = source.shape
    weights = np.empty(width, np.float32)
    sums = np.empty(width, np.float32)
    for y in range(start, stop):
        weights[:] = 0
        sums[:] = 0
        row = source[y]
        for k in range(1, min(radius, y, height - 1 - y) + 1):
            _add_both(0, width, 0, row, source[y - k], source[y + k], difference, weights, sums)
        for x in range(width):
            target[y, x] = row[x] + sums[x] / (weights[x] + difference)
