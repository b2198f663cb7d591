# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Radiometric gain of the right camera over the left one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Image, Points
from uw_visibility.optics.transfer import linear_table

# Largest number of points that are used; more are not more precise.
_MOST_POINTS = 400
# Least number of points for a channel's gain.
_FEWEST_POINTS = 30
# Half side of the square over which pixels are averaged, px.
_REACH = 2
# Least irradiance: ratios of darker pixels depend on the cameras' black levels.
_DARK = 0.02


def right_gain(left: Image, right: Image, points: Points, transfer: str) -> Array:
    """Estimate the gain of the right camera over the left one.

    left, right: (H, W, 3) or (H, W) of uint8 or uint16, the pair; a small copy of a noisy view has
        16 bits, that of the other may have 8.
    points: (N, 3) float32, column and row in the left image, and disparity, px.
    transfer: ``"linear"`` or ``"srgb"``.
    Returns (3,) or (1,) float64, median of the points' ratio of irradiances; 1 for a channel with
    too few usable points.
    """
    stride = -(-len(points) // _MOST_POINTS) or 1
    chosen = points[::stride]
    height, width = left.shape[:2]
    u, v = chosen[:, 0].astype(np.int64), chosen[:, 1].astype(np.int64)
    partner = chosen[:, 0] - chosen[:, 2]
    first = np.floor(partner).astype(np.int64)
    inside = (v >= _REACH) & (v < height - _REACH) & (u >= _REACH) & (u < width - _REACH)
    inside &= (first >= _REACH) & (first < width - _REACH - 1)
    u, v, first, partner = u[inside], v[inside], first[inside], partner[inside]
    here, clipped = _patch_means(left, u, v, transfer)
    near, clipped_near = _patch_means(right, first, v, transfer)
    next_to, clipped_next = _patch_means(right, first + 1, v, transfer)
    part = (partner - first)[:, np.newaxis]
    there = (1.0 - part) * near + part * next_to
    usable = (here > _DARK) & (there > _DARK) & ~(clipped | clipped_near | clipped_next)
    gain = np.ones(here.shape[1])
    for channel in range(gain.size):
        chosen_here = usable[:, channel]
        if np.count_nonzero(chosen_here) >= _FEWEST_POINTS:
            ratio = there[chosen_here, channel] / here[chosen_here, channel]
            gain[channel] = np.median(ratio)
    return gain


def _patch_means(
    image: Image, u: NDArray[np.int64], v: NDArray[np.int64], transfer: str
) -> tuple[Array, NDArray[np.bool_]]:
    """Return mean irradiance around each point, and whether a pixel there is saturated."""
    table = linear_table(transfer, image.dtype)
    planes = image[..., np.newaxis] if image.ndim == 2 else image
    y, x = np.mgrid[-_REACH : _REACH + 1, -_REACH : _REACH + 1].reshape(2, -1)
    codes = planes[v[:, np.newaxis] + y, u[:, np.newaxis] + x]
    return table[codes].mean(axis=1, dtype=np.float64), (codes == table.size - 1).any(axis=1)
