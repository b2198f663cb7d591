# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Airlight prior of the matcher: bounds of range by brightness.

A pixel is at least as bright as the airlight in front of what it shows, which is
the light model (eq. 1) with a radiance that cannot be negative:
E >= I (1 - exp(-attenuation x d)). So its brightness bounds its range from above,
whatever its texture: dark pixels cannot be far. Within the bound, a dark surface is likelier
than a bright one: a pixel as bright as ambient light is seldom a white thing nearby.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array, Image, Points
from uw_visibility.images.noise import noise_stddev
from uw_visibility.optics.light_model import UncertainWater, veil_thickness
from uw_visibility.optics.transfer import linear_table
from uw_visibility.stereo.rig import StereoRig

# Standard deviations that the bound is moved out by: of the pixel's noise, and of the
# water, whose error is the same at all pixels and is mostly taken up by the matches.
_NOISE_SIGMAS = 3.0
_WATER_SIGMAS = 1.0
# Deviation of rounding, code values.
_ROUNDING = 0.29
# Water that takes less than this, 1/m, has no airlight to speak of.
_LEAST_ATTENUATION = 0.02
# Code values are looked up in at most this many steps.
_TABLE = 1024
# Matches that the bound is fitted to, what part of them it has to hold for, percent, and
# the margin that is added.
_MOST_POINTS = 1000
_FEWEST_POINTS = 30
_HELD_PART = 99.0
_MARGIN = 1.05
# The bound is narrowed and widened up to this; beyond it, the water is not understood.
_LEAST_WIDENING = 0.85
_MOST_WIDENING = 1.5
# Relative standard deviation of the attenuation at which the prior counts half.
_DOUBT = 0.1
# The least disparity above that of infinity that range is made from, px.
_LEAST_DISPARITY = 0.5


@dataclass(frozen=True)
class AirlightPrior:
    """Airlight prior: bounds of optical thickness, in the mean of the channels."""

    # (H, W) float32, largest optical thickness in front of each pixel of the left view, several
    # standard deviations added; inf without bound
    farthest: NDArray[np.float32]
    thickness: NDArray[np.float32]  # (D,) float32, optical thickness at each disparity, falling
    trust: float  # 0..1, how well the water is known: the weight of what lies within the bounds


class Airlight:
    """Airlight bounds of images of one size, for a number of disparities, from 0 on."""

    def __init__(
        self,
        shape: tuple[int, int],
        rig: StereoRig,
        disparities: int,
        transfer: str,
        workers: Workers,
    ) -> None:
        self._transfer = transfer
        self._workers = workers
        self._rays = rig.ray_lengths(shape)
        disparity = np.maximum(np.arange(disparities) - rig.offset, _LEAST_DISPARITY)
        self._depth = rig.focal_length * rig.baseline / disparity
        self._farthest = np.empty(shape, np.float32)

    def prior(
        self, image: Image, water: UncertainWater, points: Points, noise: Array | None = None
    ) -> AirlightPrior | None:
        """Bound the range of each pixel of an RGB image.

        image: (H, W, 3) of uint8 or uint16, left view.
        water: attenuation and ambient light, with their covariance.
        points: (N, 3) float32, column, row and disparity, px, of matches that the bound is scaled
            to hold for, narrowly.
        noise: (3,) float64, standard deviation of the image's noise in code values; measured by
            default.
        Returns valid until the next call. None where the water is unknown, or explains the matches
        too badly.
        """
        noise = noise_stddev(image) if noise is None else noise
        table = _range_table(image.dtype, noise, water, self._transfer)
        bounding = np.isfinite(table).any(axis=1)
        if not bounding.any():
            return None
        attenuation = float(np.mean(water.attenuation[bounding]))
        shift = max(int(np.iinfo(image.dtype).max + 1) // _TABLE, 1).bit_length() - 1
        self._workers.rows(
            _look_up, image.shape[0], image, (attenuation * table).astype(np.float32), shift,
            self._rays, self._farthest,
        )
        thickness = attenuation * self._depth
        widening = self._widening(thickness, points)
        if widening > _MOST_WIDENING:
            return None
        doubt = np.mean(water.attenuation_stddev[bounding] / water.attenuation[bounding])
        trust = 1.0 / (1.0 + (float(doubt) / _DOUBT) ** 4)
        return AirlightPrior(self._farthest, (thickness / widening).astype(np.float32), trust)

    def _widening(self, thickness: Array, points: Points) -> float:
        """Factor by which the bound must grow, or may shrink, to hold for the matches."""
        chosen = points[:: -(-len(points) // _MOST_POINTS) or 1]
        if len(chosen) < _FEWEST_POINTS:
            return 1.0
        u, v = chosen[:, 0].astype(np.intp), chosen[:, 1].astype(np.intp)
        at = np.clip(np.round(chosen[:, 2]).astype(np.intp), 0, thickness.size - 1)
        needed = _MARGIN * np.percentile(thickness[at] / self._farthest[v, u], _HELD_PART)
        return max(float(needed), _LEAST_WIDENING)


def _range_table(dtype: np.dtype[Any], noise: Array, water: UncertainWater, transfer: str) -> Array:
    """Farthest range of each code value, ``(3, N)``, m; inf without bound."""
    decode = linear_table(transfer, dtype).astype(np.float64)
    step = max(decode.size // _TABLE, 1)
    # The brightest of the codes that share an entry bounds the least.
    light = decode[step - 1 :: step]
    slope = np.gradient(light) / step
    noise = np.hypot(noise, _ROUNDING)
    table = np.full((3, light.size), np.inf)
    for channel in range(3):
        attenuation, ambient = water.attenuation[channel], water.ambient_light[channel]
        covariance = water.covariance[channel]
        known = np.isfinite([attenuation, ambient, *covariance.ravel()]).all()
        if not known or attenuation < _LEAST_ATTENUATION:
            continue
        kept = 1.0 - light / ambient
        bounded = kept > 0.0
        kept, here = kept[bounded], light[bounded]
        farthest = veil_thickness(here, ambient) / attenuation
        by_attenuation = -farthest / attenuation
        by_light = 1.0 / (ambient * kept * attenuation)
        by_ambient = -here / ambient * by_light
        of_water = (
            covariance[0, 0] * by_attenuation**2
            + 2.0 * covariance[0, 1] * by_attenuation * by_ambient
            + covariance[1, 1] * by_ambient**2
        )
        of_noise = (noise[channel] * slope[bounded] * by_light) ** 2
        table[channel, bounded] = farthest + np.sqrt(
            _WATER_SIGMAS**2 * np.maximum(of_water, 0.0) + _NOISE_SIGMAS**2 * of_noise
        )
    return table


@njit(nogil=True)
def _look_up(
    start: int, stop: int, image: Any, table: Any, shift: int, rays: Any, farthest: Any
) -> None:
    red, green, blue = table[0], table[1], table[2]
    for y in range(start, stop):
        for x in range(image.shape[1]):
            least = min(
                red[image[y, x, 0] >> shift], green[image[y, x, 1] >> shift],
                blue[image[y, x, 2] >> shift],
            )
            # A range along the ray, as the depth that disparities stand for.
            farthest[y, x] = least / rays[y, x]
