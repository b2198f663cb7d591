# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Colour scale of disparity, the same in all pictures of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.overview import DRAWN_SHARE, draw_disparity, viridis

# Enough pixels of a frame for that; one in so many rows and columns.
STEP = 4


class ColourScale(NamedTuple):
    """Colour scale: the disparities that the ends of the colours stand for.

    Attributes
    ----------
    low, high : float
        Disparities, px.
    focal_baseline : float
        Focal length times baseline, px m: range times disparity.
    """

    low: float
    high: float
    focal_baseline: float

    @classmethod
    def of(cls, messages: Iterable[Any]) -> ColourScale | None:
        """Return the scale that suits some DisparityImages; None where nothing matched."""
        known: list[NDArray[np.float32]] = []
        focal_baseline = math.nan
        for message in messages:
            data = _disparities(message)[::STEP, ::STEP]
            known.append(data[data >= message.min_disparity])
            focal_baseline = float(message.f) * float(message.t)
        values = np.concatenate(known) if known else np.empty(0, np.float32)
        if not values.size:
            return None
        low, high = (float(value) for value in np.percentile(values, DRAWN_SHARE))
        return cls(low, high, focal_baseline)

    def draw(self, message: Any) -> NDArray[np.uint8]:
        """Return a DisparityImage in colours, (H, W, 3) RGB, black where nothing matched."""
        data = _disparities(message)
        return draw_disparity(data, data >= message.min_disparity, self.low, self.high)

    def describe(self, disparity: float) -> str:
        """Return a disparity, and the range that it is, in words."""
        if disparity <= 0.0:
            return f"{disparity:.1f} px"
        return f"{disparity:.1f} px ({self.focal_baseline / disparity:.3g} m)"


def gradient() -> str:
    """Return the colours from the lowest disparity to the highest, as CSS has it."""
    stops = viridis(np.linspace(0.0, 1.0, 17)[None])[0]
    return ", ".join(f"rgb({r}, {g}, {b})" for r, g, b in stops)


def _disparities(message: Any) -> NDArray[np.float32]:
    image = message.image
    return np.frombuffer(image.data, np.float32).reshape(image.height, image.width)
