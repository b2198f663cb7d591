# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A restored grey image made for matching: as little noise as the water allows.

Restoration amplifies the noise σ of channel c by exp(βd) / I∞ = 1 / t, so the
mean of the channels' radiances with the least noise weighs them with t² / σ².
With eq. 8 it is 1 + Σ (E - I∞) t / σ² over Σ t² / σ², and its variance is one
over the latter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.config import EnhancementConfig
from uw_visibility.enhancement import radiance_kernels as kernels
from uw_visibility.enhancement.radiance import Channels, Water, as_channels, prepare
from uw_visibility.errors import InputError
from uw_visibility.parallel import Workers
from uw_visibility.water.transfer import linear_table

# Noise (grey levels) at which smoothed and plain value count the same.
EVEN_NOISE = 3.0


class MatchingGrey:
    """Noise-optimal grey images for the matcher, for one size of image.

    Holds its buffer: one call at a time.

    Parameters
    ----------
    shape : tuple of int
        Height and width.
    config : EnhancementConfig
        `max_gain` limits the gain, `sensor_noise` is the camera's noise.
    transfer : str
        ``"linear"`` or ``"srgb"``; the result is linear in radiance.
    workers : Workers, optional
        Threads; one by default.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        config: EnhancementConfig | None = None,
        transfer: str = "linear",
        workers: Workers | None = None,
    ) -> None:
        config = config or EnhancementConfig()
        self._max_gain = config.max_gain
        self._sensor_noise = config.sensor_noise
        self._transfer = transfer
        self._workers = workers or Workers(1)
        self._grey = np.empty(shape, np.float32)

    def compute(
        self,
        image: NDArray[np.generic],
        range_map: NDArray[np.float32],
        water: Water,
        smooth: bool = False,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Restore an image as one grey channel.

        Parameters
        ----------
        image : (H, W, 3) or (H, W) ndarray of uint8 or uint16
            The raw image.
        range_map : (H, W) float32 ndarray
            Range, m; unknown is taken as far, like in `Restorer.restore`.
        water : WaterEstimate
            One attenuation and ambient light for each channel; channels that
            are not assessable are left out.
        smooth : bool
            Smooth each pixel the more, the more its noise was amplified. For matchers
            that compare single pixels; those that add costs over an area do better
            without.

        Returns
        -------
        grey : (H, W) uint8 ndarray
            Radiance, 255 for white.
        noise : (H, W) float32 ndarray
            Its standard deviation, grey levels.

        Raises
        ------
        InputError
            If shapes do not fit or no channel is assessable.
        """
        planes = as_channels(image, range_map)
        channels = prepare(water, planes.shape[2], self._max_gain)
        decode = linear_table(self._transfer, image.dtype)
        precision = self._precision(channels, decode)
        grey = np.empty(range_map.shape, np.uint8)
        noise = np.empty(range_map.shape, np.float32)
        self._workers.rows(
            kernels.mix, planes.shape[0], planes, range_map, decode,
            channels.attenuation, channels.ambient, channels.limits, precision, self._grey, noise,
        )
        even = np.float32(EVEN_NOISE**2 if smooth else np.inf)
        self._workers.rows(kernels.smooth, planes.shape[0], self._grey, even, grey, noise)
        return grey, noise

    def _precision(
        self, channels: Channels, decode: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """1 / σ² of each channel's irradiance near the ambient light; 0 = not assessable.

        Taken there since the noise of far pixels is what counts, and far
        pixels look like the ambient light.
        """
        if not channels.assessable.any():
            raise InputError("no channel of the water is assessable: match the raw images")
        last = decode.size - 1
        code = np.clip(np.searchsorted(decode, channels.ambient), 1, last - 1)
        per_code = (decode[code + 1] - decode[code - 1]) / 2
        sigma = per_code * (self._sensor_noise * last / 255)
        return np.where(channels.assessable, 1 / sigma**2, 0.0).astype(np.float32)
