# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Depth from the chromaticity of the ambient light (eq. 13-14), in any water."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.optics.spectra import (
    CameraResponse,
    clear_water_attenuation,
    theoretical_chromaticity,
)
from uw_visibility.optics.water_type import water_type_attenuation, water_types
from uw_visibility.water.priors import Daylight

GRID_STEP = 0.1
REFINEMENTS = 8

CLEAR = "clear"
ESTIMATED = "estimated"

# How likely the configured water type is beforehand, against all others together.
CONFIGURED = 0.5
# How far the colour of light is from that of daylight below water of a type, as a logarithm.
COLOUR_TOLERANCE = 0.2
# The white that a camera has at the surface differs from the reference by this part.
WHITE_TOLERANCE = 0.15
SPREAD_STEP = 0.5
# Cameras of which no white was told that are balanced below water, and how far from neutral
# light is then, as a logarithm; mean depth beforehand, m.
BALANCED = 0.1
NEUTRAL_TOLERANCE = 0.15
USUAL_DEPTH = 6.0


class DepthModel:
    """Chromaticity of ambient light over depth, γ(z) ∝ white · exp(−K z).

    Parameters
    ----------
    water_type : str
        What K is: ``"clear"`` takes that of clear sea water (eq. 13), the name of
        a Jerlov type that type's, and ``"estimated"`` the estimated attenuation β
        itself (eq. 2).
    response : CameraResponse
    white_reference : (3,) array_like
        The camera's R, G, B of white at the surface; the scale is free.
    max_depth : float
        Largest depth considered, m.

    Attributes
    ----------
    daylight : Daylight
        What this says of the ambient light.

    Raises
    ------
    InputError
        If the type is not known.
    """

    def __init__(
        self,
        water_type: str,
        response: CameraResponse,
        white_reference: ArrayLike = (1.0, 1.0, 1.0),
        max_depth: float = 60.0,
    ) -> None:
        self._white = np.array(white_reference, dtype=np.float64)
        self._max_depth = max_depth
        self._grid = np.arange(0.0, max_depth + GRID_STEP / 2, GRID_STEP)
        self._rate: NDArray[np.float64] | None = None
        if water_type != ESTIMATED:
            self._rate = diffuse_attenuation(water_type, response)
            self._table = theoretical_chromaticity(self._grid, self._rate, self._white)
        self.daylight = Daylight(self._white, self._rate)
        names = [name for name in (CLEAR, *water_types()) if name != water_type]
        self._others = np.array([diffuse_attenuation(name, response) for name in names])

    def model_stddev(
        self,
        depth: float,
        attenuation: NDArray[np.float64],
        attenuation_stddev: NDArray[np.float64],
        light: NDArray[np.float64],
    ) -> tuple[float, float]:
        """Standard deviation of depth by what is not known: water type and white balance.

        Parameters
        ----------
        depth : float
            As found for the configured type, m.
        attenuation, attenuation_stddev : (3,) float64 ndarray
            β and its standard deviation, 1/m: diffuse attenuation K is no larger.
        light : (3,) float64 ndarray
            Light on the scene.

        Returns
        -------
        stddev : float
            m; the spread of depths that other types give about it, each as likely as
            the colour of the light makes it, with that of the camera's white. Neutral
            light is the surface's, or of a camera that was balanced at any depth.
        colour_error : float
            How far the colour is from daylight's below the best of the types, in
            standard deviations.
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

    def _probably_balanced(
        self, off: NDArray[np.float64], errors: NDArray[np.float64], prior: NDArray[np.float64]
    ) -> float:
        """Probability that the camera was balanced at depth, by how neutral the light is.

        Parameters
        ----------
        off : (T, N, 3) float64 ndarray
            Logarithm of the light's colour over daylight's, for each type of water and depth.
        errors : (T, N) float64 ndarray
            Its length in standard deviations.
        prior : (T,) float64 ndarray
            Of the types.
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
        self,
        attenuation: NDArray[np.float64],
        ambient_light: NDArray[np.float64],
        covariance: NDArray[np.float64],
    ) -> tuple[float, float]:
        """Find the depth whose chromaticity is nearest that of the ambient light.

        Parameters
        ----------
        attenuation, ambient_light : (3,) float64 ndarray
            β, 1/m, and I∞, all finite.
        covariance : (6, 6) float64 ndarray
            Of β_R, I∞_R, β_G, I∞_G, β_B, I∞_B.

        Returns
        -------
        depth : float
            m, from 0 to the largest depth considered.
        stddev : float
            By propagation of I∞ and, where it is K, of β; infinite where the
            chromaticity does not tell the depth.
        """
        total = ambient_light.sum()
        chromaticity = ambient_light / total
        estimated = self._rate is None
        rate = attenuation if self._rate is None else self._rate
        table = None if estimated else self._table
        depth = self._nearest(chromaticity, rate, table)
        gamma, slope, curvature = self._derivatives(depth, rate)
        deviation = gamma - chromaticity
        # Where the sum of squares is least, slope·deviation = 0; how depth
        # follows chromaticity, and K, is the derivative of that equation.
        stiffness = float(slope @ slope + deviation @ curvature)
        if stiffness <= 0:
            return depth, math.inf
        by = np.zeros(6)
        by[1::2] = slope @ (np.eye(3) - chromaticity[:, np.newaxis]) / total / stiffness
        if estimated:
            by_rate, slope_by_rate = _by_rate(depth, rate, gamma)
            by[0::2] = -(slope @ by_rate + deviation @ slope_by_rate) / stiffness
        return depth, math.sqrt(max(float(by @ covariance @ by), 0.0))

    def _nearest(
        self,
        chromaticity: NDArray[np.float64],
        rate: NDArray[np.float64],
        table: NDArray[np.float64] | None,
    ) -> float:
        if table is None:
            table = theoretical_chromaticity(self._grid, rate, self._white)
        distances = ((table - chromaticity) ** 2).sum(axis=1)
        depth = float(self._grid[int(distances.argmin())])
        for _ in range(REFINEMENTS):
            gamma, slope, _ = self._derivatives(depth, rate)
            step = float(slope @ (gamma - chromaticity) / max(float(slope @ slope), 1e-30))
            step = min(max(step, -GRID_STEP), GRID_STEP)
            depth = min(max(depth - step, 0.0), self._max_depth)
        return depth

    def _derivatives(
        self, depth: float, rate: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Theoretical chromaticity, and its first and second derivative by depth."""
        gamma = theoretical_chromaticity(depth, rate, self._white)
        mean = float(gamma @ rate)
        slope = gamma * (mean - rate)
        curvature = slope * (mean - rate) + gamma * float(slope @ rate)
        return gamma, slope, curvature


def diffuse_attenuation(water_type: str, response: CameraResponse) -> NDArray[np.float64]:
    """Diffuse attenuation K of clear water or of a Jerlov type, (3,) 1/m.

    Raises
    ------
    InputError
        If the type is not known.
    """
    if water_type == CLEAR:
        return clear_water_attenuation(response)
    return water_type_attenuation(water_type, response, diffuse=True)


def _by_rate(
    depth: float, rate: NDArray[np.float64], gamma: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Derivatives by K (columns) of the chromaticity and of its slope over depth."""
    by_rate = -depth * (np.diag(gamma) - np.outer(gamma, gamma))
    mean = gamma @ rate
    mean_by_rate = gamma + rate @ by_rate
    slope_by_rate = (mean - rate)[:, np.newaxis] * by_rate
    slope_by_rate += gamma[:, np.newaxis] * (mean_by_rate - np.eye(3))
    return by_rate, slope_by_rate
