# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Colour scale of disparity, the same in all pictures of a recording.

Viridis: it rises in lightness, so that who is colour-blind, and a grey print, tell far from near.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

# The colours reach over the disparities that this share of the matched pixels has.
DRAWN_SHARE = (1.0, 99.0)
# Enough pixels of a frame for that; one in so many rows and columns.
STEP = 4
NOT_MATCHED = (0, 0, 0)


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
        share = np.clip((data - self.low) / max(self.high - self.low, 1e-6), 0.0, 1.0)
        coloured = _colours(share)
        coloured[data < message.min_disparity] = NOT_MATCHED
        return coloured

    def describe(self, disparity: float) -> str:
        """Return a disparity, and the range that it is, in words."""
        if disparity <= 0.0:
            return f"{disparity:.1f} px"
        return f"{disparity:.1f} px ({self.focal_baseline / disparity:.3g} m)"


def gradient() -> str:
    """Return the colours from the lowest disparity to the highest, as CSS has it."""
    stops = _colours(np.linspace(0.0, 1.0, 17)[None])[0]
    return ", ".join(f"rgb({r}, {g}, {b})" for r, g, b in stops)


def _disparities(message: Any) -> NDArray[np.float32]:
    image = message.image
    return np.frombuffer(image.data, np.float32).reshape(image.height, image.width)


def _colours(share: NDArray[Any]) -> NDArray[np.uint8]:
    coloured = cv2.applyColorMap((255.0 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return np.asarray(cv2.cvtColor(coloured, cv2.COLOR_BGR2RGB), np.uint8)
