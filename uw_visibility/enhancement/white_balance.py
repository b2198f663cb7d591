# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""White balance of the restored image: white that the camera has balanced stays white.

Restoration divides by the light W on the scene. If the camera's white balance was set under water,
white patches are neutral already, and an error of W would tint them. Their colour in the image is
then used as white instead of that of W.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.enhancement.radiance import RestorationWater
from uw_visibility.images.arrays import Array, Image, Mask, RangeMap
from uw_visibility.optics.light_model import contrast_gain, radiance_of, transmission
from uw_visibility.optics.transfer import linear_table

# Approximate number of sampled pixels, and least number of them with a range.
_SAMPLES = 10_000
_FEWEST = 200
# Largest optical thickness: beyond, noise alone may be restored brighter than white.
_MOST_THICKNESS = 1.5
# Share of the samples, the brightest, that may be white.
_BRIGHTEST = 0.01
# Colour saturation (max - min) / max of their median up to which they count as white fully, and
# from which on not at all.
_NEUTRAL = (0.06, 0.12)
# Largest share of samples that are restored brighter than white.
_OVEREXPOSED = 0.005
# Quantisation error of the mean of many pixels, in code values.
_QUANTISATION = 0.3


def restoration_water(
    image: Image, range_map: RangeMap, measured: Mask, water: RestorationWater, transfer: str
) -> RestorationWater:
    """Correct veil and scene light for restoration: the camera's white stays white.

    First, the veil is adjusted within its uncertainty `veil_stddev`, see
    `level_veil`. The brightest unsaturated pixels count as white if their colour in the image is
    neutral: without white balance under water they would lack red. W is then scaled per channel so
    that restoration keeps their colour. If too many pixels would be restored brighter than white,
    such as sunlit sand before a dark wall, W is raised by the same factor in all channels.

    Only `measured` ranges count. Veil or W stay unchanged if too few samples determine them, or if
    no channel is assessable.
    """
    attenuation, veil, light = (np.array(each, np.float64) for each in water[:3])
    veil_stddev = water.veil_stddev
    seen = np.isfinite(attenuation + veil + light)
    if not seen.any():
        return RestorationWater(attenuation, veil, light)
    if not seen.all():
        # Channels that are not assessable stay as they are.
        part = restoration_water(
            image[..., seen], range_map, measured, RestorationWater(
                attenuation[seen], veil[seen], light[seen],
                None if veil_stddev is None else veil_stddev[seen]),
            transfer)
        veil[seen], light[seen] = part.ambient_light, part.scene_light
        if veil_stddev is not None:
            veil_stddev = np.array(veil_stddev)
            veil_stddev[seen] = part.veil_stddev
        return RestorationWater(attenuation, veil, light, veil_stddev, part.balanced)
    corrected = RestorationWater(attenuation, veil, light, veil_stddev)
    codes, distance = _samples(image, range_map, measured)
    if len(distance) < _FEWEST:
        return corrected
    irradiance = linear_table(transfer, image.dtype)[codes].astype(np.float64)
    if veil_stddev is not None:
        veil, veil_stddev = level_veil(
            irradiance, distance, attenuation, veil, light, veil_stddev,
            _QUANTISATION / np.iinfo(image.dtype).max)
        corrected = corrected._replace(ambient_light=veil, veil_stddev=veil_stddev)
    near = distance < _MOST_THICKNESS / max(float(attenuation.max()), 1e-9)
    irradiance, distance = irradiance[:, near], distance[near]
    if len(distance) < _FEWEST:
        return corrected
    gain = contrast_gain(attenuation[:, np.newaxis], distance)
    radiance = radiance_of(irradiance, gain, veil[:, np.newaxis], light[:, np.newaxis])
    factor, balanced = _white(irradiance, radiance)
    exposure = np.quantile((radiance / factor[:, np.newaxis]).mean(axis=0), 1.0 - _OVEREXPOSED)
    return corrected._replace(scene_light=light * factor * max(exposure, 1.0), balanced=balanced)


def _white(irradiance: Array, radiance: Array) -> tuple[Array, float]:
    """Factors on W, (C,), that keep the camera's white, and the weight of that white, 0..1."""
    channels = len(irradiance)
    unchanged = np.ones(channels), 0.0
    brightness = irradiance.sum(axis=0)
    bright = brightness >= np.quantile(brightness, 1.0 - _BRIGHTEST)
    shown = np.median(irradiance[:, bright], axis=1)
    saturation = 1.0 - shown.min() / max(shown.max(), 1e-6)
    certain, not_at_all = _NEUTRAL
    weight = float(np.clip((not_at_all - saturation) / (not_at_all - certain), 0.0, 1.0))
    restored = np.median(radiance[:, bright], axis=1)
    # Neutral colour cannot be recognised without all three channels.
    if channels < 3 or weight == 0.0 or restored.min() <= 0.0:
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
    # `take` keeps each channel contiguous; a boolean mask would not.
    return codes.take(chosen, axis=1), distance[chosen].astype(np.float64)


# Number of bins, equally wide in ln range; least number of pixels in a bin; number of adjacent bins
# that count as one, since they show the same object.
_BINS, _FEWEST_IN_BIN, _NEIGHBOURS = 24, 50, 3.0
# Standard deviation of the mean radiance over ranges.
_SCATTER = 0.3
# Largest relative standard deviation of the veil's prior, so that dark water stays dark.
_MOST = 0.1
# Least mean transmission of a bin that is used.
_LEAST_LEFT = 1e-3


def level_veil(
    irradiance: Array,
    distance: Array,
    attenuation: Array,
    veil: Array,
    light: Array,
    stddev: Array,
    error: float,
) -> tuple[Array, Array]:
    """Veil for which radiance depends least on range, and its standard deviation.

    The prior of the veil has the given mean and standard deviation, of at most `_MOST` of the mean.

    Restoration at long range multiplies an error of the veil by e^(βd): 2 % at an optical thickness
    of 3 become 0.4 of white. Far surfaces are on average as bright as near ones, but for a scatter
    over ranges; this prior determines the veil better than the dark envelope does. It is not used
    in the published estimate. A bin's mean radiance is linear in the veil, so that the solution is
    weighted least squares. If radiance depends on range all the same, the standard deviation is
    increased by Birge's ratio (1932, doi 10.1103/PhysRev.40.207).

    irradiance: (C, N) float64, of pixels, 0..1.
    distance: (N,) float64, their range, m, above 0 and finite.
    attenuation, veil, light, stddev: (C,) float64, β, 1/m; veil B; light W on the scene; standard
        deviation of the veil.
    error: of a bin's irradiance, by quantisation.
    """
    low, high = distance.min(), distance.max()
    place = np.log(distance / low) / max(np.log(high / low), 1e-9)
    bins = np.minimum((place * _BINS).astype(np.intp), _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    full = count >= _FEWEST_IN_BIN
    if np.count_nonzero(full) < 2:
        return veil, stddev
    level, left_over = veil.copy(), np.array(stddev, np.float64)
    for c in range(len(veil)):
        # The mean of e^(-βd) over a bin differs from its value at the mean range.
        left = _mean(transmission(attenuation[c], distance), bins, count)[full]
        shown = left > _LEAST_LEFT
        gain = shown / np.where(shown, left, 1.0)
        radiance = radiance_of(_mean(irradiance[c], bins, count)[full], gain, veil[c], light[c])
        change = (gain - 1.0) / light[c]
        weight = shown / (_NEIGHBOURS * (_SCATTER**2 + (error * gain / light[c]) ** 2))
        for values in (radiance, change):
            values -= weight @ values / max(weight.sum(), 1e-9)
        prior = 1.0 / min(max(stddev[c], 1e-6), _MOST * veil[c]) ** 2
        step = weight @ (change * radiance) / (weight @ change**2 + prior)
        if not step > -veil[c]:
            continue
        level[c] += step
        residual = _NEIGHBOURS * (weight @ (radiance - step * change) ** 2)
        birge = max(residual / max(np.count_nonzero(shown) - 1, 1), 1.0)
        left_over[c] = np.sqrt(birge / (weight @ change**2 + prior))
    return level, left_over


def _mean(values: Array, bins: NDArray[np.intp], count: NDArray[np.intp]) -> Array:
    return np.bincount(bins, values, minlength=_BINS) / np.maximum(count, 1)
