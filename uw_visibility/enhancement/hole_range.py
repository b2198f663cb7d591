# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Upper bound of the range of unmatched pixels, by the veil that they can hold at most.

What fills the holes of a disparity map serves colour only, and is often too far: beside
a near object it is the background's range. A pixel that is darker than the veil up to
its range would be restored as black; so its brightness bounds its range from above.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.optics.light_model import Water, veil_thickness
from uw_visibility.optics.transfer import linear_table

# Neighbourhoods, px: of the least bound, which speckle of noise does not raise, and of
# the smoothing after it, which leaves no blocks.
_LEAST = 5
_SMOOTH = 9
# Part of the ambient light that a pixel keeps at least as direct light.
_LEAST_TRANSMISSION = 1e-3


def bound_by_veil(
    range_map: NDArray[np.float32],
    matched: NDArray[np.bool_],
    image: NDArray[np.generic],
    water: Water,
    transfer: str,
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

    Returns
    -------
    (H, W) float32 ndarray
        The range map; no range is larger than before.
    """
    if matched.all():
        return range_map
    attenuation = np.atleast_1d(water.attenuation)
    veil = np.atleast_1d(water.ambient_light)
    planes = image[:, :, np.newaxis] if image.ndim == 2 else image
    irradiance = linear_table(transfer, image.dtype).astype(np.float64)
    bound: NDArray[np.float32] | None = None
    for channel in range(planes.shape[2]):
        if not (attenuation[channel] > 0 and veil[channel] > 0):
            continue
        share = np.minimum(irradiance / veil[channel], 1.0 - _LEAST_TRANSMISSION)
        table = (veil_thickness(share, 1.0) / attenuation[channel]).astype(np.float32)
        farthest = table[planes[:, :, channel]]
        bound = farthest if bound is None else np.minimum(bound, farthest)
    if bound is None:
        return range_map
    least = cv2.erode(bound, np.ones((_LEAST, _LEAST), np.uint8))
    smooth = cv2.blur(least, (_SMOOTH, _SMOOTH))
    return np.where(matched, range_map, np.minimum(range_map, smooth))
