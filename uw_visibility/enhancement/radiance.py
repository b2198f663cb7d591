# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Radiance recovery from an image, its range and the water (eq. 8)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement import radiance_kernels as kernels
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, RangeMap
from uw_visibility.images.noise import ROUNDING_VARIANCE, noise_stddev
from uw_visibility.optics.light_model import Water, scene_light_of
from uw_visibility.optics.transfer import encode_table, linear_table

# Attenuation, 1/m, below which no range brings a channel to its limit.
_LEAST_ATTENUATION = 1e-9
# However noisy an image and unsure its veil, this much optical thickness is made up for.
_LEAST_THICKNESS = 0.5
# Largest standard deviation of radiance by that of the veil, as part of white.
_MOST_VEIL = 0.5


@dataclass(frozen=True)
class Channels:
    """Attenuation (1/m), veil B, light W and limits of an image's channels, as kernels take them.

    `limits` is the largest optical thickness βd. A channel that is not assessable stays as it is:
    attenuation and limit 0, veil and light 1. The paper's model is W = B.
    """

    attenuation: NDArray[np.float32]
    veil: NDArray[np.float32]
    light: NDArray[np.float32]
    limits: NDArray[np.float32]
    assessable: NDArray[np.bool_]

    def limited_by_noise(self, noise: Array, largest: float) -> Channels:
        """Lower the limits so that restored noise, σ exp(βd) / W, stays below ``largest``."""
        return self._limited(largest * self.light / np.maximum(noise, 1e-9))

    def limited_by_veil(self, stddev: Array, largest: float) -> Channels:
        """Lower the limits so that the veil's error, σ (exp(βd) - 1) / W, stays below ``largest``.

        Where β and range are large, a veil that is 2 % off makes half of white of a dark wall.
        """
        return self._limited(1.0 + largest * self.light / np.maximum(stddev, 1e-9))

    def _limited(self, gain: Array) -> Channels:
        """Lower the limits to a gain exp(βd), but for the least thickness."""
        thickness = np.log(np.maximum(gain, math.exp(_LEAST_THICKNESS)))
        limits = np.where(self.assessable, np.minimum(self.limits, thickness), 0.0)
        return replace(self, limits=limits.astype(np.float32))

    def farthest(self) -> np.float32:
        """Range (m) up to which no channel's gain is limited."""
        steep = self.assessable & (self.attenuation > _LEAST_ATTENUATION)
        if not steep.any():
            return np.float32(np.inf)
        return np.float32((self.limits[steep] / self.attenuation[steep]).min())


class Restorer:
    """Radiance recovery as images of limited gain (`max_gain` limits exp(βd)); see `restore`.

    `transfer` is ``"linear"`` or ``"srgb"``: how pixel values follow light, in and out.
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
        water: Water,
        noise: Array | None = None,
    ) -> tuple[NDArray[np.generic], NDArray[np.bool_]]:
        """Radiance recovery as an image, its gain limited (eq. 8).

        Radiance is relative to the light on the scene: 1, a white patch, becomes the
        largest pixel value, and open water B / W of it. Where the range is unknown
        (NaN, inf or negative), the pixel is taken as far: it gets the largest
        gain. A channel that is not assessable is handed on as it is.

        Parameters
        ----------
        image : (H, W, 3) or (H, W) ndarray of uint8 or uint16
            Pixel values.
        range_map : (H, W) float32 ndarray
            Range along the line of sight, m.
        water : Water
            `attenuation`, `ambient_light` (the veil B) and, where it is another one,
            `scene_light` (W), one value a channel; `veil_stddev`, where the veil is not exact.
        noise : (3,) or (1,) float64 ndarray, optional
            Standard deviation of the image's noise in code values; measured by default.

        Returns
        -------
        enhanced : ndarray
            Of the image's shape and type.
        limited : (H, W) bool ndarray
            Where the range is unknown, or the gain of a channel was limited: to `max_gain`, or to
            what
            keeps noise below `max_noise` and an error of the veil below half of white.
        """
        planes = as_channels(image, range_map)
        decode = linear_table(self._transfer, image.dtype)
        channels = prepare(water, planes.shape[2], self._max_gain)
        noise = noise_stddev(image) if noise is None else noise
        channels = channels.limited_by_noise(
            irradiance_noise(noise, decode, channels.veil), self._max_noise
        )
        veil_stddev = getattr(water, "veil_stddev", None)
        if veil_stddev is not None:
            channels = channels.limited_by_veil(veil_stddev, _MOST_VEIL)
        enhanced = np.empty(planes.shape, image.dtype)
        limited = np.empty(range_map.shape, np.bool_)
        self._workers.rows(
            kernels.restore, planes.shape[0], planes, range_map,
            decode, encode_table(self._transfer, image.dtype), channels.attenuation,
            channels.veil, channels.light, channels.limits, channels.farthest(), enhanced, limited,
        )
        if not channels.assessable.any():
            limited[:] = False
        return enhanced.reshape(image.shape), limited


def prepare(water: Water, count: int, max_gain: float) -> Channels:
    """Convert a water's state to the form that kernels take."""
    attenuation = np.atleast_1d(np.asarray(water.attenuation, dtype=np.float64))
    veil = np.atleast_1d(np.asarray(water.ambient_light, dtype=np.float64))
    light = np.atleast_1d(scene_light_of(water))
    if {attenuation.shape, veil.shape, light.shape} != {(count,)}:
        raise InputError(
            f"water with {attenuation.size} channels does not fit an image with {count}: "
            "give an attenuation and an ambient light for each channel"
        )
    assessable = np.isfinite(attenuation) & (veil > 0) & (light > 0)
    return Channels(
        attenuation=np.where(assessable, np.maximum(attenuation, 0.0), 0.0).astype(np.float32),
        veil=np.where(assessable, veil, 1.0).astype(np.float32),
        light=np.where(assessable, light, 1.0).astype(np.float32),
        limits=np.where(assessable, max(math.log(max_gain), 1e-6), 0.0).astype(np.float32),
        assessable=assessable,
    )


def irradiance_noise(noise: Array, decode: NDArray[np.float32], veil: NDArray[np.float32]) -> Array:
    """Standard deviation of the irradiance near the veil, where gains are large, (C,).

    `noise` is in code values. Rounding counts as noise: amplified, its steps show as bands of
    false colour.
    """
    codes = np.sqrt(noise**2 + ROUNDING_VARIANCE)
    at = np.clip(np.searchsorted(decode, veil), 1, decode.size - 1)
    return np.asarray(codes * (decode[at] - decode[at - 1]), np.float64)


def as_channels(image: NDArray[np.generic], range_map: RangeMap) -> NDArray[np.generic]:
    """View an image as (H, W, C), after a check that it fits its range."""
    if image.shape[:2] != range_map.shape:
        raise InputError(
            f"image of shape {image.shape} does not fit a range map of shape {range_map.shape}: "
            "give both of the same view"
        )
    return image[:, :, np.newaxis] if image.ndim == 2 else image
