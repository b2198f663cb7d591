# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scale selection: the finest scale at which a noisy image shows most of its scene.

Gradients that hold less signal than noise are hardly ever matched, and many are matched by
chance over a wide search. Means over squares of pixels take noise and leave what is coarser. How
much signal there is, is seen in the image itself, without ranges or water.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Image
from uw_visibility.images.view import code_value
from uw_visibility.stereo.contrast import mixed_noise
from uw_visibility.stereo.denoising import ROUNDING

# Side of the cells that are looked at, px.
_CELL = 48
# Variance of a Sobel response to noise of variance 1.
_SOBEL_VARIANCE = 12.0
# Deviation of rounding to 8 bits, code values; the noise that is measured is without it.
_ROUNDING_ERROR = 0.29
# Energy of gradients over that of noise alone from which a cell shows the scene, and from which
# it does so at the coarsest scale, at which few pixels are left of a cell. The noise that is
# measured in the smoothest parts of an image is less by an eighth or so than there is.
_SHOWN, _SURELY_SHOWN = 1.5, 2.0
# Part of what is shown at the coarsest scale that a finer one has to show.
_MOST = 0.9


def matching_scale(
    image: Image, noise: Array, weights: Sequence[float] | Array, scales: Sequence[int]
) -> int:
    """Choose the side of the squares of pixels that are averaged before matching, px.

    image: (H, W, 3) or (H, W) of uint8 or uint16, RGB or grey.
    noise: (3,) or (1,) float64, standard deviation of each channel's noise, code values.
    weights: (3,) array_like, weights of the channels that are matched, of sum 1.
    scales: sides to choose from, px, ascending; the first where there is no noise, and where none
        shows a scene.
    """
    if len(scales) == 1 or mixed_noise(image, noise, weights) <= ROUNDING * code_value(image):
        return scales[0]
    mixed, variance = _mixed(image, noise, weights)
    most = _MOST * float(np.mean(_shown_cells(mixed, scales[-1], _SURELY_SHOWN * variance)))
    for scale in scales[:-1]:
        if float(np.mean(_shown_cells(mixed, scale, _SHOWN * variance))) >= most:
            return scale
    return scales[-1]


def shown(
    image: Image, noise: Array, weights: Sequence[float] | Array, scale: int
) -> NDArray[np.bool_]:
    """Mask (H, W) of the parts of an image that show more than noise at a coarse scale.

    See `matching_scale`; `scale` is the side of the squares of pixels that are averaged, px.
    """
    mixed, variance = _mixed(image, noise, weights)
    cells = _shown_cells(mixed, scale, _SURELY_SHOWN * variance)
    height, width = image.shape[:2]
    return cv2.resize(
        cells.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST).astype(bool)


def _mixed(
    image: Image, noise: Array, weights: Sequence[float] | Array,
) -> tuple[NDArray[np.float32], float]:
    """The weighted channels as one, and the variance of its noise with that of rounding."""
    deviation = mixed_noise(image, noise, weights)
    mixed = image.astype(np.float32)
    if image.ndim == 3:
        mixed = cv2.transform(mixed, np.asarray(weights, np.float64)[np.newaxis])
    if image.dtype == np.uint8:
        deviation = float(np.hypot(deviation, _ROUNDING_ERROR))
    return mixed, deviation**2


def _shown_cells(image: NDArray[np.float32], scale: int, variance: float) -> NDArray[np.bool_]:
    """Cells whose gradients along rows, at a scale, have more energy than noise of a variance."""
    height, width = image.shape
    small = image
    if scale > 1:
        rows, columns = height // scale, width // scale
        whole = image[: rows * scale, : columns * scale]
        small = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    gradient = cv2.Sobel(small, cv2.CV_32F, 1, 0)
    cells = (max(width // _CELL, 1), max(height // _CELL, 1))
    energy = cv2.resize(gradient * gradient, cells, interpolation=cv2.INTER_AREA)
    return np.asarray(energy >= _SOBEL_VARIANCE * variance / scale**2)
