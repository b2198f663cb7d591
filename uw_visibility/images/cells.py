# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Square cells of pixels: reduction over each cell, and interpolation back to pixels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def fold(
    values: NDArray[Any], side: int, beyond: float | None = None, how: np.ufunc = np.add
) -> NDArray[Any]:
    """Sum (H, W, ...) over cells of side² values, or reduce them by another ufunc.

    Outside of the border values are `beyond`; by default pixels at the border are repeated. Returns
    (⌈H/side⌉, ⌈W/side⌉, ...).
    """
    height, width = (-(-n // side) for n in values.shape[:2])
    pad = [(0, height * side - values.shape[0]), (0, width * side - values.shape[1])]
    pad += [(0, 0)] * (values.ndim - 2)
    if np.any(pad):
        values = (
            np.pad(values, pad, mode="edge") if beyond is None
            else np.pad(values, pad, constant_values=beyond))
    rows = how.reduce(values.reshape(height, side, *values.shape[1:]), axis=1)
    # NumPy reduces over a short last axis ten times more slowly than over a first one.
    return np.asarray(how.reduce([rows[:, i::side] for i in range(side)]))


def means(image: NDArray[Any], side: int) -> NDArray[Any]:
    """Mean of each whole cell of an image, (H, W) or (H, W, C): (⌊H/side⌋, ⌊W/side⌋) or with C."""
    height, width = image.shape[0] // side, image.shape[1] // side
    whole = image[: height * side, : width * side]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def spread(cells: NDArray[Any], side: int, shape: tuple[int, ...]) -> NDArray[Any]:
    """Interpolate values at centres of cells, (h, w, ...), linearly to pixels of a shape (H, W)."""
    size = cells.shape[1] * side, cells.shape[0] * side
    pixels = cv2.resize(cells, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(pixels[: shape[0], : shape[1]])
