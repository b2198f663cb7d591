# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Images that are grey on average, by automatic white balance.

A camera that balances each frame by its average ("grey world": Buchsbaum 1980,
doi:10.1016/0016-0032(80)90058-7) removes the colour of daylight, which shows depth; attenuation, a
ratio within each channel, stays. Without balance, water takes red over the range in view, so that
only frames at the surface and near by are grey by chance. Where the gain of red ends before that,
green and blue are equal.
"""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# ln of the ratio of two channels' mean code values up to which an image is grey on average.
# On real pairs of a video camera with automatic white balance it is up to 0.067; 960 frames of
# fixed balance at 3 m are all beyond.
LARGEST_RATIO = 0.08
# The same for green and blue if red is darker, and least number of frames for this: of 128 rendered
# recordings of fixed balance, 5 have one frame within this, and none has two.
BLUE_AS_GREEN = 0.004
LEAST_FRAMES = 3
# Step of the rows and columns that are used.
STRIDE = 4
# Recent frames that are used, of which more than half have to be grey.
FRAMES = 10


class ColourBalance(NamedTuple):
    """Whether the means of an image's channels are equal.

    `grey`: all three are. `blue_as_green`: green and blue are, and red is darker: a balance that
    ran out of red gain, or chance.
    """

    grey: bool
    blue_as_green: bool


def colour_balance(pixels: NDArray[Any]) -> ColourBalance:
    """Compare the means of the channels of RGB code values."""
    total = pixels[::STRIDE, ::STRIDE].sum(axis=(0, 1), dtype=np.float64)
    if not total.all():
        return ColourBalance(False, False)
    red, _, blue = np.log(total / total[1])
    return ColourBalance(
        bool(max(abs(red), abs(blue)) <= LARGEST_RATIO),
        bool(red < 0.0 and abs(blue) <= BLUE_AS_GREEN))


class GreyFrames:
    """Whether automatic white balance made most recent frames grey; single frames may not be."""

    def __init__(self) -> None:
        self._balances: deque[ColourBalance] = deque(maxlen=FRAMES)

    def add(self, balance: ColourBalance) -> bool:
        """Add a frame; return whether more than half of the recent ones were balanced."""
        self._balances.append(balance)
        frames = len(self._balances)
        balanced = sum(
            one.grey or (one.blue_as_green and frames >= LEAST_FRAMES) for one in self._balances)
        return 2 * balanced > frames
