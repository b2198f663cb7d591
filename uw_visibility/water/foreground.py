# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Foreground mask: unmatched close objects that would bias the envelopes.

A diver's hand or an animal close to the lens is too near to be matched and out of
focus, so that its blurred outline lets the scene shine through, at the scene's range
and in wrong colours. The darkest and brightest pixels of the scene, which the water's
estimate rests on, would be those.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Mask
from uw_visibility.images.cells import means
from uw_visibility.optics.transfer import linear_table

# The search looks at cells of this side, px.
_CELL = 4
# Parts of the image's width: least distance from all support points that makes an area unmatched;
# width of the blurred outline of an object.
_VOID = 0.04
_OUTLINE = 0.1
# Part of the scene's cells beyond its range of irradiance.
_OUTSIDE = 0.005
# Least distance of a foreground object from that range, as a part of its ends and of the largest
# irradiance.
_BEYOND = 0.1
_BEYOND_LEAST = 0.015
# Open water may be brighter than all of the scene, but is never redder than far surfaces.
_FAR = 0.1
_REDDER = 0.06
# Part of the image that a foreground object covers at least.
_LEAST_AREA = 0.003


def foreground_mask(image: NDArray[Any], points: NDArray[np.float32], transfer: str) -> Mask | None:
    """Mask of unmatched close objects that would bias the envelopes, (H, W); None without any.

    Those are large areas without matches that are darker or brighter than the scene; the mask
    includes their blurred outlines. `points` are the support points, (N, 3) float32: column, row,
    disparity, px.
    """
    height, width = image.shape[:2]
    codes = means(image, _CELL)
    rows, columns = codes.shape[:2]
    irradiance = linear_table(transfer, image.dtype)
    at = points[:, [1, 0]].astype(np.int64) // _CELL
    inside = (at[:, 0] < rows) & (at[:, 1] < columns)
    at, disparity = at[inside], points[inside, 2]
    matched = np.zeros((rows, columns), np.uint8)
    matched[at[:, 0], at[:, 1]] = 1
    void = _distance(matched) > _VOID * width
    if np.count_nonzero(void) < _LEAST_AREA * void.size:
        return None
    # Matches beside an unmatched area may be on an object's outline.
    scene = (matched > 0) & (_distance(void) > _OUTLINE * width)
    if np.count_nonzero(scene) < _LEAST_AREA * void.size:
        return None
    low, high = np.quantile(irradiance[codes[scene]], (_OUTSIDE, 1.0 - _OUTSIDE), axis=0)
    far = disparity <= np.quantile(disparity, _FAR)
    red = np.median(_red(irradiance[codes[at[far, 0], at[far, 1]]]))
    least = _BEYOND_LEAST * high.max()
    unmatched = irradiance[codes[void]]
    darker = (unmatched < (1.0 - _BEYOND) * low - least).any(axis=1)
    brighter = (unmatched > (1.0 + _BEYOND) * high + least).any(axis=1)
    brighter &= _red(unmatched) > red + _REDDER
    found = void.copy()
    found[void] = darker | brighter
    if np.count_nonzero(found) < _LEAST_AREA * found.size:
        return None
    reached = (_distance(found) <= _OUTLINE * width).astype(np.uint8)
    return cv2.resize(reached, (width, height), interpolation=cv2.INTER_NEAREST) > 0


def _distance(mask: NDArray[Any]) -> NDArray[np.float32]:
    """Distance of each cell from the nearest one of the mask, px."""
    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    outside = (mask == 0).astype(np.uint8)
    return np.float32(_CELL) * cv2.distanceTransform(outside, cv2.DIST_L2, cv2.DIST_MASK_5)


def _red(light: NDArray[np.floating]) -> NDArray[np.floating]:
    """Part of red in the light of each cell."""
    return np.asarray(light[..., 0] / np.maximum(light.sum(axis=-1), 1e-6))
