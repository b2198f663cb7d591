# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Scale selection: the finest scale at which a noisy image shows most of its scene.

Gradients with less signal than noise are hardly ever matched correctly, and many are matched by
chance in a wide search. Means over squares of pixels reduce noise and keep coarser structure. The
amount of signal is measured in the image alone, without ranges or water.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Image
from uw_visibility.images.cells import means
from uw_visibility.images.view import code_value
from uw_visibility.stereo.contrast import mixed_noise
from uw_visibility.stereo.denoising import ROUNDING

# Side of the cells in which gradients are compared with noise, px.
_CELL = 48
# Variance of a Sobel response to noise of variance 1.
_SOBEL_VARIANCE = 12.0
# Standard deviation of rounding to 8 bits, code values; the measured noise does not include it.
_ROUNDING_ERROR = 0.29
# Least energy of gradients over that of noise in a cell that shows the scene, and the same at the
# coarsest scale, at which a cell has few pixels. Noise is underestimated by about an eighth, since
# it is measured in the smoothest parts of an image.
_SHOWN, _SURELY_SHOWN = 1.5, 2.0
# Least number of cells that show the scene at a finer scale, over that at the coarsest.
_MOST = 0.9


def matching_scale(
    image: Image, noise: Array, weights: Sequence[float] | Array, scales: Sequence[int]
) -> int:
    """Choose the side of the squares of pixels that are averaged before matching, px.

    image: (H, W, 3) or (H, W) of uint8 or uint16, RGB or grey.
    noise: (3,) or (1,) float64, standard deviation of each channel's noise, code values.
    weights: (3,) array_like, weights of the channels that are matched, of sum 1.
    scales: sides to choose from, px, ascending; the first is chosen without noise, and if no
        scale shows a scene.
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
    """Mask (H, W) of the parts of an image in which a coarse scale shows more than noise.

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
    """Weighted sum of the channels, and the variance of its noise including rounding."""
    deviation = mixed_noise(image, noise, weights)
    mixed = image.astype(np.float32)
    if image.ndim == 3:
        mixed = cv2.transform(mixed, np.asarray(weights, np.float64)[np.newaxis])
    if image.dtype == np.uint8:
        deviation = float(np.hypot(deviation, _ROUNDING_ERROR))
    return mixed, deviation**2


def _shown_cells(image: NDArray[np.float32], scale: int, variance: float) -> NDArray[np.bool_]:
    """Cells in which gradients along rows, at a scale, have more energy than those of noise."""
    height, width = image.shape
    gradient = cv2.Sobel(image if scale == 1 else means(image, scale), cv2.CV_32F, 1, 0)
    cells = (max(width // _CELL, 1), max(height // _CELL, 1))
    energy = cv2.resize(gradient * gradient, cells, interpolation=cv2.INTER_AREA)
    return np.asarray(energy >= _SOBEL_VARIANCE * variance / scale**2)
