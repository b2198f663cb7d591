# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Upper bound of the range of unmatched pixels, by the veil that they can hold at most.

What fills the holes of a disparity map serves colour only, and is often too far: beside
a near object it is the background's range. A pixel that is darker than the veil up to
its range would be restored as black; so its brightness bounds its range from above.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Image, Mask, RangeMap
from uw_visibility.optics.light_model import Water, veil_thickness
from uw_visibility.optics.transfer import linear_table

# Every so many pixels is looked at, in rows and in columns.
_STRIDE = 2
# Neighbourhoods, of those: of the least bound, which speckle of noise does not raise, and
# of the smoothing after it, which leaves no blocks.
_LEAST = 3
_SMOOTH = 5
# Part of the ambient light that a pixel keeps at least as direct light.
_LEAST_TRANSMISSION = 1e-3


def bound_by_veil(
    range_map: RangeMap,
    matched: Mask,
    image: Image,
    water: Water,
    transfer: str,
    workers: Workers | None = None,
) -> NDArray[np.float32]:
    """Bound the ranges of unmatched pixels by d = -ln(1 - E/B) / β.

    Parameters
    ----------
    range_map : (H, W) float32 ndarray
        Range with holes filled, m.
    matched : (H, W) bool ndarray
        Pixels whose range was measured; theirs stays.
    image : (H, W, 3) or (H, W) ndarray of uint8 or uint16
        Pixel values.
    water : Water
        Attenuation and ambient light (the veil B); channels with NaN bound nothing.
    transfer : str
        ``"linear"`` or ``"srgb"``.
    """
    attenuation = np.atleast_1d(water.attenuation)
    veil = np.atleast_1d(water.ambient_light)
    planes = image[:, :, np.newaxis] if image.ndim == 2 else image
    known = [c for c in range(planes.shape[2]) if attenuation[c] > 0 and veil[c] > 0]
    if not known or matched.all():
        return range_map
    irradiance = linear_table(transfer, image.dtype)
    tables = np.full((planes.shape[2], irradiance.size), np.inf, np.float32)
    for channel in known:
        farthest = veil[channel] * (1.0 - _LEAST_TRANSMISSION)
        thickness = veil_thickness(np.minimum(irradiance, farthest), veil[channel])
        tables[channel] = thickness / attenuation[channel]
    workers = workers or Workers(1)
    seen = np.empty([-(-size // _STRIDE) for size in range_map.shape], np.float32)
    workers.rows(_look_up, seen.shape[0], planes, tables, seen)
    least = cv2.erode(seen, np.ones((_LEAST, _LEAST), np.uint8))
    smooth = cv2.blur(least, (_SMOOTH, _SMOOTH))
    bound = np.empty_like(range_map)
    workers.rows(_take_lesser, bound.shape[0], range_map, matched, smooth, bound)
    return bound


@njit(nogil=True)
def _look_up(start: int, stop: int, planes: Any, tables: Any, seen: Any) -> None:
    """Write the farthest range that the channels of every second pixel allow."""
    for y in range(start, stop):
        row = planes[_STRIDE * y]
        for x in range(seen.shape[1]):
            farthest = tables[0, row[_STRIDE * x, 0]]
            for c in range(1, planes.shape[2]):
                farthest = min(farthest, tables[c, row[_STRIDE * x, c]])
            seen[y, x] = farthest


@njit(nogil=True)
def _take_lesser(
    start: int, stop: int, range_map: Any, matched: Any, smooth: Any, bound: Any
) -> None:
    least = np.empty(bound.shape[1], np.float32)
    for y in range(start, stop):
        for x in range(bound.shape[1]):
            least[x] = smooth[y // _STRIDE, x // _STRIDE]
        _lesser(range_map[y], matched[y], least, bound[y])


@njit(nogil=True)
def _lesser(ranges: Any, matched: Any, least: Any, bound: Any) -> None:
    """Bound a row at once, since that makes vector code."""
    for x in range(ranges.size):
        lower = (not matched[x]) & (least[x] < ranges[x])
        bound[x] = least[x] if lower else ranges[x]
