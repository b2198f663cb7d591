# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Low-frequency noise after JPEG compression, from the difference of matched views.

JPEG removes fine noise, from which noise is measured elsewhere. It leaves coarse noise, which
smoothing does not remove, so that gradients of noise are matched. Means of two by two pixels show
coarse noise and texture; texture is the same in both views, but noise is independent.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from uw_visibility.images.arrays import Image, Points
from uw_visibility.images.view import StereoViews, code_value

# Half the side of the squares that are compared, px, and about how many are compared at most.
_REACH, _MOST = 8, 200
# Least number of matches, and the quantile of their squared differences that is used: at larger
# ones disparity is wrong, or between whole pixels, so that texture does not cancel.
_FEWEST, _QUANTILE = 20, 0.15
# Noise from JPEG's rounding alone: blockiness above which it counts, noise per unit of blockiness
# and the most, 8-bit code values. At quality 75 little else is left of faint far scenes.
_BLOCKS_ALONE, _PER_BLOCKINESS, _MOST_OF_BLOCKS = 1.6, 12.0, 2.0
# Least noise that counts, 8-bit code values; less may be texture.
_LEAST = 0.45
# Factor by number of channels: this noise is the same in all channels, while `mixed_noise` takes
# the channels' noise for independent.
_OF_BRIGHTNESS = {1: 1.0, 3: 1.5}
# Variance of noise of variance 1 after a Laplacian: four neighbours minus four times the pixel.
_VARIANCE = 20.0

# Side of JPEG's blocks, px, and the largest number of rows in which they are searched.
_BLOCK, _ROWS = 8, 128
# Limit of third differences, 8-bit code values: larger ones are edges of objects, not of blocks.
_EDGE = 20.0
# Least sum of third differences, 8-bit code values: blank images show no blocks.
_LEAST_DIFFERENCES = 200.0

JPEG_BLOCKINESS = 1.08
"""Blockiness above which pixels were compressed by JPEG; without JPEG it is at most 1.02."""


def with_codec_noise(views: StereoViews, points: Points) -> StereoViews:
    """Return the views with `low_frequency_noise` measured, if they show JPEG's blocks."""
    blocks = max(blocking(view.pixels) for view in views)
    if blocks <= JPEG_BLOCKINESS:
        return views
    code = code_value(views.left.pixels)
    noise = low_frequency_noise(views.left.pixels, views.right.pixels, points)
    of_blocks = min(_PER_BLOCKINESS * (blocks - _BLOCKS_ALONE), _MOST_OF_BLOCKS)
    noise = max(noise, code * of_blocks)
    if noise <= _LEAST * code:
        return views
    return StereoViews(*(
        replace(view, low_frequency_noise=np.maximum(
            view.noise, _OF_BRIGHTNESS[len(view.noise)] * noise))
        for view in views
    ))


def low_frequency_noise(left: Image, right: Image, points: Points) -> float:
    """Standard deviation of white noise with the same power at low frequencies, code values.

    It is that of the channels' mean, from matches (N, 3): column, row and disparity, px; 0 if
    there are too few.
    """
    height, width = left.shape[:2]
    x, y, d = np.rint(points).astype(np.int64).T
    inside = (
        (np.minimum(x, x - d) >= _REACH) & (np.maximum(x, x - d) < width - _REACH - 1)
        & (y >= _REACH) & (y < height - _REACH - 1)
    )
    x, y, d = (values[inside][:: max(1, np.count_nonzero(inside) // _MOST)] for values in (x, y, d))
    if len(x) < _FEWEST:
        return 0.0
    difference = _second_difference(left, x, y) - _second_difference(right, x - d, y)
    # The difference has the noise of both views.
    variance = float(np.quantile(np.mean(difference**2, axis=(1, 2)), _QUANTILE)) / 2
    # A mean of four pixels has half of a pixel's deviation.
    return 2.0 * float(np.sqrt(variance / _VARIANCE))


def _second_difference(
    image: Image, x: NDArray[np.int64], y: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Laplacian, with its sign changed, of means of two by two pixels in squares around points."""
    side = 2 * _REACH + 2
    squares = sliding_window_view(image, (side, side), axis=(0, 1))[y - _REACH, x - _REACH]
    grey = squares.astype(np.float32)
    if image.ndim == 3:
        # np.mean over so few channels takes ten times as long.
        grey = (grey[:, 0] + grey[:, 1] + grey[:, 2]) / np.float32(3)
    p = (grey[:, ::2, ::2] + grey[:, 1::2, ::2] + grey[:, ::2, 1::2] + grey[:, 1::2, 1::2]) / 4
    return np.asarray(
        4 * p[:, 1:-1, 1:-1] - p[:, :-2, 1:-1] - p[:, 2:, 1:-1] - p[:, 1:-1, :-2] - p[:, 1:-1, 2:])


def blocking(image: Image) -> float:
    """Blockiness: third differences across the edges of JPEG's blocks over the largest inside.

    It is about 1 without blocks, and 1.1 or more after JPEG of quality 90. Blocks must begin at
    the first column: images that were resized or rectified after JPEG show none.
    """
    height, width = image.shape[:2]
    if width < 4 * _BLOCK:
        return 1.0
    plane = image if image.ndim == 2 else image[..., 1]
    rows = plane[:: max(1, -(-height // _ROWS))].astype(np.float32)
    rows *= np.float32(255.0 / np.iinfo(image.dtype).max)
    step = np.diff(rows, axis=1)
    third = np.abs(np.float32(2) * step[:, 1:-1] - step[:, :-2] - step[:, 2:])
    sums = np.minimum(third, np.float32(_EDGE)).sum(axis=0)
    if sums.sum() < _LEAST_DIFFERENCES:
        return 1.0
    means = np.array([sums[(at - 2) % _BLOCK :: _BLOCK].mean() for at in range(_BLOCK)])
    # The largest, not the mean: mosaics and resized images repeat every two or four pixels.
    return float(means[0] / max(means[1:].max(), 1e-9))
