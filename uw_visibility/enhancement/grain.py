# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Grain: the part of an image's deviations from smooth light that noise accounts for.

By the local statistics of Lee (1980, doi 10.1109/TPAMI.1980.4766994) on cells: of the variance in
a cell, the part that noise has is grain, the rest is detail. What restoration adds to a picture it
adds without grain, so that flat areas keep the noise of the camera and no more.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Map
from uw_visibility.images.noise import ROUNDING_VARIANCE

# Pixels per cell, in either direction: of 4 and 8, with which traced scenes have less noise
# (`judge --pictures`).
CELL = 4
# Rows beyond a band of whole cells that its grain depends on: three cells.
REACH = 3 * CELL


def find_grain(planes: NDArray[Any], noise: Array, decode: NDArray[np.float32]) -> Map:
    """Find the grain of an image, (H, C, W) float32, irradiance.

    planes: (H, W, C) of uint8 or uint16, code values.
    noise: (C,) float64, standard deviation of the noise, code values; rounding is added to it.
    decode: irradiance of each code value.
    """
    height, width, count = planes.shape
    below, beside = -height % CELL, -width % CELL
    size = width + beside, height + below
    cells = size[0] // CELL, size[1] // CELL
    grain = np.empty((height, count, width), np.float32)
    for c, expected in enumerate((noise**2 + ROUNDING_VARIANCE).tolist()):
        # Cells are whole, so that bands of an image have those of the image.
        plane = cv2.copyMakeBorder(
            planes[..., c], 0, below, 0, beside, cv2.BORDER_REPLICATE).astype(np.float32)
        mean = cv2.resize(plane, cells, interpolation=cv2.INTER_AREA)
        off = plane - cv2.resize(mean, size, interpolation=cv2.INTER_LINEAR)
        variance = cv2.resize(off * off, cells, interpolation=cv2.INTER_AREA)
        # A cell alone scatters; beside an edge, or on one, the larger variance is that of detail.
        around = cv2.blur(variance, (3, 3), borderType=cv2.BORDER_REPLICATE)
        share = expected / np.maximum(np.maximum(around, variance), expected)
        code = np.clip(mean.astype(np.intp), 1, decode.size - 1)
        share *= decode[code] - decode[code - 1]
        off *= cv2.resize(share, size, interpolation=cv2.INTER_LINEAR)
        grain[:, c] = off[:height, :width]
    return grain
