# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Low-frequency noise that JPEG left, from the difference of the views where they match.

JPEG takes the fine part of noise, by which it is measured elsewhere, and leaves the coarse one,
which smoothing does not take: noise gradients are matched then. In means of two by
two pixels it is seen, but so is texture. Both views show the texture, and each its own noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from uw_visibility.images.arrays import Image, Points
from uw_visibility.images.view import StereoViews, code_value

# Half the side of the squares that are compared, px, and the most of them.
_REACH, _MOST = 8, 200
# So many matches tell it, and of their differences this quantile: at others disparity is wrong,
# or between whole pixels, where texture is in the difference too.
_FEWEST, _QUANTILE = 20, 0.15
# Blockiness from which on what JPEG rounded is noise of its own, how much for a unit of it, 8-bit
# code values, and at most: of faint far scenes little else is left at quality 75.
_BLOCKS_ALONE, _PER_BLOCKINESS, _MOST_OF_BLOCKS = 1.6, 12.0, 2.0
# Noise from which on it counts, 8-bit code values. What is less may be texture.
_LEAST = 0.45
# Factor by number of channels: it is of brightness, alike in all, while noise of channels is
# combined as if each had its own.
_OF_BRIGHTNESS = {1: 1.0, 3: 1.5}
# Variance of the sum of four neighbours less four times the pixel between, for a variance of 1.
_VARIANCE = 20.0

# Side of the blocks, and rows that are looked at for them.
_BLOCK, _ROWS = 8, 128
# Differences beyond so many 8-bit code values are edges of things, not of blocks.
_EDGE = 20.0
# Sum of differences that is needed, in 8-bit code values: blank images show no blocks.
_LEAST_DIFFERENCES = 200.0

JPEG_BLOCKINESS = 1.08
"""Blockiness from which on pixels went through a JPEG: without one it is 1.02 at most."""


def with_codec_noise(views: StereoViews, points: Points) -> StereoViews:
    """Return the views with their noise at low frequencies, where they show JPEG's blocks."""
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
    """Standard deviation of white noise that has as much power at low frequencies.

    Of the mean of the channels, in code values, from matches (N, 3): column, row and disparity, px;
    0 where too few matches tell it.
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
    # Of two views.
    variance = float(np.quantile(np.mean(difference**2, axis=(1, 2)), _QUANTILE)) / 2
    # A mean of four pixels has half their deviation.
    return 2.0 * float(np.sqrt(variance / _VARIANCE))


def _second_difference(
    image: Image, x: NDArray[np.int64], y: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Second differences of means of two by two pixels in squares around points."""
    side = 2 * _REACH + 2
    squares = sliding_window_view(image, (side, side), axis=(0, 1))[y - _REACH, x - _REACH]
    grey = squares.astype(np.float32)
    if image.ndim == 3:
        # Of so few channels, a mean takes ten times as long.
        grey = (grey[:, 0] + grey[:, 1] + grey[:, 2]) / np.float32(3)
    p = (grey[:, ::2, ::2] + grey[:, 1::2, ::2] + grey[:, ::2, 1::2] + grey[:, 1::2, 1::2]) / 4
    return np.asarray(
        4 * p[:, 1:-1, 1:-1] - p[:, :-2, 1:-1] - p[:, 2:, 1:-1] - p[:, 1:-1, :-2] - p[:, 1:-1, 2:])


def blocking(image: Image) -> float:
    """Blockiness: third differences across the edges of JPEG's blocks over the largest within.

    About 1 without blocks; 1.1 and more after a JPEG of quality 90. Blocks begin at the image's
    first column: one that was resized or rectified since shows none.
    """
    height, width = image.shape[:2]
    if width < 4 * _BLOCK:
        return 1.0
    plane = image if image.ndim == 2 else image[..., 1]
    rows = plane[:: max(1, -(-height // _ROWS))].astype(np.float32)
    rows *= np.float32(255.0 / np.iinfo(image.dtype).max)
    # How far the step from a pixel to the next departs from those beside it, summed over rows.
    step = np.diff(rows, axis=1)
    away = np.abs(np.float32(2) * step[:, 1:-1] - step[:, :-2] - step[:, 2:])
    course = np.minimum(away, np.float32(_EDGE)).sum(axis=0)
    if course.sum() < _LEAST_DIFFERENCES:
        return 1.0
    means = np.array([course[(at - 2) % _BLOCK :: _BLOCK].mean() for at in range(_BLOCK)])
    # The largest of the others: mosaics and resized images repeat every two or four pixels.
    return float(means[0] / max(means[1:].max(), 1e-9))
