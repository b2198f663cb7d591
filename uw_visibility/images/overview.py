# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Overview of a frame: before, after and disparity in colours, side by side.

Viridis: it rises in lightness, so that who is colour-blind, and a grey print, tell far from near.
"""

from __future__ import annotations

import cv2
import numpy as np

from uw_visibility.images.arrays import DisparityMap, Image, Image8

# The colours reach over the disparities that this share of the matched pixels has, %.
DRAWN_SHARE = (1.0, 99.0)
NOT_MATCHED = (0, 0, 0)


def overview(image: Image, enhanced: Image, disparity: DisparityMap) -> Image8:
    """Put an image, itself without the water, and its disparity (px, NaN is black) side by side."""
    known = np.isfinite(disparity)
    low, high = np.percentile(disparity[known], DRAWN_SHARE) if known.any() else (0.0, 0.0)
    drawn = draw_disparity(disparity, float(low), float(high))
    return np.concatenate((shown(image), shown(enhanced), drawn), axis=1)


def draw_disparity(disparity: DisparityMap, low: float, high: float) -> Image8:
    """Draw disparities, px, in colours that reach from low to high; NaN is black."""
    known = np.isfinite(disparity)
    share = (np.where(known, disparity, low) - low) / max(high - low, 1e-6)
    drawn = viridis(np.clip(share, 0.0, 1.0))
    drawn[~known] = NOT_MATCHED
    return drawn


def viridis(share: Image) -> Image8:
    """Return colours, (H, W, 3) RGB, of shares from 0 to 1, (H, W)."""
    coloured = cv2.applyColorMap((255.0 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return np.asarray(cv2.cvtColor(coloured, cv2.COLOR_BGR2RGB), np.uint8)


def shown(image: Image) -> Image8:
    """Return an image as 8 bit RGB."""
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    return np.asarray(
        cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.ndim == 2 else image, np.uint8)
