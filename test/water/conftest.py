# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A synthetic view whose water is known."""

from dataclasses import dataclass

import numpy as np
import pytest

from uw_visibility.optics.light_model import ambient_light_at_depth, attenuate

KAPPA = np.array([0.22776, 0.06641, 0.02455])


@dataclass
class View:
    """Irradiance of a scene with black and white patches at every range."""

    irradiance: np.ndarray
    range: np.ndarray
    attenuation: np.ndarray
    ambient_light: np.ndarray

    def codes(self, dtype=np.uint8):
        top = np.iinfo(dtype).max
        return np.clip(self.irradiance * top + 0.5, 0, top).astype(dtype)


@pytest.fixture
def make_view():
    def make(alpha=0.15, depth=2.0, nearest=1.0, farthest=8.0, black=0.1, brightest=1.0,
             darkest=0.0, size=(360, 320), planes=24, seed=0):
        rng = np.random.default_rng(seed)
        # Patches of 8 px, a tenth of them black and a tenth white, over plain sand.
        shape = (size[0] // 8, size[1] // 8)
        value = rng.random((*shape, 3))
        kind = rng.random(shape)
        value[kind < black] = 0
        value[kind > 0.9] = 1
        value[2 * shape[0] // 3:] = 0.4
        rho = darkest + (brightest - darkest) * value.repeat(8, axis=0).repeat(8, axis=1)
        # Planes at steps of range, side by side, so that each bin has one range.
        steps = np.linspace(nearest, farthest, planes)
        distance = np.repeat(steps, -(-size[1] // planes))[:size[1]]
        distance = np.tile(distance, (size[0], 1)).astype(np.float32)
        beta = KAPPA + alpha
        ambient = ambient_light_at_depth(beta, depth)
        return View(attenuate(rho, distance, beta, ambient), distance, beta, ambient)

    return make
