# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Radiance recovery from an image, its range and the water (eq. 8)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.grain import REACH, find_grain
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, RangeMap
from uw_visibility.images.noise import ROUNDING_VARIANCE, noise_stddev
from uw_visibility.optics.transfer import encode_table, linear_table

# Standard deviation of radiance by the veil's error, as part of white, that halves restoration.
_MOST_VEIL = 0.5
# Gains are clipped at this multiple of `max_gain`, where less than 0.1 % of restoration is left.
_BEYOND = 64.0
# Rows that are restored at once: whole cells of grain, and temporaries that fit a cache.
_BAND = 128
# Limit of noise beside detail, as part of `max_noise`: of 0.1 to 1 the largest with which steps of
# the gain are 2 codes in traced scenes with noise of one code (`judge --pictures`).
_GRAIN = 0.2
# Limit of N by noise: near surfaces get 1 / (1 + this) = 0.8 of restoration in any noise.
_MOST_NOISE = 0.25


class RestorationWater(NamedTuple):
    """Attenuation β (1/m), veil B and scene light W for restoration, one value per channel.

    NaN is not assessable. `veil_stddev` is None if the veil is taken as exact. `balanced` is the
    weight of the camera's own white in W, 0..1. `exposure` is that of the image over that of the
    left one.
    """

    attenuation: Array
    ambient_light: Array
    scene_light: Array
    veil_stddev: Array | None = None
    balanced: float = 0.0
    exposure: Array | float = 1.0


class _Channels(NamedTuple):
    """Attenuation (1/m), veil B, light W and errors of an image's channels, for kernels.

    `exposure`, `noise` and `veil_error` are X, N and V of `_restore`. Infinite noise marks a
    channel that is not assessable, which stays unchanged. The paper's model is W = B.
    """

    attenuation: NDArray[np.float32]
    veil: NDArray[np.float32]
    light: NDArray[np.float32]
    exposure: NDArray[np.float32]
    noise: NDArray[np.float32]
    veil_error: NDArray[np.float32]


class Restorer:
    """Radiance recovery with limited gain (`max_gain` limits exp(βd)); see `restore`.

    `transfer` of input and output is ``"linear"`` or ``"srgb"``.
    """

    def __init__(
        self,
        config: EnhancementConfig | None = None,
        transfer: str = "linear",
        workers: Workers | None = None,
    ) -> None:
        config = config or EnhancementConfig()
        self._max_gain = config.max_gain
        self._max_noise = config.max_noise
        self._transfer = transfer
        self._workers = workers or Workers(1)

    def restore(
        self,
        image: NDArray[np.generic],
        range_map: RangeMap,
        water: RestorationWater,
        noise: Array | None = None,
        known: NDArray[np.float32] | None = None,
    ) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
        """Recover the radiance (eq. 8), less where noise or errors of veil and range are large.

        Radiance is relative to the light on the scene: 1, a white patch, becomes the largest pixel
        value. In each channel the change by restoration is multiplied by the ratio of a Wiener
        filter's gain to exp(βd) (Wiener 1949), which is smaller where noise or an error of the veil
        would be amplified. So open water and pixels of unknown range stay unchanged, and far
        surfaces fade into them. Grain is not amplified, see `uw_visibility.enhancement.grain`.
        A channel that is not assessable stays unchanged.

        `image` is (H, W, 3) or (H, W) of uint8 or uint16; `range_map` (H, W) is along the line of
        sight, m, unknown where NaN, inf or negative; `noise` (3,) or (1,) is the standard deviation
        of the image's noise in code values, measured by default; `known` (H, W) is the reliability
        of the range, 0..1, see `known_range`, 1 by default. Returns the image restored, and where
        an assessable channel is restored by less than half, (H, W) bool.
        """
        if image.shape[:2] != range_map.shape:
            raise InputError(
                f"image of shape {image.shape} does not fit a range map of shape "
                f"{range_map.shape}: give both of the same view")
        planes = image[:, :, np.newaxis] if image.ndim == 2 else image
        decode = linear_table(self._transfer, image.dtype)
        encode = encode_table(self._transfer, image.dtype)
        noise = noise_stddev(image) if noise is None else noise
        channels = self._prepare(water, planes.shape[2], noise, decode)
        enhanced = np.empty(planes.shape, image.dtype)
        limited = np.zeros(range_map.shape, np.bool_)
        height = planes.shape[0]

        def restore_bands(start: int, stop: int) -> None:
            for top in range(start * _BAND, min(stop * _BAND, height), _BAND):
                band = slice(top, min(top + _BAND, height))
                above = max(top - REACH, 0)
                grain = find_grain(planes[above : band.stop + REACH], noise, decode)[top - above :]
                gain, trust = self._gain(
                    range_map[band], None if known is None else known[band], channels.attenuation)
                _restore(
                    planes[band], gain, trust, decode, encode, *channels[1:], grain,
                    enhanced[band], limited[band])

        self._workers.rows(restore_bands, -(-height // _BAND))
        return enhanced.reshape(image.shape), limited

    def _gain(
        self, range_map: RangeMap, known: NDArray[np.float32] | None,
        attenuation: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """exp(βd) of each channel, (C, h, w), limited, and what is known of the range, (h, w)."""
        thickness = np.empty((len(attenuation), *range_map.shape), np.float32)
        trust = np.empty(range_map.shape, np.float32)
        _thickness(
            range_map, trust if known is None else known, known is None, attenuation,
            np.float32(math.log(_BEYOND * self._max_gain)), thickness, trust)
        # OpenCV's exponential is four times as fast as NumPy's.
        for plane in thickness:
            cv2.exp(plane, dst=plane)
        return thickness, trust

    def _prepare(
        self, water: RestorationWater, count: int, noise: Array, decode: NDArray[np.float32]
    ) -> _Channels:
        """Convert the water's state and the errors of restoration to arrays for kernels."""
        attenuation, veil, light = (np.asarray(each, np.float64) for each in water[:3])
        if {attenuation.shape, veil.shape, light.shape} != {(count,)}:
            raise InputError(
                f"water with {attenuation.size} channels does not fit an image with {count}: "
                "give an attenuation and an ambient light for each channel"
            )
        assessable = np.isfinite(attenuation) & (veil > 0) & (light > 0)
        veil, light = np.where(assessable, veil, 1.0), np.where(assessable, light, 1.0)
        # The gain exp(βd) / (1 + N exp(2βd)) is at most 1 / (2 √N).
        error = irradiance_noise(noise / _GRAIN, decode, veil.astype(np.float32)) / light
        least = np.minimum((0.5 * error / self._max_noise) ** 2, _MOST_NOISE)
        least += (0.5 / self._max_gain) ** 2
        stddev = (
            np.zeros(count) if water.veil_stddev is None else np.nan_to_num(water.veil_stddev))
        return _Channels(*(values.astype(np.float32) for values in (
            np.where(assessable, np.maximum(attenuation, 0.0), 0.0), veil, light,
            np.ones(count) * water.exposure,
            np.where(assessable, least, np.inf), (stddev / (_MOST_VEIL * light)) ** 2)))


def irradiance_noise(noise: Array, decode: NDArray[np.float32], veil: NDArray[np.float32]) -> Array:
    """Standard deviation of the irradiance near the veil, where gains are large, (C,).

    `noise` is in code values. Rounding counts as noise, since amplified it shows as bands of false
    colour.
    """
    codes = np.sqrt(noise**2 + ROUNDING_VARIANCE)
    at = np.clip(np.searchsorted(decode, veil), 1, decode.size - 1)
    return np.asarray(codes * (decode[at] - decode[at - 1]), np.float64)


@njit(nogil=True, error_model="numpy")
def _thickness(
    range_map: Any, known: Any, all_known: bool, attenuation: Any, most: Any, thickness: Any,
    trust: Any,
) -> None:
    """Write the optical thickness of each channel, at most `most`, and what is known of the range.

    `known` is not read if `all_known`.
    """
    for y in range(range_map.shape[0]):
        for x in range(range_map.shape[1]):
            d = range_map[y, x]
            ranged = (d >= 0) & (d < np.inf)
            share = np.float32(1) if all_known else known[y, x]
            trust[y, x] = share if ranged else np.float32(0)
        for c in range(attenuation.size):
            for x in range(range_map.shape[1]):
                d = range_map[y, x]
                product = attenuation[c] * (d if (d >= 0) & (d < np.inf) else np.float32(0))
                thickness[c, y, x] = product if product < most else most


@njit(nogil=True, error_model="numpy")
def _restore(
    image: Any, gain: Any, trust: Any, decode: Any, encode: Any, veil: Any,
    light: Any, exposure: Any, noise: Any, veil_error: Any, grain: Any, enhanced: Any, limited: Any,
) -> None:
    """Restore rows: E/X + k (ρ - E/X), ρ = B/W + (E/W - B/W) exp(βd) within 0..1.

    X is `exposure`, `gain` (C, H, W) is exp(βd), and k is `trust` over
    1 + N exp(2βd) + V (exp(βd) - 1)², with `noise` N and `veil_error` V. A channel with infinite N
    stays unchanged.
    A channel moves by the largest k minus its own towards the channels' k-weighted mean radiance:
    otherwise the most attenuated channel would leave a colour cast on far surfaces.
    E is the image without its `grain` (H, W, C), which is added again without gain.

    Rows are processed plane by plane in small buffers: the compiler vectorises loops over
    contiguous floats without lookups, branches or calls.
    """
    width, count = image.shape[1], image.shape[2]
    seen = np.empty((count, width), np.float32)
    left_out = np.empty((count, width), np.float32)
    restored = np.empty((count, width), np.float32)
    part = np.empty((count, width), np.float32)
    code = np.empty((count, width), np.int32)
    total = np.empty(width, np.float32)
    mean = np.empty(width, np.float32)
    best = np.empty(width, np.float32)
    last = encode.size - 1
    top = np.float32(last)
    half = np.float32(0.5)
    one = np.float32(1)
    zero = np.float32(0)
    for y in range(image.shape[0]):
        for c in range(count):
            for x in range(width):
                seen[c, x] = decode[image[y, x, c]]
                left_out[c, x] = grain[y, x, c]
        total[:] = np.float32(1e-6)
        mean[:] = 0
        best[:] = 0
        for c in range(count):
            if not noise[c] < np.inf:
                continue
            inverse = one / light[c]
            water = veil[c] / light[c]
            for x in range(width):
                seen[c, x] -= left_out[c, x]
                e = gain[c, y, x]
                radiance = water + (seen[c, x] * inverse - water) * e
                radiance = radiance if radiance > zero else zero
                radiance = radiance if radiance < one else one
                k = trust[y, x] / (one + noise[c] * e * e + veil_error[c] * (e - one) * (e - one))
                restored[c, x] = radiance
                part[c, x] = k
                total[x] += k
                mean[x] += k * radiance
                best[x] = best[x] if best[x] > k else k
        for x in range(width):
            mean[x] /= total[x]
        for c in range(count):
            plane = seen[c]
            if noise[c] < np.inf:
                inverse = one / exposure[c]
                for x in range(width):
                    k = part[c, x]
                    plane[x] *= inverse
                    limited[y, x] |= k < half
                    plane[x] += (
                        k * (restored[c, x] - plane[x]) + (best[x] - k) * (mean[x] - plane[x]))
                    plane[x] += left_out[c, x] * inverse
            for x in range(width):
                code[c, x] = index_of(plane[x] * top + half, 0, last)
        for c in range(count):
            for x in range(width):
                enhanced[y, x, c] = encode[np.uint32(code[c, x])]
