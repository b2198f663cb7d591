# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The fit of the lower envelope of dark patches, all channels together (eq. 6-7)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uw_visibility.water.fit import AMBIENT_LIGHT_MAX, ATTENUATION_BOUNDS, Fit, blank

MAX_ITERATIONS = 60
# Lower envelope: the darkest thing in a bin is at least black, so bins above
# the curve say little and bins below it much.
WEIGHT_ABOVE = 0.03
WEIGHT_BELOW = 0.97
# How far from black the darkest pixels of different bins typically differ.
DARKNESS_SCATTER = 0.02
# How far from black the darkest pixels of all bins together may well be.
DARKNESS_COMMON = 0.03
# Bins whose darkest patches belong to one object, and so deviate together.
NEIGHBOURING_BINS = 3.0
# Attenuation is at least that of clear water (eq. 3), which is known to about a
# tenth for a camera whose response is.
CLEAR_WATER_TOLERANCE = 0.1
# The brightest patch is seldom darker than the ambient light by much more.
BRIGHT_PATCH_TOLERANCE = 0.5
# What particles and dissolved matter add differs between the channels by this
# fraction of its mean, and this much at least, 1/m.
CHANNEL_TOLERANCE = 0.5
CHANNEL_TOLERANCE_MIN = 0.05


def fit_lower_envelope(
    distance: NDArray[np.float64],
    dark: NDArray[np.float64],
    deviation: NDArray[np.float64],
    ambient_min: NDArray[np.float64],
    start: NDArray[np.float64],
    clear_water: NDArray[np.float64],
    active: NDArray[np.bool_],
    range_error: float = 0.0,
) -> Fit:
    """Fit the lower envelope of the dark patches, all channels together.

    The loss is asymmetric: a bin above the curve holds nothing black, a bin
    below it contradicts the curve. Residuals are weighed by what they are made
    of: rounding and noise, range error, and the darkness of the darkest patch, whose
    effect fades with the transmission. Three weak priors act where the data
    say little: β ≥ κ (eq. 3), I∞ near the brightest patch, and an attenuation
    by particles that is similar in the three channels.

    Parameters
    ----------
    distance : (N,) float64 ndarray
        Range of each bin, m.
    dark, deviation : (3, N) float64 ndarray
        Dark envelope, and its standard deviation by rounding and noise.
    ambient_min : (3,) float64 ndarray
        Lower bound of I∞: the bright envelope (eq. 7).
    start : (3, 2) float64 ndarray
        Attenuation and ambient light to start from.
    clear_water : (3,) float64 ndarray
        κ, 1/m.
    active : (3,) bool ndarray
        Channels to fit.
    range_error : float
        Standard deviation of range over its square, 1/m.

    Returns
    -------
    Fit
        The covariance is that of the weighted estimate (sandwich form), plus
        the effect of a scene whose darkest patches are all not black.
    """
    lower = np.empty(6)
    lower[0::2] = ATTENUATION_BOUNDS[0]
    lower[1::2] = ambient_min
    upper = np.tile([ATTENUATION_BOUNDS[1], AMBIENT_LIGHT_MAX], 3)
    known = active[:, np.newaxis] & np.isfinite(dark)
    values, covariance, iterations, converged = _minimise(
        distance,
        np.where(known, dark, 0.0),
        np.where(known, deviation, 1.0),
        known,
        active,
        np.clip(start.ravel(), lower, upper),
        lower,
        upper,
        clear_water,
        range_error,
    )
    parameters = np.where(active[:, np.newaxis], values.reshape(3, 2), np.nan)
    return Fit(parameters, blank(covariance, active), int(iterations), bool(converged))


@njit(nogil=True, cache=True)
def _scales(p: Any, distance: Any, deviation: Any, range_error: float, scale: Any) -> None:
    """Standard deviation of each envelope value about the curve of a black patch."""
    for c in range(3):
        for i in range(len(distance)):
            d = distance[i]
            direct = p[2 * c + 1] * np.exp(-p[2 * c] * d)
            darkness = DARKNESS_SCATTER * direct
            displacement = range_error * d * d * p[2 * c] * direct
            scale[c, i] = np.sqrt(
                deviation[c, i] ** 2 + darkness * darkness + displacement * displacement
            )


@njit(nogil=True, cache=True)
def _prior(
    p: Any, active: Any, clear_water: Any, ambient_min: Any, tolerance: float,
    hessian: Any, slope: Any,
) -> float:
    """Add the priors' curvature and descent direction; return their cost."""
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
        if missing < 0:
            hessian[2 * c, 2 * c] += 1 / (sigma * sigma)
            slope[2 * c] -= missing / sigma
        sigma = BRIGHT_PATCH_TOLERANCE * ambient_min[c]
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


@njit(nogil=True, cache=True)
def _normal_equations(
    p: Any, distance: Any, dark: Any, known: Any, scale: Any, hessian: Any, slope: Any,
) -> float:
    """Add the data's curvature and descent direction; return their cost."""
    cost = 0.0
    for c in range(3):
        for i in range(len(distance)):
            if not known[c, i]:
                continue
            transmission = np.exp(-p[2 * c] * distance[i])
            u = (dark[c, i] - p[2 * c + 1] * (1.0 - transmission)) / scale[c, i]
            side = WEIGHT_BELOW if u < 0 else WEIGHT_ABOVE
            root = np.sqrt(1.0 + u * u)
            cost += side * 2.0 * (root - 1.0)
            by_attenuation = p[2 * c + 1] * distance[i] * transmission / scale[c, i]
            by_ambient = (1.0 - transmission) / scale[c, i]
            weight = side / root
            hessian[2 * c, 2 * c] += weight * by_attenuation * by_attenuation
            hessian[2 * c, 2 * c + 1] += weight * by_attenuation * by_ambient
            hessian[2 * c + 1, 2 * c] += weight * by_attenuation * by_ambient
            hessian[2 * c + 1, 2 * c + 1] += weight * by_ambient * by_ambient
            slope[2 * c] += weight * by_attenuation * u
            slope[2 * c + 1] += weight * by_ambient * u
    return cost


@njit(nogil=True, cache=True)
def _minimise(
    distance: Any, dark: Any, deviation: Any, known: Any, active: Any, start: Any, lower: Any,
    upper: Any, clear_water: Any, range_error: float,
) -> tuple[Any, Any, int, bool]:
    """Damped Gauss-Newton within bounds; scales follow the parameters."""
    p = start.copy()
    scale = np.empty_like(dark)
    damping = 1e-3
    converged = False
    iterations = 0
    hessian = np.zeros((6, 6))
    slope = np.zeros(6)
    scratch = np.zeros((6, 6))
    scratch_slope = np.zeros(6)
    while iterations < MAX_ITERATIONS and not converged:
        iterations += 1
        _scales(p, distance, deviation, range_error, scale)
        tolerance = _channel_tolerance(p, active, clear_water)
        hessian[:] = 0.0
        slope[:] = 0.0
        cost = _normal_equations(p, distance, dark, known, scale, hessian, slope)
        cost += _prior(p, active, clear_water, lower[1::2], tolerance, hessian, slope)
        while True:
            trial = _step(p, hessian, slope, damping, lower, upper, active)
            move = np.max(np.abs(trial - p) / (1e-3 + np.abs(p)))
            if move < 1e-8:
                converged = True
                break
            trial_cost = _normal_equations(
                trial, distance, dark, known, scale, scratch, scratch_slope
            )
            trial_cost += _prior(
                trial, active, clear_water, lower[1::2], tolerance, scratch, scratch_slope
            )
            if trial_cost <= cost:
                p = trial
                damping = max(damping * 0.1, 1e-9)
                converged = move < 1e-5
                break
            damping *= 10.0
    return p, _covariance(p, distance, dark, deviation, known, active, clear_water, lower,
                          range_error), iterations, converged


@njit(nogil=True, cache=True)
def _channel_tolerance(p: Any, active: Any, clear_water: Any) -> float:
    mean = 0.0
    number = 0
    for c in range(3):
        if active[c]:
            mean += max(p[2 * c] - clear_water[c], 0.0)
            number += 1
    return CHANNEL_TOLERANCE_MIN + CHANNEL_TOLERANCE * mean / max(number, 1)


@njit(nogil=True, cache=True)
def _step(
    p: Any, hessian: Any, slope: Any, damping: float, lower: Any, upper: Any, active: Any
) -> Any:
    """Damped step of the parameters that are free to move, cut at the bounds."""
    system = np.eye(6)
    right = np.zeros(6)
    free = np.zeros(6, np.bool_)
    for i in range(6):
        held = (p[i] <= lower[i] and slope[i] < 0) or (p[i] >= upper[i] and slope[i] > 0)
        free[i] = active[i // 2] and not held
    for i in range(6):
        if free[i]:
            right[i] = slope[i]
            for j in range(6):
                if free[j]:
                    system[i, j] = hessian[i, j]
            system[i, i] = hessian[i, i] * (1.0 + damping) + 1e-12
    moved = p + np.linalg.solve(system, right)
    return np.minimum(np.maximum(moved, lower), upper)


@njit(nogil=True, cache=True)
def _covariance(
    p: Any, distance: Any, dark: Any, deviation: Any, known: Any, active: Any, clear_water: Any,
    lower: Any, range_error: float,
) -> Any:
    """Sandwich covariance, and the effect of darkest patches that are not black."""
    scale = np.empty_like(dark)
    _scales(p, distance, deviation, range_error, scale)
    curvature = np.zeros((6, 6))
    slope = np.zeros(6)
    tolerance = _channel_tolerance(p, active, clear_water)
    _prior(p, active, clear_water, lower[1::2], tolerance, curvature, slope)
    # A prior's score varies as much as its curvature says; a bin's as much as
    # its residual shows.
    spread = curvature.copy()
    _normal_equations(p, distance, dark, known, scale, curvature, slope)
    common = np.zeros(6)
    derivative = np.empty(2)
    for c in range(3):
        for i in range(len(distance)):
            if not known[c, i]:
                continue
            direct = p[2 * c + 1] * np.exp(-p[2 * c] * distance[i])
            u = (dark[c, i] - p[2 * c + 1] + direct) / scale[c, i]
            weight = (WEIGHT_BELOW if u < 0 else WEIGHT_ABOVE) / np.sqrt(1.0 + u * u)
            derivative[0] = distance[i] * direct / scale[c, i]
            derivative[1] = (1.0 - direct / p[2 * c + 1]) / scale[c, i]
            for j in range(2):
                common[2 * c + j] += (
                    weight * derivative[j] * DARKNESS_COMMON * direct / scale[c, i]
                )
                for k in range(2):
                    spread[2 * c + j, 2 * c + k] += (
                        NEIGHBOURING_BINS * (weight * u) ** 2 * derivative[j] * derivative[k]
                    )
    for i in range(6):
        if not active[i // 2]:
            curvature[i, i] = 1.0
        curvature[i, i] += 1e-12
    inverse = np.linalg.inv(curvature)
    shift = inverse @ common
    return inverse @ spread @ inverse + np.outer(shift, shift)
