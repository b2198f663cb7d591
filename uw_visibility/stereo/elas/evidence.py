# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Noise test of matches: remove regions whose matches are no better than noise.

In water without texture the descriptors contain only noise and the vertical gradient of the veil,
which is the same along a row. The prior still makes both views agree on a disparity there, so that
a false obstacle appears in open water. But there the two views differ as much as two places of a
row, while on a textured surface they differ less. The measure is the ratio of two sums over a
neighbourhood: differences between the views, over differences along the row (texture). Flat patches
of a surface pass because of the texture around them.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array, DisparityMap, Map
from uw_visibility.stereo.elas.descriptors import BYTES, absolute_difference

# Side of the cells of the sums, px, and sides of the neighbourhoods, cells.
CELL = 8
_NEIGHBOURHOOD = 5
_SIGNAL_NEIGHBOURHOOD = 3
# Texture is the difference of descriptors this far apart along a row, px, in the left and in the
# right view; no fine pattern repeats at both distances. A vertical gradient of the veil has none.
_APART = (7, 11)
# Two independent descriptors differ √2 times as much as either does from a blank one.
_FROM_BLANK = np.float32(math.sqrt(0.5))
# Least texture over that of noise alone, which is known to a fifth or so.
_SIGNAL = 1.5
# Mean absolute value of a standard normal deviate.
MEAN_OF_NORMAL = math.sqrt(2.0 / math.pi)


def remove_noise(
    descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]], disparity: DisparityMap,
    noise: Array, most: float, workers: Workers,
) -> None:
    """Set matches that are no better than noise to NaN, in place.

    `noise` is the standard deviation of gradient responses to noise in each cell, 0 where it is
    unknown. `most` limits the sum of differences over the sum of textures around a match; noise
    has about 1.1, a clear surface 0.2 to 0.6.
    """
    height, width = disparity.shape
    sums = np.zeros((3, -(-height // CELL), -(-width // CELL)), np.float32)
    workers.rows(_sum_up, sums.shape[1], *descriptors, disparity, *sums)
    difference, texture = (_around(each, _NEIGHBOURHOOD) for each in sums[:2])
    noisy = difference >= np.float32(most) * texture
    # Smoothed noise matches by chance, so gradients must be stronger than those of noise.
    texture, count = (_around(each, _SIGNAL_NEIGHBOURHOOD) for each in sums[1:])
    noisy |= texture < (_SIGNAL * MEAN_OF_NORMAL * BYTES) * noise * count
    pixels = noisy.repeat(CELL, axis=0).repeat(CELL, axis=1)
    disparity[pixels[:height, :width]] = np.nan


def _around(cells: Map, side: int) -> Map:
    """Mean over the cells around each; cells beyond the border are 0."""
    return np.asarray(cv2.blur(cells, (side, side), borderType=cv2.BORDER_CONSTANT))


@njit(nogil=True)
def _sum_up(
    start: int, stop: int, left: Any, right: Any, disparity: Any, difference: Any,
    texture: Any, count: Any,
) -> None:
    """Sum over every other matched pixel of each cell."""
    height, width = disparity.shape
    for row in range(start, stop):
        for y in range(row * CELL, min((row + 1) * CELL, height)):
            for x in range(y & 1, width, 2):
                d = disparity[y, x]
                if d != d:
                    continue
                other = x - index_of(d + np.float32(0.5), 0, x)
                i, j = (y * width + x) * BYTES, (y * width + other) * BYTES
                column = x // CELL
                count[row, column] += 1
                difference[row, column] += absolute_difference(left, i, right, j)
                texture[row, column] += np.float32(0.5) * _FROM_BLANK * (
                    absolute_difference(left, i, left, i + _step(x, width, _APART[0]))
                    + absolute_difference(right, j, right, j + _step(other, width, _APART[1]))
                )


@njit(nogil=True, inline="always")
def _step(x: Any, width: int, apart: int) -> int:
    """Bytes to the descriptor `apart` pixels to the right, or to the left at the border."""
    return BYTES * (apart if x + apart < width else -min(apart, x))
