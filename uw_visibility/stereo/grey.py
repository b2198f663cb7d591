# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Grey images for matching, stretched so that weak contrast survives eight bits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uw_visibility.parallel import Workers

# ITU-R BT.601 luma in 256ths, so that grey has eight fractional bits.
_RED, _GREEN, _BLUE = 77, 150, 29
# Part of the pixels that may clip at either end.
_CLIPPED = 0.005
# Beyond this gain the stretch shows quantisation and noise, not texture.
_MAX_GAIN = 16.0


class StretchedGrey:
    """Conversion of an image to grey with its contrast stretched to eight bits.

    The mean of three channels is finer than one level of either, and a turbid
    image has no more than a few dozen levels: a stretch before rounding keeps
    what rounding first would lose.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._fine = np.empty(shape, np.uint16)
        self.grey: NDArray[np.uint8] = np.empty(shape, np.uint8)

    def compute(self, image: NDArray[Any], workers: Workers) -> NDArray[np.uint8]:
        """Convert an image.

        Parameters
        ----------
        image : ndarray
            ``(H, W, 3)`` RGB or ``(H, W)`` grey; uint8 or uint16.
        workers : Workers
            Threads.

        Returns
        -------
        ndarray
            ``(H, W)`` uint8; this object's memory, overwritten by the next call.
        """
        height = self.grey.shape[0]
        shift = 8 if image.dtype == np.uint16 else 0
        if image.ndim == 3:
            workers.rows(_weigh, height, image, shift, self._fine)
        else:
            workers.rows(_widen, height, image, 8 - shift, self._fine)
        # Every fourth pixel of every fourth row tells as much about the whole.
        sample = self._fine[::4, ::4]
        low, high = np.percentile(sample, (100 * _CLIPPED, 100 * (1 - _CLIPPED)))
        gain = min(255.0 / max(high - low, 1.0), _MAX_GAIN / 256.0)
        workers.rows(_stretch, height, self._fine, np.float32(low), np.float32(gain), self.grey)
        return self.grey


@njit(nogil=True, cache=True)
def _weigh(start: int, stop: int, image: Any, shift: int, fine: Any) -> None:
    for y in range(start, stop):
        for x in range(image.shape[1]):
            red, green, blue = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            total = _RED * np.uint32(red) + _GREEN * np.uint32(green) + _BLUE * np.uint32(blue)
            fine[y, x] = total >> shift


@njit(nogil=True, cache=True)
def _widen(start: int, stop: int, image: Any, shift: int, fine: Any) -> None:
    for y in range(start, stop):
        for x in range(image.shape[1]):
            fine[y, x] = np.uint32(image[y, x]) << shift


@njit(nogil=True, cache=True)
def _stretch(start: int, stop: int, fine: Any, low: Any, gain: Any, grey: Any) -> None:
    for y in range(start, stop):
        for x in range(fine.shape[1]):
            value = (np.float32(fine[y, x]) - low) * gain
            grey[y, x] = np.uint8(min(max(value + np.float32(0.5), np.float32(0)), np.float32(255)))
