# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Gaussian priors on attenuation and ambient light, in the fit and fused with its outcome.

In clear water the image alone tells neither how bright the ambient light is nor its colour: there
is little of it between the camera and the scene. Three things are known beforehand, each roughly,
and they decide as far as the image's own covariance lets them: particles and dissolved matter
attenuate the channels alike, more or less (eq. 3); the brightest patch is nearly white (eq. 5),
which tells the light's level; and the ambient light is daylight that has come through the water
above (eq. 2), whose three channels have two unknowns, brightness and depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.compute.linear import solve
from uw_visibility.images.arrays import Array
from uw_visibility.optics.light_model import contrast_gain, radiance_of
from uw_visibility.water.daylight.fit import ATTENUATION_BOUNDS, Fit

# Deviation of the channels' attenuation by particles and dissolved matter: relative to its mean,
# and at least, 1/m; in the fusion, and wider to guide the fit itself.
CHANNEL_TOLERANCE = 0.3
CHANNEL_TOLERANCE_MIN = 0.02
WEAK_CHANNEL_TOLERANCE = 0.5
WEAK_CHANNEL_TOLERANCE_MIN = 0.05
# Radiance of the brightest patch of a scene, and its deviation.
BRIGHT_RADIANCE = 0.9
WHITE_DEVIATION = 0.27
# Relative deviation of the light above its lower bound, where no brightest patch is given.
WEAK_BRIGHT_TOLERANCE = 0.5
# Attenuation is at least that of clear water (eq. 3), known to about a tenth.
CLEAR_WATER_TOLERANCE = 0.1
# Cauchy's scale of contradicted expectations, in deviations.
LIMIT = 2.0
ITERATIONS = 5
# Tolerance that leaves the light's colour to the image.
NOTHING_EXPECTED = 10.0
# Expectations: the channels' attenuations, and the colour of the light.
ROWS = 4


@dataclass(frozen=True)
class Daylight:
    """Daylight prior of the ambient light (eq. 2): I∞ ∝ white · exp(−K z) at some depth z.

    Attributes
    ----------
    white_reference : (3,) float64 ndarray
        The camera's R, G, B of white at the surface; the scale is free.
    diffuse_attenuation : (3,) float64 ndarray or None
        K of the water above, 1/m; None where it is the estimated attenuation itself.
    """

    white_reference: Array
    diffuse_attenuation: Array | None


def fuse(
    fit: Fit, clear_water: Array, ambient_min: Array, daylight: Daylight | None,
    daylight_tolerance: float,
) -> Fit:
    """Fuse the fit of all three channels with Gaussian priors.

    Each expectation is a measurement of the parameters with a standard deviation of its own; their
    best combination with the fit is linear in the covariances. One that is contradicted loses
    weight, as with Cauchy's loss.

    Parameters
    ----------
    fit : Fit
        With all channels.
    clear_water : (3,) float64 ndarray
        κ, 1/m.
    ambient_min : (3,) float64 ndarray
        Lower bound of I∞: the bright envelope (eq. 7).
    daylight : Daylight or None
        None for no prior of colour.
    daylight_tolerance : float
        Standard deviation of the logarithms of the ambient lights about those of daylight.
    """
    off_colour = np.zeros(3)
    colour = 0.0
    if daylight is not None:
        above = daylight.diffuse_attenuation
        off_colour = _perpendicular(fit.parameters[:, 0] if above is None else above)
        colour = float(off_colour @ np.log(daylight.white_reference))
    parameters, covariance = _combine(
        fit.parameters.ravel(), fit.covariance, clear_water, off_colour, colour,
        daylight_tolerance)
    values = parameters.reshape(3, 2)
    values[:, 0] = np.clip(values[:, 0], *ATTENUATION_BOUNDS)
    values[:, 1] = np.maximum(values[:, 1], ambient_min)
    return replace(fit, parameters=values, covariance=covariance)


def _perpendicular(rate: Array) -> Array:
    """Direction of ln I∞ that neither brightness nor depth changes; 0 if there is none."""
    direction = np.array([rate[2] - rate[1], rate[0] - rate[2], rate[1] - rate[0]])
    length = float(np.sqrt(direction @ direction))
    return direction / length if length > 1e-9 else np.zeros(3)


@njit(nogil=True)
def _combine(
    fitted: Any, covariance: Any, clear_water: Any, off_colour: Any, colour: float,
    colour_tolerance: float,
) -> tuple[Any, Any]:
    """Combine β and ln I∞ with the expectations; contradicted ones lose weight."""
    first = fitted.copy()
    scale = np.ones(6)
    for c in range(3):
        first[2 * c + 1] = np.log(fitted[2 * c + 1])
        scale[2 * c + 1] = fitted[2 * c + 1]
    spread = covariance / np.outer(scale, scale)
    rows = np.zeros((ROWS, 6))
    expected = np.zeros(ROWS)
    deviation = np.empty(ROWS)
    for c in range(3):
        rows[c, 0::2] = -1.0 / 3.0
        rows[c, 2 * c] += 1.0
        expected[c] = clear_water[c] - clear_water.mean()
        rows[3, 2 * c + 1] = off_colour[c]
    expected[3] = colour
    deviation[3] = colour_tolerance
    p = first.copy()
    gain = np.zeros((6, ROWS))
    for _ in range(ITERATIONS):
        particles = max((p[0::2] - clear_water).mean(), 0.0)
        deviation[:3] = CHANNEL_TOLERANCE_MIN + CHANNEL_TOLERANCE * particles
        off = (rows @ p - expected) / deviation
        seen = rows @ spread
        innovation = seen @ rows.T
        for k in range(ROWS):
            innovation[k, k] += deviation[k] ** 2 * (1.0 + (off[k] / LIMIT) ** 2)
        gain = solve(innovation, seen).T.copy()
        p = first + gain @ (expected - rows @ first)
    spread = spread - gain @ (rows @ spread)
    spread = 0.5 * (spread + spread.T)
    for c in range(3):
        p[2 * c + 1] = np.exp(p[2 * c + 1])
        scale[2 * c + 1] = p[2 * c + 1]
    return p, spread * np.outer(scale, scale)


@njit(nogil=True)
def weak_channel_tolerance(p: Any, active: Any, clear_water: Any) -> float:
    """Standard deviation of the channels' attenuation by particles, 1/m."""
    mean = 0.0
    number = 0
    for c in range(3):
        if active[c]:
            mean += max(p[2 * c] - clear_water[c], 0.0)
            number += 1
    return WEAK_CHANNEL_TOLERANCE_MIN + WEAK_CHANNEL_TOLERANCE * mean / max(number, 1)


@njit(nogil=True)
def add_weak_priors(
    p: Any, active: Any, clear_water: Any, ambient_min: Any, tolerance: float, bounded: bool,
    patches: Any, hessian: Any, slope: Any,
) -> float:
    """Add the weak priors' curvature and descent direction; return their cost.

    `bounded` is whether β ≥ κ adds curvature. Without `patches` (N = 0), I∞ is near `ambient_min`;
    for the arrays see `lower_envelope`.
    """
    cost = 0.0
    mean = 0.0
    number = 0
    for c in range(3):
        if not active[c]:
            continue
        mean += p[2 * c] - clear_water[c]
        number += 1
        sigma = CLEAR_WATER_TOLERANCE * clear_water[c]
        missing = min(p[2 * c] - clear_water[c], 0.0) / sigma
        cost += missing * missing
        if missing < 0 and bounded:
            hessian[2 * c, 2 * c] += 1 / (sigma * sigma)
            slope[2 * c] -= missing / sigma
        if patches.shape[1] > 0:
            cost += add_white_prior(p, patches, c, hessian, slope)
            continue
        sigma = WEAK_BRIGHT_TOLERANCE * ambient_min[c]
        excess = (p[2 * c + 1] - ambient_min[c]) / sigma
        cost += excess * excess
        hessian[2 * c + 1, 2 * c + 1] += 1 / (sigma * sigma)
        slope[2 * c + 1] -= excess / sigma
    mean /= max(number, 1)
    weight = 1 / (tolerance * tolerance)
    for c in range(3):
        if not active[c]:
            continue
        deviation = p[2 * c] - clear_water[c] - mean
        cost += weight * deviation * deviation
        slope[2 * c] -= weight * deviation
        for other in range(3):
            if active[other]:
                same = 1.0 if other == c else 0.0
                hessian[2 * c, 2 * other] += weight * (same - 1.0 / number)
    return cost


@njit(nogil=True)
def add_white_prior(p: Any, patches: Any, c: int, hessian: Any, slope: Any) -> float:
    """Add the prior that the brightest patch is nearly white (eq. 5); return its cost.

    Patches brighter than the ambient light are outliers; where a code value is more than the
    prior's deviation, nothing is seen. `patches` (3, N, 3): range, irradiance and code step.
    """
    attenuation, ambient = p[2 * c], p[2 * c + 1]
    radiance, place = -np.inf, -1
    for i in range(patches.shape[1]):
        gain = contrast_gain(attenuation, patches[c, i, 0])
        if patches[c, i, 2] * gain < WHITE_DEVIATION * ambient:
            found = radiance_of(patches[c, i, 1], gain, ambient, ambient)
            if radiance < found <= 1.0:
                radiance, place = found, i
    if place < 0:
        return 0.0
    distance, irradiance = patches[c, place, 0], patches[c, place, 1]
    off = (radiance - BRIGHT_RADIANCE) / WHITE_DEVIATION
    by = np.empty(2)
    by[0] = (radiance - 1.0) * distance / WHITE_DEVIATION
    by[1] = -irradiance * contrast_gain(attenuation, distance) / (
        ambient * ambient * WHITE_DEVIATION)
    for j in range(2):
        slope[2 * c + j] -= off * by[j]
        for k in range(2):
            hessian[2 * c + j, 2 * c + k] += by[j] * by[k]
    return float(off * off)
