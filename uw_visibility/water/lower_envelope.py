# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Robust fit of the lower envelope, all channels together (eq. 6-7)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.linear import solve
from uw_visibility.optics.light_model import contrast_gain, radiance_of
from uw_visibility.water.envelope_loss import (
    EXPECTED_DARKNESS,
    OUTLIER_BELOW,
    OUTLIER_BELOW_MEASURED,
    SCALES,
    add_normal_equations,
    darkness_deviation,
    deviance,
    differentiate,
    durbin_watson,
    loss,
    residual,
    set_scales,
    total_loss,
    transmit,
    typical_darkness,
)
from uw_visibility.water.fit import AMBIENT_LIGHT_MAX, ATTENUATION_BOUNDS, Fit, blank
from uw_visibility.water.priors import add_weak_priors, weak_channel_tolerance

MAX_ITERATIONS = 60
# After so many iterations the scales are held, so that the cost can only fall.
ADAPTIVE_ITERATIONS = 30
# Before, the darkest patches are taken for black: from a start far off, how far they
# are from it would be misjudged, and the misjudgement bear itself out.
BLACK_ITERATIONS = 6
# Bins whose darkest patches belong to one object, and so deviate together.
NEIGHBOURING_BINS = 3.0


def fit_lower_envelope(
    distance: NDArray[np.float64],
    dark: NDArray[np.float64],
    deviation: NDArray[np.float64],
    ambient_min: NDArray[np.float64],
    start: NDArray[np.float64],
    clear_water: NDArray[np.float64],
    active: NDArray[np.bool_],
    range_error: float = 0.0,
    bright: NDArray[np.float64] | None = None,
    light: NDArray[np.float64] | None = None,
    ambient_max: NDArray[np.float64] | None = None,
    patches: NDArray[np.float64] | None = None,
    attenuation: NDArray[np.float64] | None = None,
) -> Fit:
    """Robust fit of the lower envelope of dark patches, all channels together.

    The loss is asymmetric: a bin above the curve holds nothing black, a bin
    below it contradicts the curve; see `uw_visibility.water.envelope_loss`. Three
    weak priors act where the data say little: β ≥ κ (eq. 3), I∞ near the
    brightest patch, and an attenuation by particles that is similar in the
    three channels.

    Parameters
    ----------
    distance : (3, N) float64 ndarray
        Range of the dark patch of each bin, m.
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
    bright : (3, 2) float64 ndarray, optional
        Irradiance and range of the brightest patch near by, per channel. The
        less white it is, the less the darkest patches may be trusted to be black.
    light : (3,) float64 ndarray, optional
        Light on the scene over the veil, W / B; 1 as in the paper where absent. What is
        not black on the dark patches is so many times brighter.
    ambient_max : (3,) float64 ndarray, optional
        Upper bound of I∞.
    patches : (3, N, 3) float64 ndarray, optional
        Range, irradiance and code step of the bright envelope, where veil and light are
        one: the brightest patch is nearly white, see `uw_visibility.water.priors`. I∞ is
        near its lower bound where absent.
    attenuation : (3,) float64 ndarray, optional
        β, 1/m, where it is known: I∞ alone is fitted.

    Returns
    -------
    Fit
        The covariance is that of the weighted estimate (sandwich form), plus
        the effect of a scene whose darkest patches are all not black.
    """
    lower, upper = np.empty((2, 6))
    lower[0::2], upper[0::2] = ATTENUATION_BOUNDS
    if attenuation is not None:
        lower[0::2] = upper[0::2] = attenuation
    lower[1::2] = ambient_min
    upper[1::2] = (
        AMBIENT_LIGHT_MAX if ambient_max is None else np.maximum(ambient_max, ambient_min))
    # One kernel for arrays of any order in memory.
    distance, dark, deviation = (np.ascontiguousarray(a) for a in (distance, dark, deviation))
    known = active[:, np.newaxis] & np.isfinite(dark)
    one_light = ambient_max is None
    values, covariance, iterations, converged, cost, misfit, trend = _minimise(
        np.where(known, distance, 1.0),
        np.where(known, dark, 0.0),
        np.where(known, deviation, 1.0),
        known,
        active,
        np.minimum(np.maximum(start.ravel(), lower), upper),
        lower,
        upper,
        clear_water,
        range_error,
        np.full((3, 2), np.inf) if bright is None else bright,
        np.ones(3) if light is None else light,
        np.empty((3, 0, 3)) if patches is None else np.ascontiguousarray(patches),
        OUTLIER_BELOW_MEASURED if one_light and range_error > 0.0 else OUTLIER_BELOW,
    )
    parameters = np.where(active[:, np.newaxis], values.reshape(3, 2), np.nan)
    return Fit(
        parameters, blank(covariance, active), int(iterations), bool(converged), float(cost),
        float(misfit), float(trend))


@njit(nogil=True)
def _minimise(
    distance: Any, dark: Any, deviation: Any, known: Any, active: Any, start: Any, lower: Any,
    upper: Any, clear_water: Any, range_error: float, bright: Any, light: Any, patches: Any,
    outlier: float,
) -> tuple[Any, Any, int, bool, float, float, float]:
    """Damped Gauss-Newton within bounds; scales follow the parameters at first."""
    p = start.copy()
    scale = np.empty((SCALES, 3, dark.shape[1]))
    left, trial_left = np.empty(dark.shape), np.empty(dark.shape)
    transmit(p, distance, left)
    tolerance = 1.0
    damping = 1e-3
    converged = False
    iterations = 0
    hessian = np.zeros((6, 6))
    slope = np.zeros(6)
    scratch = np.zeros((6, 6))
    scratch_slope = np.zeros(6)
    while iterations < MAX_ITERATIONS and not converged:
        iterations += 1
        if iterations <= ADAPTIVE_ITERATIONS:
            darkness = EXPECTED_DARKNESS if iterations > BLACK_ITERATIONS else 0.0
            set_scales(
                p, distance, left, dark, deviation, known, range_error, darkness, light, outlier,
                scale)
            tolerance = weak_channel_tolerance(p, active, clear_water)
        hessian[:] = 0.0
        slope[:] = 0.0
        cost = add_normal_equations(p, distance, left, dark, known, scale, hessian, slope)
        cost += add_weak_priors(
            p, active, clear_water, lower[1::2], tolerance, True, patches, hessian, slope)
        while True:
            trial = _step(p, hessian, slope, damping, lower, upper, active)
            move = np.max(np.abs(trial - p) / (1e-3 + np.abs(p)))
            if move < 1e-8:
                converged = iterations > BLACK_ITERATIONS
                break
            transmit(trial, distance, trial_left)
            trial_cost = total_loss(trial, trial_left, dark, known, scale)
            trial_cost += add_weak_priors(
                trial, active, clear_water, lower[1::2], tolerance, True, patches, scratch,
                scratch_slope,
            )
            if trial_cost <= cost:
                p = trial
                left, trial_left = trial_left, left
                damping = max(damping * 0.1, 1e-9)
                converged = move < 1e-4 and iterations > BLACK_ITERATIONS
                break
            damping *= 10.0
    set_scales(
        p, distance, left, dark, deviation, known, range_error, EXPECTED_DARKNESS, light, outlier,
        scale)
    cost, misfit = deviance(p, left, dark, known, scale)
    covariance = _covariance(
        p, distance, left, dark, known, active, clear_water, lower, bright, light, patches,
        scale)
    trend = durbin_watson(p, left, dark, known, scale)
    return p, covariance, iterations, converged, cost, misfit, trend


@njit(nogil=True)
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
    moved = p + solve(system, right)
    return np.minimum(np.maximum(moved, lower), upper)


@njit(nogil=True)
def _covariance(
    p: Any, distance: Any, left: Any, dark: Any, known: Any, active: Any, clear_water: Any,
    lower: Any, bright: Any, light: Any, patches: Any, scale: Any,
) -> Any:
    """Sandwich covariance, and the effect of darkest patches that are not black."""
    curvature = np.zeros((6, 6))
    slope = np.zeros(6)
    tolerance = weak_channel_tolerance(p, active, clear_water)
    # A bound that holds attenuation up says nothing about how far it may be above.
    add_weak_priors(
        p, active, clear_water, lower[1::2], tolerance, False, patches, curvature, slope)
    # A prior's score varies as much as its curvature says; a bin's as much as
    # its residual shows.
    spread = curvature.copy()
    add_normal_equations(p, distance, left, dark, known, scale, curvature, slope)
    typical = typical_darkness(p, left, dark, known, light, scale)
    one_light = patches.shape[1] > 0
    common = np.zeros(6)
    derivative = np.empty(2)
    for c in range(3):
        darkness = darkness_deviation(
            typical[c], _radiance(p, bright[c], light[c], c), light[c], one_light)
        for i in range(distance.shape[1]):
            if not known[c, i]:
                continue
            r = residual(p, left, dark, scale, c, i)
            _, weight = loss(r, scale, c, i)
            differentiate(p, distance, left, scale, c, i, derivative)
            direct = light[c] * p[2 * c + 1] * left[c, i]
            for j in range(2):
                common[2 * c + j] += weight * derivative[j] * darkness * direct
                for k in range(2):
                    spread[2 * c + j, 2 * c + k] += (
                        NEIGHBOURING_BINS * (weight * r) ** 2 * derivative[j] * derivative[k]
                    )
    for i in range(6):
        if not active[i // 2]:
            curvature[i, i] = 1.0
        curvature[i, i] += 1e-12
    inverse = np.linalg.inv(curvature)
    shift = inverse @ common
    return inverse @ spread @ inverse + np.outer(shift, shift)


@njit(nogil=True)
def _radiance(p: Any, patch: Any, light: float, c: int) -> float:
    """Radiance of a patch, given its irradiance and range (eq. 8); at most 1."""
    if not np.isfinite(patch[0]):
        return 1.0
    gain = contrast_gain(p[2 * c], patch[1])
    return min(radiance_of(patch[0], gain, p[2 * c + 1], light * p[2 * c + 1]), 1.0)
