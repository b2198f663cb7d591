# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Depth from the chromaticity of the ambient light (eq. 13-14), in any water."""

from __future__ import annotations

import copy
import math

import numpy as np
from numpy.typing import ArrayLike

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.light_model import transmission
from uw_visibility.optics.spectra import (
    CameraResponse,
    clear_water_attenuation,
    theoretical_chromaticity,
)
from uw_visibility.optics.water_type import water_type_attenuation, water_types
from uw_visibility.water.daylight.one_light import Daylight

# Step of the depths that are compared, m, and number of steps of the search from the best of them.
GRID_STEP = 0.1
REFINEMENTS = 8

CLEAR = "clear"
ESTIMATED = "estimated"

# Prior probability of the configured water type, against all others together.
CONFIGURED = 0.5
# Standard deviation of ln of the light's colour about that of daylight below water of a type.
COLOUR_TOLERANCE = 0.2
# Relative standard deviation of a camera's white at the surface about the reference.
WHITE_TOLERANCE = 0.15
SPREAD_STEP = 0.5
# Prior probability that a camera without white reference is balanced below water, and the standard
# deviation of ln of the light about neutral then; prior mean depth, m.
BALANCED = 0.1
NEUTRAL_TOLERANCE = 0.15
USUAL_DEPTH = 6.0


class DepthModel:
    """Chromaticity of ambient light over depth, γ(z) ∝ white · exp(−K z), down to `max_depth`, m.

    `water_type` says what K is: ``"clear"`` takes that of clear sea water (eq. 13), the name of a
    Jerlov type that type's, and ``"estimated"`` the estimated attenuation β itself (eq. 2).
    `white_reference` (3,) is the camera's R, G, B of white at the surface; the scale is free. The
    attribute `daylight` is the prior of the ambient light's colour. Raises `InputError` if the type
    is not known.
    """

    def __init__(
        self, water_type: str, response: CameraResponse,
        white_reference: ArrayLike = (1.0, 1.0, 1.0), max_depth: float = 60.0,
    ) -> None:
        self._white = np.array(white_reference, dtype=np.float64)
        self._max_depth = max_depth
        self._grid = np.arange(0.0, max_depth + GRID_STEP / 2, GRID_STEP)
        self._rate: Array | None = None
        if water_type != ESTIMATED:
            self._rate = diffuse_attenuation(water_type, response)
        self.daylight = Daylight(self._white, self._rate)
        names = [name for name in (CLEAR, *water_types()) if name != water_type]
        self._others = np.array([diffuse_attenuation(name, response) for name in names])

    def of_channels(self, seen: Mask) -> DepthModel:
        """Model for the colour of some channels, two at least."""
        model = copy.copy(self)
        model._white, model._others = self._white[seen], self._others[:, seen]
        model._rate = None if self._rate is None else self._rate[seen]
        return model

    def light(self, depth: float, light: Array, seen: Mask) -> Array:
        """Daylight in all channels at a depth, m, scaled to the light of the channels seen, (3,).

        NaN where the attenuation above is that of the estimate itself.
        """
        if self._rate is None:
            return np.full(3, np.nan)
        below = self._white * transmission(self._rate, min(depth, self._max_depth))
        return below * float(np.exp(np.log(light[seen] / below[seen]).mean()))

    def model_stddev(
        self, depth: float, attenuation: Array, attenuation_stddev: Array, light: Array
    ) -> tuple[float, float]:
        """Standard deviation of depth by unknown water type and white balance, m; colour error.

        The spread of depths by other types, each weighted by its likelihood for the colour of the
        `light` on the scene, (3,), and the camera's white. β, (3,), 1/m, is an upper bound of
        diffuse attenuation K, `depth` that of the configured type, m. Neutral light is the
        surface's, or of a camera that was balanced at any depth. The colour error is the distance
        from daylight below the best type, in standard deviations.
        """
        own = attenuation if self._rate is None else self._rate
        # Water that takes light without scattering it is of no type: its K is β (eq. 2).
        rates = np.concatenate((own[np.newaxis], self._others, attenuation[np.newaxis]))
        grid = np.arange(0.0, self._max_depth + SPREAD_STEP, SPREAD_STEP)
        # ln of the light's colour less that of daylight at each depth, without brightness.
        off = np.log(light / self._white) + rates[:, np.newaxis] * grid[:, np.newaxis]
        off = off - off.mean(axis=2, keepdims=True)
        errors = np.sqrt((off**2).sum(axis=2)) / COLOUR_TOLERANCE
        best = errors.argmin(axis=1)
        error = errors.min(axis=1)
        beyond = np.maximum(rates - attenuation, 0.0) / np.maximum(attenuation_stddev, 1e-9)
        prior = np.full(len(rates), (1.0 - CONFIGURED) / (len(rates) - 1))
        prior[0] = CONFIGURED
        cost = 0.5 * error**2 + 0.5 * (beyond**2).sum(axis=1)
        weight = prior * np.exp(-(cost - cost.min()))
        weight /= weight.sum()
        types = float(weight @ (grid[best] - depth) ** 2)
        slope = own - own.mean()
        white = WHITE_TOLERANCE**2 / max(float(slope @ slope), 1e-9)
        balanced = self._probably_balanced(
            off, errors, prior * np.exp(-0.5 * (beyond**2).sum(axis=1)))
        anywhere = (USUAL_DEPTH - depth) ** 2 + USUAL_DEPTH**2
        stddev = math.sqrt((1.0 - balanced) * (types + white) + balanced * anywhere)
        return stddev, float(error[:-1].min())

    def _probably_balanced(self, off: Array, errors: Array, prior: Array) -> float:
        """Probability that the camera was balanced at depth, by how neutral the light is.

        `off` (T, N, 3): log colour of the light over daylight's by water type and depth; `errors`
        (T, N): its length in standard deviations; `prior` (T,) of the types.
        """
        if np.ptp(self._white) > 0.0:
            return 0.0
        neutral = math.exp(
            -0.5 * float(off[0, 0] @ off[0, 0]) / NEUTRAL_TOLERANCE**2) / NEUTRAL_TOLERANCE**2
        depths = SPREAD_STEP * np.arange(errors.shape[1])
        usual = np.exp(-depths / USUAL_DEPTH)
        daylight = prior @ np.exp(-0.5 * errors**2) @ usual
        daylight /= prior.sum() * usual.sum() * COLOUR_TOLERANCE**2
        balanced = BALANCED * neutral
        return balanced / max(balanced + (1.0 - BALANCED) * float(daylight), 1e-300)

    def depth(
        self, attenuation: Array, ambient_light: Array, covariance: Array
    ) -> tuple[float, float]:
        """Depth whose chromaticity is nearest that of the ambient light, and its deviation, m.

        The deviation is by propagation of I∞ and, where it is K, of β; infinite where the
        chromaticity does not tell the depth. β, 1/m, and I∞ are those of the model's channels,
        (C,), all finite; `covariance` (2 C, 2 C) is of β and I∞ by turns.
        """
        total = ambient_light.sum()
        chromaticity = ambient_light / total
        rate = attenuation if self._rate is None else self._rate
        depth = self._nearest(chromaticity, rate)
        gamma, slope, curvature = self._derivatives(depth, rate)
        deviation = gamma - chromaticity
        # Where the sum of squares is least, slope·deviation = 0; how depth
        # follows chromaticity, and K, is the derivative of that equation.
        stiffness = float(slope @ slope + deviation @ curvature)
        if stiffness <= 0:
            return depth, math.inf
        by = np.zeros(len(covariance))
        by[1::2] = slope @ (np.eye(len(slope)) - chromaticity[:, np.newaxis]) / total / stiffness
        if self._rate is None:
            by_rate, slope_by_rate = _by_rate(depth, rate, gamma)
            by[0::2] = -(slope @ by_rate + deviation @ slope_by_rate) / stiffness
        return depth, math.sqrt(max(float(by @ covariance @ by), 0.0))

    def _nearest(self, chromaticity: Array, rate: Array) -> float:
        table = theoretical_chromaticity(self._grid, rate, self._white)
        distances = ((table - chromaticity) ** 2).sum(axis=1)
        depth = float(self._grid[int(distances.argmin())])
        for _ in range(REFINEMENTS):
            gamma, slope, _ = self._derivatives(depth, rate)
            step = float(slope @ (gamma - chromaticity) / max(float(slope @ slope), 1e-30))
            step = min(max(step, -GRID_STEP), GRID_STEP)
            depth = min(max(depth - step, 0.0), self._max_depth)
        return depth

    def _derivatives(self, depth: float, rate: Array) -> tuple[Array, Array, Array]:
        """Theoretical chromaticity, and its first and second derivative by depth."""
        gamma = theoretical_chromaticity(depth, rate, self._white)
        mean = float(gamma @ rate)
        slope = gamma * (mean - rate)
        curvature = slope * (mean - rate) + gamma * float(slope @ rate)
        return gamma, slope, curvature


def diffuse_attenuation(water_type: str, response: CameraResponse) -> Array:
    """Diffuse attenuation K of clear water or of a Jerlov type, (3,) 1/m.

    Raises `InputError` if the type is not known.
    """
    if water_type == CLEAR:
        return clear_water_attenuation(response)
    return water_type_attenuation(water_type, response, diffuse=True)


def _by_rate(depth: float, rate: Array, gamma: Array) -> tuple[Array, Array]:
    """Derivatives by K (columns) of the chromaticity and of its slope over depth."""
    by_rate = -depth * (np.diag(gamma) - np.outer(gamma, gamma))
    mean = gamma @ rate
    mean_by_rate = gamma + rate @ by_rate
    slope_by_rate = (mean - rate)[:, np.newaxis] * by_rate
    slope_by_rate += gamma[:, np.newaxis] * (mean_by_rate - np.eye(len(rate)))
    return by_rate, slope_by_rate
