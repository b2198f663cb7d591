# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The underwater light model, forward (eq. 1 and 2)."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Water(Protocol):
    """Attenuation and ambient light of each channel; NaN = not assessable."""

    @property
    def attenuation(self) -> NDArray[np.float64]: ...

    @property
    def ambient_light(self) -> NDArray[np.float64]: ...


def scene_light_of(water: Water) -> NDArray[np.float64]:
    """Light W on the scene, of each channel; the ambient light where it is not told apart."""
    light = getattr(water, "scene_light", None)
    return np.asarray(water.ambient_light if light is None else light, dtype=np.float64)


class UncertainWater(Water, Protocol):
    """The same with the covariance of both, ``(C, 2, 2)``."""

    @property
    def attenuation_stddev(self) -> NDArray[np.float64]: ...

    @property
    def covariance(self) -> NDArray[np.float64]: ...


def attenuate(
    radiance: NDArray[np.floating],
    range_map: NDArray[np.floating],
    attenuation: ArrayLike,
    ambient_light: ArrayLike,
) -> NDArray[np.float32]:
    """Irradiance that reaches the camera through the water (eq. 1).

    Parameters
    ----------
    radiance : (H, W, 3) ndarray of float
        Normalised radiance ρ of the scene, 0..1.
    range_map : (H, W) ndarray of float
        Range d along the line of sight, m; inf where there is only water.
    attenuation : (3,) array_like
        β for R, G, B, 1/m.
    ambient_light : (3,) array_like
        I∞ for R, G, B.

    Returns
    -------
    (H, W, 3) float32 ndarray
        E = I∞ρ e^(−βd) + I∞(1 − e^(−βd)). NaN where the range is NaN.
    """
    rate = np.asarray(attenuation, dtype=np.float32)
    ambient = np.asarray(ambient_light, dtype=np.float32)
    # Water that does not attenuate, seen to infinity, still ends in ambient light.
    path = np.maximum(rate, np.float32(1e-12)) * range_map[..., np.newaxis].astype(np.float32)
    transmission = np.exp(-path)
    scene = radiance.astype(np.float32, copy=False)
    return np.asarray(ambient * (1.0 + (scene - 1.0) * transmission), dtype=np.float32)


def ambient_light_at_depth(
    attenuation: ArrayLike,
    depth: float,
    surface_light: ArrayLike = 1.0,
    transmission: float = 1.0,
) -> NDArray[np.float64]:
    """Ambient light below the surface (eq. 2).

    Parameters
    ----------
    attenuation : (3,) array_like
        β for R, G, B, 1/m.
    depth : float
        Depth z, m.
    surface_light : array_like
        Light I0 above the surface, one value or one per channel.
    transmission : float
        Transmission T through the surface, 0..1.

    Returns
    -------
    (3,) float64 ndarray
        I∞ = T·I0·e^(−βz).
    """
    rate = np.asarray(attenuation, dtype=np.float64)
    light = np.asarray(surface_light, dtype=np.float64)
    return np.asarray(transmission * light * np.exp(-rate * depth))
