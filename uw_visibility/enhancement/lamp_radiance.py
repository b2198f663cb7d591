# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Radiance recovery under lamps: ρ = (E − scattered) / direct, with limited gain."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.grain import find_grain
from uw_visibility.enhancement.radiance import irradiance_noise
from uw_visibility.images.arrays import Array, RangeMap
from uw_visibility.optics.lamps import RANGES, LightField
from uw_visibility.optics.transfer import encode_table, linear_table

# Gain that is allowed in any noise.
_LEAST_GAIN = math.exp(0.5)
# ln of the least gain, for white four times as bright as the largest pixel value.
_LOWEST = -math.log(4.0)
# Nodes per unit of ln range.
_NODES = 1.0 / math.log(RANGES[1] / RANGES[0])


class LampRestorer:
    """Radiance recovery under lamps with limited gain; see `restore`."""

    def __init__(self, config: EnhancementConfig, transfer: str, workers: Workers) -> None:
        self._config = config
        self._transfer = transfer
        self._workers = workers

    def restore(
        self,
        image: NDArray[np.generic],
        range_map: RangeMap,
        field: LightField,
        noise: Array,
        known: NDArray[np.float32],
    ) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
        """Recover the radiance under lamps: the result is as in even, white light.

        A white patch becomes the largest pixel value, at any place and range. Where there is hardly
        any light, the gain is limited and the image fades to black; a channel whose gain is limited
        is complemented by the mean of all, so that far surfaces have no colour cast. Unknown and
        infinite ranges count as the farthest one of `field`. Where the reliability `known` of the
        range is small, as in open water, the image keeps its light. A channel with NaN in `field`
        stays unchanged. See `Restorer.restore` for parameters and returned values.
        """
        decode = linear_table(self._transfer, image.dtype)
        # Noise at low irradiance, where gains are large.
        error = irradiance_noise(noise, decode, np.full(3, 1.0 / 64.0, np.float32))
        most = np.maximum(self._config.max_noise / np.maximum(error, 1e-9), _LEAST_GAIN)
        brightest = np.nan_to_num(np.exp(field.log_direct)).reshape(3, -1).max(axis=1)
        limits = np.minimum(most, self._config.max_gain / np.clip(brightest, 1e-6, 1.0))
        assessable = np.isfinite(field.log_direct).all(axis=(1, 2, 3))
        assessable &= np.isfinite(field.scattered).all(axis=(1, 2, 3))
        grid = np.array([
            field.rows[1] - field.rows[0], field.columns[1] - field.columns[0]], np.float32)
        # Nodes of direct and scattered light side by side.
        light = np.ascontiguousarray(np.stack(
            (np.nan_to_num(field.log_direct), np.nan_to_num(field.scattered)), axis=-1
        ).transpose(1, 0, 2, 3, 4), np.float32)
        enhanced = np.empty(image.shape, image.dtype)
        limited = np.empty(range_map.shape, np.bool_)
        self._workers.rows(
            _restore, len(image), image, range_map, decode,
            encode_table(self._transfer, image.dtype), light, grid,
            limits.astype(np.float32), assessable, known, find_grain(image, noise, decode),
            enhanced, limited)
        return enhanced, limited


@njit(nogil=True, error_model="numpy")
def _restore(
    start: int, stop: int, image: Any, distance: Any, decode: Any, encode: Any, light: Any,
    grid: Any, limits: Any, assessable: Any, trust: Any, grain: Any, enhanced: Any, limited: Any,
) -> None:
    """Restore a band of rows, plane by plane, so that the compiler vectorises loops.

    `light` is (Y, 3, X, R, 2); `grain` (H, W, 3) is left out, and added again without gain. Of the
    change the part `trust` (H, W) is applied.
    """
    width = image.shape[1]
    last_row, last_column = light.shape[0] - 1, light.shape[2] - 1
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    lowest, logs = np.float32(_LOWEST), np.log(limits)
    nearest, farthest = np.float32(RANGES[0]), np.float32(RANGES[-1])
    last_node = np.float32(light.shape[3] - 1.001)
    top = np.float32(encode.size - 1)
    here = np.empty(light.shape[1:], np.float32)
    column = np.empty(width, np.int32)
    across = np.empty(width, np.float32)
    node = np.empty(width, np.int32)
    along = np.empty(width, np.float32)
    gain = np.empty(width, np.float32)
    value = np.empty((3, width), np.float32)
    kept = np.empty((3, width), np.float32)
    for x in range(width):
        place = min(np.float32(x) / grid[1], np.float32(last_column - 0.001))
        column[x] = index_of(place, 0, max(last_column - 1, 0))
        across[x] = place - np.float32(column[x])
    for y in range(start, stop):
        place = min(np.float32(y) / grid[0], np.float32(last_row - 0.001))
        j = index_of(place, 0, max(last_row - 1, 0))
        share = np.float32(place - j)
        here[:] = (one - share) * light[j] + share * light[j + 1]
        for x in range(width):
            at = distance[y, x]
            # False for NaN.
            inside = at >= zero and at < farthest
            at = max(at, nearest) if inside else farthest
            place = min(np.log(at / nearest) * np.float32(_NODES), last_node)
            node[x] = index_of(place, 0, light.shape[3] - 2)
            along[x] = place - np.float32(node[x])
            limited[y, x] = not inside or trust[y, x] < half
        for c in range(3):
            if not assessable[c]:
                kept[c] = 0
                value[c] = 0
                continue
            plane = here[c]
            for x in range(width):
                i, k, fx, fz = column[x], node[x], across[x], along[x]
                a, b = (one - fx) * (one - fz), fx * (one - fz)
                e, f = (one - fx) * fz, fx * fz
                gain[x] = -(a * plane[i, k, 0] + b * plane[i + 1, k, 0]
                            + e * plane[i, k + 1, 0] + f * plane[i + 1, k + 1, 0])
                value[c, x] = decode[image[y, x, c]] - grain[y, x, c] - (
                    a * plane[i, k, 1] + b * plane[i + 1, k, 1]
                    + e * plane[i, k + 1, 1] + f * plane[i + 1, k + 1, 1])
            for x in range(width):
                excess = max(gain[x] - logs[c], zero)
                kept[c, x] = one / (one + excess + half * excess * excess)
                value[c, x] *= np.exp(min(max(gain[x], lowest), logs[c]))
        for x in range(width):
            total = kept[0, x] + kept[1, x] + kept[2, x] + np.float32(1e-6)
            mean = (kept[0, x] * value[0, x] + kept[1, x] * value[1, x]
                    + kept[2, x] * value[2, x]) / total
            best = max(kept[0, x], max(kept[1, x], kept[2, x]))
            for c in range(3):
                limited[y, x] |= assessable[c] and kept[c, x] < one
                radiance = value[c, x] + (best - kept[c, x]) * mean
                radiance = radiance if radiance > zero else zero
                radiance = radiance if radiance < one else one
                seen = decode[image[y, x, c]] - grain[y, x, c]
                radiance = seen + trust[y, x] * (radiance - seen)
                value[c, x] = (radiance + grain[y, x, c]) * top + half
        for c in range(3):
            for x in range(width):
                enhanced[y, x, c] = (
                    encode[np.uint32(index_of(value[c, x], zero, top))] if assessable[c]
                    else image[y, x, c])
