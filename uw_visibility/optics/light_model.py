# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The underwater light model, forward and inverse (eq. 1, 2, 6, 8).

E = W ρ e^(−βd) + B (1 − e^(−βd)), with the light W on the scene and the veil B, the irradiance of
the water itself at infinity (Akkaynak and Treibitz, doi 10.1109/CVPR.2018.00703). The paper's model
is B = W = I∞.

Each formula is written here once, for one channel, and takes floats or arrays that
broadcast; compiled kernels call the same functions with floats.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.compute.numba_import import register_jitable


@register_jitable
def transmission(attenuation: Any, distance: Any) -> Any:
    """Transmission e^(−βd): the part of light, or of contrast, that remains after a range."""
    return np.exp(-attenuation * distance)


@register_jitable
def contrast_gain(attenuation: Any, distance: Any) -> Any:
    """Gain e^(βd) that compensates the transmission."""
    return np.exp(attenuation * distance)


@register_jitable
def irradiance_of(radiance: Any, transmitted: Any, veil: Any, light: Any) -> Any:
    """Irradiance E of a patch of radiance ρ (eq. 1): W ρ e^(−βd) + B (1 − e^(−βd))."""
    return light * (veil / light + (radiance - veil / light) * transmitted)


@register_jitable
def radiance_of(irradiance: Any, gain: Any, veil: Any, light: Any) -> Any:
    """Radiance ρ of a patch of irradiance E (eq. 8), with the gain e^(βd) or a smaller one."""
    return veil / light + (irradiance / light - veil / light) * gain


def attenuate(
    radiance: NDArray[np.floating], range_map: NDArray[np.floating], attenuation: ArrayLike,
    ambient_light: ArrayLike, scene_light: ArrayLike | None = None,
) -> NDArray[np.float32]:
    """Image of a scene through the water, as irradiance (eq. 1), (H, W, 3); NaN where the range is.

    `radiance` ρ (H, W, 3) is normalised, 0..1; `range_map` d (H, W) along the line of sight, m, inf
    where there is only water; `attenuation` β (3,), 1/m; `ambient_light` I∞ (3,) the veil B, and
    `scene_light` (3,), greater than 0, the light W on the scene, I∞ by default.
    """
    # With β = 0, an infinite range would give NaN instead of ambient light.
    rate = np.maximum(np.asarray(attenuation, np.float32), np.float32(1e-12))
    transmitted = transmission(rate, range_map[..., np.newaxis].astype(np.float32))
    ambient = np.asarray(ambient_light, np.float32)
    light = ambient if scene_light is None else np.asarray(scene_light, np.float32)
    scene = radiance.astype(np.float32, copy=False)
    return np.asarray(irradiance_of(scene, transmitted, ambient, light), np.float32)


def visibility_distance(attenuation: float, contrast: float) -> float:
    """Distance, m, at which a white patch next to a black one is no longer visible (eq. 12).

    `attenuation` is β of the clearest channel, 1/m, `contrast` the smallest C that an observer
    distinguishes.
    """
    return math.log((1 - contrast) / (2 * contrast) + 1) / attenuation
