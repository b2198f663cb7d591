# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""White balance of the restored image: white that the camera has balanced stays white.

Restoration divides by the light W on the scene. Where a camera has balanced its white
under water, patches that are white already would take on the colour that the estimate of
W is off by; so their colour in the image, not that of W, says what white is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.enhancement.veil_level import level_veil
from uw_visibility.images.arrays import Array, Image, Mask, RangeMap
from uw_visibility.optics.light_model import Water, contrast_gain, radiance_of, scene_light_of
from uw_visibility.optics.transfer import linear_table

# Pixels with a range that are looked at, at the most, and at least.
_SAMPLES = 10_000
_FEWEST = 200
# Farther than this optical thickness, noise alone is restored as brighter than white.
_MOST_THICKNESS = 1.5
# White is looked for in the brightest of them that are not saturated, this part.
_BRIGHTEST = 0.01
# Saturation (max - min) / max of their light up to which they are white for certain,
# and from which on they are not.
_NEUTRAL = (0.06, 0.12)
# Part of the pixels that may be restored as brighter than white.
_OVEREXPOSED = 0.005
# What rounding leaves in the mean of many pixels, in code values.
_QUANTISATION = 0.3


class RestorationWater(NamedTuple):
    """Attenuation, veil and scene light for restoration, one value a channel.

    Attributes
    ----------
    attenuation, ambient_light, scene_light : (C,) float64 ndarray
        β, 1/m; the veil B; the light W on the scene.
    balanced : float
        How far W was taken from the camera's own white: 0 not at all, 1 wholly.
    veil_stddev : (C,) float64 ndarray or None
        Standard deviation of the veil; None where it is taken for exact.
    """

    attenuation: Array
    ambient_light: Array
    scene_light: Array
    balanced: float = 0.0
    veil_stddev: Array | None = None


def restoration_water(
    image: Image,
    range_map: RangeMap,
    measured: Mask,
    water: Water,
    transfer: str,
    veil_stddev: Array | None = None,
) -> RestorationWater:
    """Correct veil and scene light for restoration: the camera's white stays, the far is even.

    The brightest unsaturated pixels are taken for white where their colour in the image is
    neutral: of light that is not balanced, water would have taken the red. W is then scaled
    in each channel so that their restored colour is the one they had. Where much of the
    scene would be restored as brighter than white, as sunlit sand before a dark wall, W is
    raised alike in all channels. Before, the veil is moved within its deviation, see
    `veil_level`.

    Parameters
    ----------
    image : (H, W, 3) or (H, W) ndarray of uint8 or uint16
        Pixel values.
    range_map : (H, W) float32 ndarray
        Range along the line of sight, m.
    measured : (H, W) bool ndarray
        Pixels whose range was measured; others tell nothing here.
    water : Water
        State to restore with; NaN where not assessable.
    transfer : str
        ``"linear"`` or ``"srgb"``.
    veil_stddev : (C,) float64 ndarray, optional
        Standard deviation of the veil; where absent it is taken for exact.

    Returns
    -------
    RestorationWater
        The same with veil and W corrected; as it was where too little is seen or assessable.
    """
    attenuation = np.array(water.attenuation, np.float64, ndmin=1)
    veil = np.array(water.ambient_light, np.float64, ndmin=1)
    light = np.array(scene_light_of(water), ndmin=1)
    if not np.isfinite(attenuation + veil + light).all():
        return RestorationWater(attenuation, veil, light)
    codes, distance = _samples(image, range_map, measured)
    if len(distance) < _FEWEST:
        return RestorationWater(attenuation, veil, light, veil_stddev=veil_stddev)
    irradiance = linear_table(transfer, image.dtype)[codes].astype(np.float64)
    if veil_stddev is not None:
        veil = level_veil(
            irradiance, distance, attenuation, veil, light, veil_stddev,
            _QUANTISATION / np.iinfo(image.dtype).max)
    near = distance < _MOST_THICKNESS / max(float(attenuation.max()), 1e-9)
    irradiance, distance = irradiance[:, near], distance[near]
    if len(distance) < _FEWEST:
        return RestorationWater(attenuation, veil, light, veil_stddev=veil_stddev)
    gain = contrast_gain(attenuation[:, np.newaxis], distance)
    radiance = radiance_of(irradiance, gain, veil[:, np.newaxis], light[:, np.newaxis])
    factor, balanced = _white(irradiance, radiance)
    exposure = np.quantile(
        (radiance / factor[:, np.newaxis]).mean(axis=0), 1.0 - _OVEREXPOSED)
    return RestorationWater(
        attenuation, veil, light * factor * max(exposure, 1.0), balanced, veil_stddev)


def _white(irradiance: Array, radiance: Array) -> tuple[Array, float]:
    """Factor of each channel's light by which the camera's white stays, and how sure it is one."""
    channels = len(irradiance)
    unchanged = np.ones(channels), 0.0
    brightness = irradiance.sum(axis=0)
    bright = brightness >= np.quantile(brightness, 1.0 - _BRIGHTEST)
    shown = np.median(irradiance[:, bright], axis=1)
    saturation = 1.0 - shown.min() / max(shown.max(), 1e-6)
    certain, not_at_all = _NEUTRAL
    weight = float(np.clip((not_at_all - saturation) / (not_at_all - certain), 0.0, 1.0))
    restored = np.median(radiance[:, bright], axis=1)
    if channels == 1 or weight == 0.0 or restored.min() <= 0.0:
        return unchanged
    factor = (restored / restored.mean()) / (shown / shown.mean())
    return factor**weight, weight


def _samples(image: Image, range_map: RangeMap, measured: Mask) -> tuple[NDArray[Any], Array]:
    """Pixel values, (C, N), and ranges, (N,), of unsaturated pixels."""
    stride = max(1, int(np.sqrt(range_map.size / _SAMPLES)))
    distance = range_map[::stride, ::stride].ravel()
    codes = np.ascontiguousarray(image[::stride, ::stride].reshape(distance.size, -1).T)
    usable = measured[::stride, ::stride].ravel() & (distance > 0) & (distance < np.inf)
    usable &= (codes < np.iinfo(image.dtype).max).all(axis=0)
    chosen = np.flatnonzero(usable)
    # Each channel in a piece, which a mask of both axes would not leave them in.
    return codes.take(chosen, axis=1), distance[chosen].astype(np.float64)
