# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Grain: the part of an image's deviations from smooth light that noise accounts for.

By the local statistics of Lee (1980, doi 10.1109/TPAMI.1980.4766994) on cells: of the variance in
a cell, the part that noise has is grain, the rest is detail. What restoration adds to a picture it
adds without grain, so that flat areas keep the noise of the camera and no more.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array
from uw_visibility.images.noise import ROUNDING_VARIANCE

# Pixels per cell, in either direction: of 4 and 8, with which traced scenes have less noise
# (`judge --pictures`).
CELL = 4


class Grain(NamedTuple):
    """Smooth image and part of the deviation from it that is grain, at the cells' middles.

    `mean` is (C, H / 4, W / 4) float32, code values; `share` has the same shape and is that part
    times the irradiance of a code value.
    """

    mean: NDArray[np.float32]
    share: NDArray[np.float32]


def find_grain(
    planes: NDArray[np.generic], noise: Array, decode: NDArray[np.float32], workers: Workers
) -> Grain:
    """Find the grain of an image.

    planes: (H, W, C) of uint8 or uint16, code values.
    noise: (C,) float64, standard deviation of the noise, code values; rounding is added to it.
    decode: irradiance of each code value.
    """
    height, width, count = planes.shape
    shape = count, max(height // CELL, 1), max(width // CELL, 1)
    mean, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
    workers.rows(_means, shape[1], planes, mean)
    workers.rows(_variances, shape[1], planes, mean, variance)
    expected = (noise**2 + ROUNDING_VARIANCE).astype(np.float32)
    share = np.empty(shape, np.float32)
    for c in range(count):
        # A cell alone scatters; beside an edge, or on one, the larger variance is that of detail.
        around = cv2.blur(variance[c], (3, 3), borderType=cv2.BORDER_REPLICATE)
        larger = np.maximum(np.maximum(around, variance[c]), expected[c])
        share[c] = expected[c] / larger
        code = np.clip(mean[c].astype(np.intp), 1, decode.size - 1)
        share[c] *= decode[code] - decode[code - 1]
    return Grain(mean, share)


@njit(nogil=True, error_model="numpy")
def between(row: int, size: int) -> tuple[int, int, Any]:
    """Cells on both sides of a pixel along an axis, and the part of the second one."""
    place = min(max(row - (CELL - 1) / 2, 0.0) / CELL, size - 1.0)
    first = index_of(place, 0, size - 1)
    return first, min(first + 1, size - 1), np.float32(place - first)


@njit(nogil=True, error_model="numpy")
def spread_row(cells: Any, y: int, column: Any, out: Any) -> None:
    """Interpolate one plane of cells to a row of pixels; `column` is a buffer of a row of cells."""
    above, below, part = between(y, cells.shape[0])
    for j in range(column.size):
        column[j] = cells[above, j] + part * (cells[below, j] - cells[above, j])
    half = CELL // 2
    last = column.size - 1
    for x in range(min(half, out.size)):
        out[x] = column[0]
    for j in range(last):
        value = column[j]
        step = (column[j + 1] - value) * np.float32(1.0 / CELL)
        left = half + j * CELL
        value += np.float32(0.5) * step
        for x in range(CELL):
            out[left + x] = value + np.float32(x) * step
    for x in range(half + last * CELL, out.size):
        out[x] = column[last]


@njit(nogil=True, error_model="numpy")
def _means(start: int, stop: int, image: Any, mean: Any) -> None:
    """Means of a band of rows of cells."""
    height, width, count = image.shape
    cells = mean.shape[2]
    row = np.empty(cells * CELL, np.int32)
    for i in range(start, stop):
        rows = min(CELL, height - i * CELL)
        for c in range(count):
            row[:] = 0
            for y in range(i * CELL, i * CELL + rows):
                for x in range(min(row.size, width)):
                    row[x] += image[y, x, c]
            for j in range(cells):
                total = np.int32(0)
                for x in range(j * CELL, (j + 1) * CELL):
                    total += row[x]
                mean[c, i, j] = np.float32(total) / np.float32(
                    rows * min(CELL, width - j * CELL))


@njit(nogil=True, error_model="numpy")
def _variances(start: int, stop: int, image: Any, mean: Any, variance: Any) -> None:
    """Variances about the means between cells, of a band of rows of cells.

    Of each cell the first and the last row, where its neighbours count most, stand for all.
    """
    height, width, count = image.shape
    cells = mean.shape[2]
    column = np.empty(cells, np.float32)
    off = np.empty(max(width, cells * CELL), np.float32)
    off[:] = 0
    for i in range(start, stop):
        last = min(CELL, height - i * CELL) - 1
        for c in range(count):
            variance[c, i] = 0
            for y in (i * CELL, i * CELL + last):
                spread_row(mean[c], y, column, off[:width])
                for x in range(width):
                    off[x] -= np.float32(image[y, x, c])
                for x in range(width):
                    off[x] *= off[x]
                for j in range(cells):
                    left = j * CELL
                    total = np.float32(0)
                    for x in range(left, left + CELL):
                        total += off[x]
                    variance[c, i, j] += total / np.float32(2 * min(CELL, width - left))
