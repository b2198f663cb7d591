# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Weighted guided filter (He, Sun and Tang, doi 10.1109/TPAMI.2012.213)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]
Coefficients = tuple[Plane, Plane]
"""Slope over the guide and offset, (h, w) each."""


def guided(
    value: Plane, weight: Plane, guide: Plane, radius: int, smoothness: float,
    residual: float | None = None,
) -> Coefficients:
    """Slope and offset of a value as a linear function of the guide, fitted in windows.

    Both are averaged over all windows that contain a cell; windows are cut at the border.

    value, weight, guide: (h, w) float32; weights are positive.
    radius: radius of a window, in cells.
    smoothness: variance of the guide below which it counts as flat.
    residual: if given, a window's weight in the average is the sum of its weights over this
        variance plus that of the fit's residuals; otherwise all windows have the same weight.
    """
    total = _box(weight, radius)
    middle, level, both, square = (
        _box(weight * plane, radius) / total
        for plane in (guide, value, guide * value, guide * guide))
    common = both - middle * level
    slope = common / (square - middle * middle + np.float32(smoothness))
    offset = level - slope * middle
    count = np.ones_like(total)
    if residual is not None:
        beside = _box(weight * value * value, radius) / total - level * level - slope * common
        count = total / (np.maximum(beside, np.float32(0.0)) + np.float32(residual))
    counted = _box(count, radius)
    return _box(count * slope, radius) / counted, _box(count * offset, radius) / counted


def _box(plane: Plane, radius: int) -> Plane:
    """Sums over windows of 2 radius + 1 cells, cut at the border."""
    side = 2 * radius + 1
    return np.asarray(cv2.boxFilter(
        plane, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT), np.float32)
