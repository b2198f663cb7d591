# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Grain: the part of an image's local deviations that is noise.

Uses local statistics (Lee 1980, doi 10.1109/TPAMI.1980.4766994) on cells: grain is the share of the
noise variance in a cell's variance, the rest is detail. Restoration does not amplify grain, so that
flat areas keep the camera's noise level.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Map
from uw_visibility.images.noise import ROUNDING_VARIANCE

# Side of a cell, px: of 4 and 8 the one with less noise in traced scenes (`judge --pictures`).
CELL = 4
# Rows above and below a band that its grain depends on: three cells.
REACH = 3 * CELL


def find_grain(image: NDArray[Any], noise: Array, decode: NDArray[np.float32]) -> Map:
    """Estimate the grain of an image, (H, W, C) float32, irradiance.

    image: (H, W, C) of uint8 or uint16, code values.
    noise: (C,) float64, standard deviation of the noise, code values; rounding is added to it.
    decode: irradiance of each code value.
    """
    height, width = image.shape[:2]
    below, beside = -height % CELL, -width % CELL
    size = width + beside, height + below
    cells = size[0] // CELL, size[1] // CELL
    # Cells are whole, so that bands of an image have those of the image.
    codes = cv2.copyMakeBorder(
        image, 0, below, 0, beside, cv2.BORDER_REPLICATE).astype(np.float32)
    mean = cv2.resize(codes, cells, interpolation=cv2.INTER_AREA)
    off = cv2.subtract(codes, cv2.resize(mean, size, interpolation=cv2.INTER_LINEAR), dst=codes)
    variance = cv2.resize(cv2.multiply(off, off), cells, interpolation=cv2.INTER_AREA)
    # Averaging reduces scatter; the maximum keeps detail at edges and beside them.
    around = cv2.blur(variance, (3, 3), borderType=cv2.BORDER_REPLICATE)
    expected = (noise**2 + ROUNDING_VARIANCE).astype(np.float32)
    mean, variance, around = (
        plane.reshape(*cells[::-1], -1) for plane in (mean, variance, around))
    share = expected / np.maximum(np.maximum(around, variance), expected)
    code = np.clip(mean.astype(np.intp), 1, decode.size - 1)
    share *= decode[code] - decode[code - 1]
    grain = cv2.multiply(off, cv2.resize(share, size, interpolation=cv2.INTER_LINEAR), dst=off)
    return np.asarray(grain.reshape(*size[::-1], -1)[:height, :width])
