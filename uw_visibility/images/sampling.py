# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""How the pixels that the water is read from sample the light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Sampling:
    """What is known of pixels beside their values.

    Attributes
    ----------
    scale : int
        A pixel is the mean of so many times so many of the camera's.
    hidden_noise : (3,) float64 ndarray or None
        Standard deviation of R, G, B in 8-bit code values that the smoothest parts of
        the image do not show: what a codec rounds where there is texture, and what
        interpolation smooths. None where there is none.
    most_noise : (3,) float64 ndarray or None
        What those parts show at most, likewise: a mean has no more noise than the
        camera's pixels, but its neighbours are farther away, so that texture looks
        more like it. None where that is not known.
    """

    scale: int = 1
    hidden_noise: NDArray[np.float64] | None = None
    most_noise: NDArray[np.float64] | None = None

    def pixels(self, number: float) -> float:
        """Return how many pixels show as much as a number of the camera's; at least 1."""
        return max(number / self.scale**2, 1.0)

    def margin(self, pixels: int) -> int:
        """Return a distance in the camera's pixels as one in these, rounded up."""
        return -(-pixels // self.scale)


CAMERA = Sampling()
"""Pixels as the camera gives them."""
