# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Noise estimate of an image, from its smoothest parts."""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Image

BLOCK = 8
SAMPLED_BLOCKS = 200
# Quantile of the blocks' variances that is taken as noise. The smoothest blocks have noise alone,
# but with a lower quantile the scatter of so few pixels' variance would bias the estimate.
SMOOTHEST = 0.15
ROUNDING_VARIANCE = 1.0 / 12.0


def noise_stddev(image: Image) -> Array:
    """Standard deviation of each channel's noise, (C,), in code values, without that of rounding.

    Each pixel is compared with the mean of its four neighbours, in blocks spread over the image.
    Texture raises the difference, so that only the smoothest blocks count. 0 for an image smaller
    than a block with its neighbours.
    """
    planes = image[..., np.newaxis] if image.ndim == 2 else image
    height, width, channels = planes.shape
    result = np.zeros(channels)
    if min(height, width) < BLOCK + 2:
        return result
    stride = max(BLOCK, int(np.sqrt(height * width / SAMPLED_BLOCKS)))
    rows = (height - BLOCK - 2) // stride + 1
    columns = (width - BLOCK - 2) // stride + 1
    variances = np.zeros((rows * columns, channels))
    _block_variances(planes, stride, columns, variances)
    # The mean of four neighbours adds a quarter of the variance. Blocks of a single value, as in
    # padding, do not count.
    for channel in range(channels):
        alive = variances[variances[:, channel] > 0, channel]
        if len(alive):
            variance = _smoothest(alive) / 1.25
            result[channel] = np.sqrt(max(variance - ROUNDING_VARIANCE, 0.0))
    return result


def _smoothest(variances: Array) -> float:
    """Return the quantile `SMOOTHEST`, three times as fast as `numpy.quantile`."""
    ordered = np.sort(variances)
    place = SMOOTHEST * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return float(ordered[below] + (place - below) * (ordered[above] - ordered[below]))


@njit(nogil=True)
def _block_variances(image: Any, stride: int, columns: int, variances: Any) -> None:
    for block in range(len(variances)):
        top = 1 + (block // columns) * stride
        left = 1 + (block % columns) * stride
        for channel in range(image.shape[2]):
            total = np.int64(0)
            for y in range(top, top + BLOCK):
                for x in range(left, left + BLOCK):
                    # Four times the difference, so that its square is 16 times as large.
                    difference = (np.int64(image[y, x, channel]) << 2) - (
                        np.int64(image[y - 1, x, channel]) + np.int64(image[y + 1, x, channel])
                        + np.int64(image[y, x - 1, channel]) + np.int64(image[y, x + 1, channel]))
                    total += difference * difference
            variances[block, channel] = total / (16.0 * BLOCK * BLOCK)
