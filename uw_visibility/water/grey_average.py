# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images that are grey on average, as automatic white balance makes them.

A camera that balances each frame by its average ("grey world": Buchsbaum 1980,
doi:10.1016/0016-0032(80)90058-7) takes the colour of daylight away, and with it what
depth is read from; attenuation, a ratio within each channel, stays. Of light that is not
balanced, water takes red over the range in view too, so that only frames at the surface and
near by are grey by chance. Where the gain of red ends before that, green and blue are equal.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit

# ln of the ratio of two channels' mean code values up to which an image is grey on average.
# On real pairs of a video camera with automatic white balance it is up to 0.067; of 960
# frames of fixed balance at 3 m none is within this.
LARGEST_RATIO = 0.08
# The same of green and blue where red is darker. Of 761 rendered frames of fixed balance 0.7 %
# are within this, of 14 whose gain of red ends too early all.
BLUE_AS_GREEN = 0.004
# Every so many-th row and column is looked at.
STRIDE = 4
# Frames that are looked at together, of which more than half have to be grey.
FRAMES = 10


def is_grey_on_average(pixels: NDArray[Any]) -> bool:
    """Whether the channels of an image, or all but a darker red, have the same mean.

    Parameters
    ----------
    pixels : (H, W, 3) ndarray
        RGB code values.
    """
    total = np.zeros(3)
    _sum_up(pixels, total)
    if not total.all():
        return False
    red, _, blue = np.log(total / total[1])
    alike = max(abs(red), abs(blue)) <= LARGEST_RATIO
    return bool(alike or (red < 0.0 and abs(blue) <= BLUE_AS_GREEN))


@njit(nogil=True)
def _sum_up(pixels: Any, total: Any) -> None:
    for y in range(0, pixels.shape[0], STRIDE):
        for x in range(0, pixels.shape[1], STRIDE):
            for c in range(3):
                total[c] += pixels[y, x, c]


class GreyFrames:
    """Whether most frames of late were grey on average.

    A balance that lags behind lets single frames pass for others.
    """

    def __init__(self) -> None:
        self._grey: deque[bool] = deque(maxlen=FRAMES)

    def reset(self) -> None:
        """Forget all frames."""
        self._grey.clear()

    def add(self, grey: bool) -> bool:
        """Take in a frame; return whether more than half of those of late were grey."""
        self._grey.append(grey)
        return 2 * sum(self._grey) > len(self._grey)
