# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Noise estimate of an image, from its smoothest parts."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from uw_visibility.images.arrays import Array, Image

BLOCK = 8
SAMPLED_BLOCKS = 200
# The smoothest blocks hold noise alone; the quantile is not lower still, since
# the variance of so few pixels scatters.
SMOOTHEST = 0.15
ROUNDING_VARIANCE = 1.0 / 12.0


def noise_stddev(image: Image) -> Array:
    """Standard deviation of the noise of each channel, in code values, without rounding's.

    Each pixel is compared with the mean of its four neighbours, in blocks
    spread over the image; texture raises the difference, so the smoothest
    blocks count. 0 for an image smaller than a block.
    """
    planes = image[..., np.newaxis] if image.ndim == 2 else image
    height, width, channels = planes.shape
    result = np.zeros(channels)
    if min(height, width) < BLOCK + 2:
        return result
    stride = max(BLOCK, int(np.sqrt(height * width / SAMPLED_BLOCKS)))
    # Blocks with a border of a pixel: (rows, columns, channels, BLOCK + 2, BLOCK + 2).
    blocks = sliding_window_view(planes, (BLOCK + 2, BLOCK + 2), axis=(0, 1))[::stride, ::stride]
    blocks = blocks.astype(np.float64)
    # Four times the difference from the mean of four.
    apart = (
        4 * blocks[..., 1:-1, 1:-1] - blocks[..., :-2, 1:-1] - blocks[..., 2:, 1:-1]
        - blocks[..., 1:-1, :-2] - blocks[..., 1:-1, 2:])
    variances = np.einsum("ijcyx,ijcyx->ijc", apart, apart).reshape(-1, channels)
    variances /= 16.0 * BLOCK**2
    # The mean of four neighbours adds a quarter of the variance; blocks of one
    # value, as in padding, hold no noise to measure.
    for channel in range(channels):
        alive = variances[variances[:, channel] > 0, channel]
        if len(alive):
            variance = float(np.quantile(alive, SMOOTHEST)) / 1.25
            result[channel] = np.sqrt(max(variance - ROUNDING_VARIANCE, 0.0))
    return result
