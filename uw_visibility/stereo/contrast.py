# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Contrast normalisation for matching: grey images and the gain that undoes attenuation.

Water reduces contrast by the factor exp(-attenuation x range) and adds a veil that varies with
range only. The matcher compares gradients, so that contrast is restored by multiplying gradients.
The veil is not subtracted, errors of the coarse range make no edges, as they would in a restored
image, and nothing is rounded to 8 bits before the gradients are taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array, Image, RangeMap
from uw_visibility.optics.lamps import RANGES
from uw_visibility.optics.light_model import transmission
from uw_visibility.stereo import denoising
from uw_visibility.stereo.denoising import ROUNDING

# ITU-R BT.601 luma.
LUMA = (0.299, 0.587, 0.114)
# Levels of the grey image per 8-bit level of the input.
_FINE = 256.0
# Part of the darkest and of the brightest pixels that the raw contrast leaves out.
_OUTSIDE = 0.005
# Largest gain, 8-bit levels: beyond it gradients are quantisation and noise. Means over squares of
# pixels have less of both, and may have a larger gain.
_MAX_GAIN = 16.0
# Gain at a typical range under lamps, over the gain of a raw image.
_FAR_GAIN = 2.0
# Restored contrast of white against black, 8-bit levels. It is more than 255, since weak gradients
# matter more to the matcher than strong ones, which clip in the descriptors.
_FULL_CONTRAST = 1.5 * 255.0
# Entries of the table of gain over range, and its largest range over the typical one.
_TABLE, _MOST_TYPICAL = 512, 16.0


class ContrastNormalizer:
    """Grey image and gain of one view, in memory that is allocated once.

    `shape` is height and width of the images, px; a pixel is the mean of `averaged` by `averaged`
    pixels of the camera.
    """

    def __init__(self, shape: tuple[int, int], averaged: int = 1) -> None:
        self._averaged = averaged
        # (H, W), 256 times the 8-bit level.
        self.grey: NDArray[np.uint16] = np.empty(shape, np.uint16)
        # (H, W), 8-bit levels of normalised contrast per unit of `grey`.
        self.gain: NDArray[np.float32] = np.empty(shape, np.float32)
        # The view's pixels, from which the rest was computed.
        self.image: Image = np.empty((0, 0), np.uint8)
        # Noise after restoration, at the median gain and before `grey` was smoothed, in 8-bit
        # levels of normalised contrast.
        self.noise = 0.0
        self._noise_of_grey = 0.0

    def stretch(self, image: Image, workers: Workers, noise: Array) -> None:
        """Set `grey` to a raw image's luma, and `gain` to one value that stretches its contrast.

        `noise` is the standard deviation of each channel's noise, in code values. The luma of the
        image, RGB or grey, is smoothed according to its restored noise.
        """
        self._mix(image, LUMA, workers)
        self.gain[:] = self._raw_gain(image)
        self._smooth(image, LUMA, workers, noise)

    def restore(
        self,
        image: Image,
        range_map: RangeMap,
        attenuation: Array,
        ambient_light: Array,
        workers: Workers,
        noise: Array,
    ) -> None:
        """Set `grey` to the mix of channels with least noise, and `gain` to undo attenuation.

        A channel's contrast is that of the scene times I exp(-attenuation x d). Weights
        proportional to it, at a typical range, minimise the noise of the restored mix. They are the
        same for all pixels, since varying weights would make edges.

        `range_map` (h, w), m, has the size of the image, RGB, or a whole multiple or fraction of
        it; where it is unknown (not finite), the gain is that of the farthest range. Channels with
        NaN in `attenuation` (3,), 1/m, or `ambient_light` (3,), 0..1, are left out; one is known at
        least. See `stretch`.
        """
        attenuation, ambient_light = _known(attenuation, ambient_light)
        typical, farthest = _typical_and_farthest(range_map)
        weights = _weights_at(typical, attenuation, ambient_light)
        self._mix(image, weights, workers)
        ranges = np.linspace(0.0, farthest, _TABLE)[:, None]
        contrast = np.sum(weights * ambient_light * transmission(attenuation, ranges), axis=1)
        # Limits the gain; far away the contrast may even be 0.
        contrast = np.maximum(contrast, _FULL_CONTRAST / (255.0 * self._max_gain(image)))
        self._set_gain(_FULL_CONTRAST / (255.0 * contrast), farthest, range_map)
        self._smooth(image, weights, workers, noise)

    def restore_lit(
        self,
        image: Image,
        range_map: RangeMap,
        direct: Array,
        workers: Workers,
        noise: Array,
    ) -> None:
        """Set `grey` to the mix of channels with least noise, and `gain` to undo lamps' falloff.

        `direct` (3, R) is the light of surfaces at `RANGES` that reaches the camera, in any unit:
        at a typical range contrast is stretched `_FAR_GAIN` times as much as that of a
        raw image. See `restore`.
        """
        typical, farthest = _typical_and_farthest(range_map)
        weights = np.array([np.interp(typical, RANGES, channel) for channel in direct])
        weights /= weights.sum()
        self._mix(image, weights, workers)
        steps = np.linspace(0.0, farthest, _TABLE)
        falloff = np.exp(np.interp(steps, RANGES, np.log(weights @ direct)))
        falloff /= np.interp(typical, steps, falloff)
        gain = self._raw_gain(image) * np.maximum(_FAR_GAIN / falloff, 1.0)
        self._set_gain(np.minimum(_FINE * gain, self._max_gain(image)), farthest, range_map)
        self._smooth(image, weights, workers, noise)

    def _max_gain(self, image: Image) -> float:
        return _MAX_GAIN if image.dtype == np.uint8 else _MAX_GAIN * self._averaged

    def _raw_gain(self, image: Image) -> float:
        """Gain that stretches the contrast of the grey image, limited because of noise."""
        # Every fourth pixel of every fourth row is enough.
        sample = self.grey[::4, ::4]
        high = np.percentile(sample, 100 * (1 - _OUTSIDE))
        # Black is what a rectified image does not show, a housing's edge, or a dead part.
        lit = sample[sample > 0]
        low = np.percentile(lit, 100 * _OUTSIDE) if lit.size else high
        return float(min(255.0 / max(high - low, 1.0), self._max_gain(image) / _FINE))

    def _set_gain(self, table: Array, farthest: float, range_map: RangeMap) -> None:
        """Look up each pixel's gain in a table over equal steps of range, from 0 to `farthest`."""
        finer = range_map.shape[1] // self.gain.shape[1]
        if finer > 1:
            # The range map is finer than the image, which was reduced for matching.
            range_map = range_map[finer // 2::finer, finer // 2::finer]
        # Ranges that are not finite, or overflow, take an end of the table.
        with np.errstate(over="ignore", invalid="ignore"):
            # fmin replaces NaN by the last entry.
            step = np.fmin(range_map * np.float32((_TABLE - 1) / farthest), np.float32(_TABLE - 1))
            place = step.astype(np.intp)
        gain = np.take((table / _FINE).astype(np.float32), place, mode="clip")
        # Pixels at the border that are in no whole cell take their neighbours' gain.
        factor = self.gain.shape[1] // gain.shape[1]
        rows, columns = (
            np.minimum(np.arange(n) // factor, m - 1)
            for n, m in zip(self.gain.shape, gain.shape, strict=True))
        np.take(gain[rows], columns, axis=1, out=self.gain)

    def _smooth(
        self, image: Image, weights: Sequence[float] | Array, workers: Workers, noise: Array
    ) -> None:
        """Smooth the mix of channels according to its restored noise, unless it is rounding."""
        self.image = image
        # Averages of rounded pixels have smaller rounding errors.
        scale, averaged = (_FINE, 1) if image.dtype == np.uint8 else (1.0, self._averaged)
        mixed = scale * mixed_noise(image, noise, weights)
        self._noise_of_grey = mixed if mixed > ROUNDING * _FINE / averaged else 0.0
        self.noise = denoising.smooth(self.grey, self.gain, self._noise_of_grey, workers)

    def noise_gradient(self, step: int) -> Array:
        """Standard deviation of Sobel responses to noise, at every `step` pixels.

        It is 0 if the image was not smoothed, since it has hardly any noise.
        """
        gain = self.gain[step // 2 :: step, step // 2 :: step]
        if self.noise <= denoising.LEAST_NOISE:
            return np.zeros(gain.shape)
        return denoising.noise_gradient(self._noise_of_grey * gain)

    def _mix(self, image: Image, weights: Sequence[float] | Array, workers: Workers) -> None:
        scale = _FINE if image.dtype == np.uint8 else 1.0
        red, green, blue = (np.float32(scale * weight) for weight in weights)
        if image.ndim == 3:
            workers.rows(_mix, image.shape[0], image, red, green, blue, self.grey)
        else:
            np.multiply(image, np.uint16(scale), out=self.grey, casting="unsafe")


def mixed_noise(image: Image, noise: Array, weights: Sequence[float] | Array) -> float:
    """Standard deviation of the noise of the channels' weighted sum, code values."""
    return float(noise[0] if image.ndim == 2 else np.hypot.reduce(np.asarray(weights) * noise))


def least_noise_weights(range_map: RangeMap, attenuation: Array, ambient_light: Array) -> Array:
    """Weights of the channels that `ContrastNormalizer.restore` uses, of sum 1."""
    typical, _ = _typical_and_farthest(range_map)
    return _weights_at(typical, *_known(attenuation, ambient_light))


def _weights_at(distance: float, attenuation: Array, ambient_light: Array) -> Array:
    weights = ambient_light * transmission(attenuation, distance)
    total = weights.sum()
    if total == 0.0:
        # Transmission underflows at this range: only the least attenuated channel counts.
        lit = ambient_light > 0.0
        weights = np.where(lit & (attenuation <= attenuation[lit].min()), ambient_light, 0.0)
        total = weights.sum()
    return np.asarray(weights / total)


def _known(attenuation: Array, ambient_light: Array) -> tuple[Array, Array]:
    """Attenuation and ambient light, 0 in both where either is unknown."""
    known = np.isfinite(attenuation) & np.isfinite(ambient_light)
    return np.where(known, attenuation, 0.0), np.where(known, ambient_light, 0.0)


def _typical_and_farthest(range_map: RangeMap) -> tuple[float, float]:
    sample = range_map[::4, ::4]
    sample = sample[np.isfinite(sample)]
    typical, farthest = np.percentile(sample, (50, 100)) if sample.size else (1.0, 1.0)
    # A single disparity near 0 is kilometres away; all others would share the table's first step.
    return float(typical), float(min(farthest, _MOST_TYPICAL * typical))


@njit(nogil=True)
def _mix(start: int, stop: int, image: Any, red: Any, green: Any, blue: Any, grey: Any) -> None:
    half = np.float32(0.5)
    for y in range(start, stop):
        for x in range(image.shape[1]):
            grey[y, x] = np.uint16(
                red * np.float32(image[y, x, 0]) + green * np.float32(image[y, x, 1])
                + blue * np.float32(image[y, x, 2]) + half
            )
