# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Radiance recovery under lamps: ρ = (E − scattered) / direct, the gain limited."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.radiance import as_channels, irradiance_noise
from uw_visibility.errors import InputError
from uw_visibility.images.noise import noise_stddev
from uw_visibility.optics.lamps import RANGES, LightField
from uw_visibility.optics.transfer import encode_table, linear_table

# However noisy an image is, a white patch of so little light is made white.
_LEAST_GAIN = math.exp(0.5)


class LampRestorer:
    """Radiance recovery under lamps as images of limited gain; see `restore`.

    Parameters
    ----------
    config : EnhancementConfig
        `max_gain` limits the gain over that of the brightest lit place.
    transfer : str
        ``"linear"`` or ``"srgb"``.
    workers : Workers
        Threads.
    """

    def __init__(self, config: EnhancementConfig, transfer: str, workers: Workers) -> None:
        self._config = config
        self._transfer = transfer
        self._workers = workers

    def restore(
        self,
        image: NDArray[np.generic],
        range_map: NDArray[np.float32],
        field: LightField,
        noise: NDArray[np.float64] | None = None,
    ) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
        """Radiance recovery under lamps: even light over image and range, as under white light.

        A white patch becomes the largest pixel value, wherever it is. Where hardly any
        light is, the gain is limited and what is seen fades to black; a channel whose gain
        is limited takes what it lacks from the others, so that the far has no colour of its
        own. A range that is unknown, or infinite, is taken as far.

        Parameters
        ----------
        image : (H, W, 3) ndarray of uint8 or uint16
            Pixel values.
        range_map : (H, W) float32 ndarray
            Range along the line of sight, m.
        field : LightField
            Light over image and range; a channel with NaN is handed on as it is.
        noise : (3,) float64 ndarray, optional
            Standard deviation of the image's noise in code values; measured by default.

        Returns
        -------
        enhanced : ndarray
            Of the image's shape and type.
        limited : (H, W) bool ndarray
            Where the gain of a channel was limited, or the range is unknown.

        Raises
        ------
        InputError
            If shapes or number of channels do not fit.
        """
        planes = as_channels(image, range_map)
        if planes.shape[2] != 3:
            raise InputError("light of lamps restores images of three channels: give RGB")
        decode = linear_table(self._transfer, image.dtype)
        noise = noise_stddev(image) if noise is None else noise
        # Noise in the dark, where gains are large.
        error = irradiance_noise(noise, decode, np.full(3, 1.0 / 64.0, np.float32))
        most = np.maximum(self._config.max_noise / np.maximum(error, 1e-9), _LEAST_GAIN)
        brightest = np.nan_to_num(np.exp(field.log_direct)).reshape(3, -1).max(axis=1)
        limits = np.minimum(most, self._config.max_gain / np.clip(brightest, 1e-6, 1.0))
        known = np.isfinite(field.log_direct).all(axis=(1, 2, 3))
        known &= np.isfinite(field.scattered).all(axis=(1, 2, 3))
        grid = np.array([
            field.rows[1] - field.rows[0], field.columns[1] - field.columns[0],
            math.log(RANGES[0]), 1.0 / math.log(RANGES[1] / RANGES[0])], np.float32)
        # Nodes of direct and scattered light side by side.
        light = np.ascontiguousarray(np.stack(
            (np.nan_to_num(field.log_direct), np.nan_to_num(field.scattered)), axis=-1
        ).transpose(1, 0, 2, 3, 4), np.float32)
        enhanced = np.empty(planes.shape, image.dtype)
        limited = np.empty(range_map.shape, np.bool_)
        self._workers.rows(
            _restore, planes.shape[0], planes, range_map, decode,
            encode_table(self._transfer, image.dtype), light, grid, limits.astype(np.float32),
            known, enhanced, limited)
        return enhanced.reshape(image.shape), limited


@njit(nogil=True, error_model="numpy", fastmath=True)
def _restore(
    start: int, stop: int, image: Any, distance: Any, decode: Any, encode: Any, light: Any,
    grid: Any, limits: Any, known: Any, enhanced: Any, limited: Any,
) -> None:
    """Restore a band of rows; `light` is (Y, 3, X, R, 2)."""
    width = image.shape[1]
    last_row, last_column = light.shape[0] - 1, light.shape[2] - 1
    last = np.float32(light.shape[3] - 1.001)
    row = np.empty(light.shape[1:], np.float32)
    # (R, 3, 2) of a column is read together.
    here = np.empty((light.shape[2], light.shape[3], 3, 2), np.float32)
    top = np.float32(encode.size - 1)
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    value = np.empty(3, np.float32)
    kept = np.empty(3, np.float32)
    for y in range(start, stop):
        place = min(np.float32(y) / grid[0], np.float32(last_row - 0.001))
        j = int(place)
        share = np.float32(place - j)
        row[:] = (one - share) * light[j] + share * light[j + 1]
        for c in range(3):
            for x in range(light.shape[2]):
                for k in range(light.shape[3]):
                    here[x, k, c, 0] = row[c, x, k, 0]
                    here[x, k, c, 1] = row[c, x, k, 1]
        for x in range(width):
            d = distance[y, x]
            unknown = not (d > zero and d < np.float32(1e6))
            z = last if unknown else (np.log(d) - grid[2]) * grid[3]
            z = min(max(z, zero), last)
            k = int(z)
            fz = np.float32(z - k)
            across = min(np.float32(x) / grid[1], np.float32(last_column - 0.001))
            i = int(across)
            fx = np.float32(across - i)
            a, b = (one - fx) * (one - fz), fx * (one - fz)
            e, f = (one - fx) * fz, fx * fz
            full = False
            total, mean, best = np.float32(1e-6), zero, zero
            for c in range(3):
                if not known[c]:
                    continue
                direct = (
                    a * here[i, k, c, 0] + b * here[i + 1, k, c, 0]
                    + e * here[i, k + 1, c, 0] + f * here[i + 1, k + 1, c, 0])
                scattered = (
                    a * here[i, k, c, 1] + b * here[i + 1, k, c, 1]
                    + e * here[i, k + 1, c, 1] + f * here[i + 1, k + 1, c, 1])
                gain = np.exp(min(-direct, np.float32(60)))
                ratio = limits[c] / gain
                kept[c] = min(ratio, one)
                full |= ratio < one
                value[c] = (decode[image[y, x, c]] - scattered) * min(gain, limits[c])
                total += kept[c]
                mean += value[c]
                best = max(best, kept[c])
            mean = mean / total
            limited[y, x] = full or unknown
            for c in range(3):
                if known[c]:
                    radiance = value[c] + (best - kept[c]) * mean
                    radiance = min(max(radiance, zero), one)
                    enhanced[y, x, c] = encode[int(radiance * top + half)]
                else:
                    enhanced[y, x, c] = image[y, x, c]
