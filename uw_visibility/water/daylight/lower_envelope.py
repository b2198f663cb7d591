# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Robust fit of the lower envelope, all channels together (eq. 6-7).

The loss is asymmetric: Geman-McClure below the curve of black, Cauchy above it. A bin holds a patch
of radiance ρ ≥ 0 as its darkest, mostly near black. Below the curve there is nothing but noise,
rounding and wrong ranges; above it, scenes that lack black. So bins below the curve count by their
noise; bins above it count little, and less the farther they are.

In the kernels, p is (6,): β_R, I∞_R, β_G, I∞_G, β_B, I∞_B; distance (m), dark and deviation
(irradiance) and known are (3, N) over channels and bins; left is their transmission; scale is
(SCALES, 3, N) as `set_scales` fills it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.compute.linear import solve
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.light_model import contrast_gain, radiance_of, transmission, veil_of
from uw_visibility.water.daylight.fit import AMBIENT_LIGHT_MAX, ATTENUATION_BOUNDS, Fit, blank
from uw_visibility.water.daylight.priors import add_weak_priors, weak_channel_tolerance

# The scales of the loss, as `set_scales` fills them in.
BELOW, ABOVE, LIMIT_BELOW, LIMIT_ABOVE, NOISE, EXPECTED = range(6)
SCALES = 6

# Deviation of the darkest patches from black, as a part of the direct light: below it and above.
DARKNESS_BELOW = 0.01
DARKNESS_ABOVE = 0.2
# Residuals lose weight beyond so many of their scales. Below the curve they can only be wrong.
# The brightest patch tells the level, and measured ranges count less: a few wrong matches in a bin
# would weigh as much as all bins above the curve.
OUTLIER_ABOVE = 0.25
OUTLIER_BELOW = 5.0
OUTLIER_BELOW_MEASURED = 2.0
# Distance from black common to a scene's darkest patches, over their scatter: mean, and deviation.
EXPECTED_DARKNESS = 0.2
DARKNESS_DEVIATION = 0.2
DARKNESS_DEVIATION_MIN = 0.015
# It grows with how far the brightest patch is below a bright one.
BRIGHT_RADIANCE = 0.8
DULLNESS_DEVIATION = 0.3
# Bins show darkness where direct light is so many times the noise.
INFORMATIVE = 5.0
UNKNOWN_DARKNESS = 0.3


class _Bins(NamedTuple):
    """Darkest patches over range; see `fit_lower_envelope`."""

    distance: Array
    dark: Array
    deviation: Array
    known: Mask
    range_error: float
    # Scales below the curve beyond which a bin loses weight.
    outlier: float


@njit(nogil=True)
def transmit(p: Any, distance: Any, left: Any) -> None:
    """Write the transmission of each bin: once, since exponentials take most of a fit's time."""
    for c in range(3):
        for i in range(distance.shape[1]):
            left[c, i] = transmission(p[2 * c], distance[c, i])


@njit(nogil=True)
def set_scales(p: Any, bins: Any, left: Any, darkness: float, scale: Any) -> None:
    """Set the scales of residuals for parameters `p`.

    `darkness` is the expected distance of the darkest patches from black over their scatter.
    """
    distance, deviation = bins.distance, bins.deviation
    for c in range(3):
        for i in range(distance.shape[1]):
            d = distance[c, i]
            direct = p[2 * c + 1] * left[c, i]
            displacement = bins.range_error * d * d * p[2 * c] * direct
            variance = deviation[c, i] ** 2 + displacement * displacement
            scale[NOISE, c, i] = np.sqrt(variance)
            scale[BELOW, c, i] = np.sqrt(variance + (DARKNESS_BELOW * direct) ** 2)
            scale[ABOVE, c, i] = np.sqrt(variance + (DARKNESS_ABOVE * direct) ** 2)
            scale[LIMIT_ABOVE, c, i] = OUTLIER_ABOVE * scale[ABOVE, c, i]
            scale[LIMIT_BELOW, c, i] = bins.outlier * scale[BELOW, c, i]
    typical = typical_darkness(p, bins, left, scale)
    for c in range(3):
        shown = np.isfinite(typical[c])
        scale[EXPECTED, c, :] = darkness * typical[c] if shown else 0.0


@njit(nogil=True)
def typical_darkness(p: Any, bins: Any, left: Any, scale: Any) -> Any:
    """Median radiance of the darkest patches of bins, (3,); NaN where none shows."""
    dark, known = bins.dark, bins.known
    result = np.empty(3)
    radiance = np.empty(dark.shape[1])
    for c in range(3):
        number = 0
        for i in range(dark.shape[1]):
            direct = p[2 * c + 1] * left[c, i]
            if known[c, i] and direct > INFORMATIVE * scale[NOISE, c, i]:
                excess = dark[c, i] - p[2 * c + 1] + direct
                radiance[number] = min(max(excess / direct, 0.0), 1.0)
                number += 1
        result[c] = np.median(radiance[:number]) if number > 0 else np.nan
    return result


@njit(nogil=True)
def residual(p: Any, left: Any, dark: Any, scale: Any, c: int, i: int) -> float:
    """Residual of a bin: its irradiance above the curve of the darkest patches."""
    return float(dark[c, i] - veil_of(p[2 * c + 1], left[c, i] * (1.0 - scale[EXPECTED, c, i])))


@njit(nogil=True)
def loss(r: float, scale: Any, c: int, i: int) -> tuple[float, float]:
    """Cost of a residual and its weight: Geman-McClure below the curve, Cauchy above."""
    if r < 0:
        sigma, limit = scale[BELOW, c, i], scale[LIMIT_BELOW, c, i]
        q = 1.0 + (r / limit) ** 2
        return (r / sigma) ** 2 / q, 1.0 / (q * sigma) ** 2
    sigma, limit = scale[ABOVE, c, i], scale[LIMIT_ABOVE, c, i]
    q = 1.0 + (r / limit) ** 2
    return (limit / sigma) ** 2 * np.log(q), 1.0 / (q * sigma * sigma)


@njit(nogil=True)
def total_loss(p: Any, bins: Any, left: Any, scale: Any) -> float:
    """Cost of all bins."""
    dark, known = bins.dark, bins.known
    cost = 0.0
    for c in range(3):
        for i in range(dark.shape[1]):
            if known[c, i]:
                cost += loss(residual(p, left, dark, scale, c, i), scale, c, i)[0]
    return cost


@njit(nogil=True)
def add_normal_equations(
    p: Any, bins: Any, left: Any, scale: Any, hessian: Any, slope: Any
) -> float:
    """Add the bins' curvature and descent direction; return their cost."""
    distance, dark, known = bins.distance, bins.dark, bins.known
    cost = 0.0
    derivative = np.empty(2)
    for c in range(3):
        for i in range(dark.shape[1]):
            if not known[c, i]:
                continue
            r = residual(p, left, dark, scale, c, i)
            part, weight = loss(r, scale, c, i)
            cost += part
            differentiate(p, distance, left, scale, c, i, derivative)
            for j in range(2):
                slope[2 * c + j] += weight * derivative[j] * r
                for k in range(2):
                    hessian[2 * c + j, 2 * c + k] += weight * derivative[j] * derivative[k]
    return cost


@njit(nogil=True)
def differentiate(
    p: Any, distance: Any, left: Any, scale: Any, c: int, i: int, derivative: Any
) -> None:
    """Derivatives of the curve by attenuation and ambient light."""
    fading = left[c, i] * (1.0 - scale[EXPECTED, c, i])
    derivative[0] = p[2 * c + 1] * distance[c, i] * fading
    derivative[1] = 1.0 - fading


@njit(nogil=True)
def darkness_deviation(typical: float, brightest: float) -> float:
    """Standard deviation of how far from black a scene's darkest patches are.

    A dull scene lacks black as well as white.
    """
    shown = typical if np.isfinite(typical) else UNKNOWN_DARKNESS
    dullness = min(max(BRIGHT_RADIANCE - brightest, 0.0), 1.0)
    return DARKNESS_DEVIATION_MIN + DARKNESS_DEVIATION * shown + DULLNESS_DEVIATION * dullness


MAX_ITERATIONS = 60
# Later the scales are held, so that the cost can only fall.
ADAPTIVE_ITERATIONS = 30
# Until then the darkest patches are taken as black: far from the solution, their distance from
# black would be misjudged, and the misjudgement would confirm itself.
BLACK_ITERATIONS = 6
# Bins whose darkest patches belong to one object, and so deviate together.
DARK_BINS_ALIKE = 3.0


def fit_lower_envelope(
    distance: Array, dark: Array, deviation: Array, ambient_min: Array, start: Array,
    clear_water: Array, active: Mask, range_error: float = 0.0, bright: Array | None = None,
    patches: Array | None = None,
) -> Fit:
    """Robust fit of the lower envelope of dark patches, all channels together.

    Three weak priors act where the data are weak: β ≥ κ (eq. 3), I∞ near the brightest patch, and
    an attenuation by particles that is similar in the three channels.

    Parameters
    ----------
    distance, dark, deviation : (3, N) float64 ndarray
        Range of the dark patch of each bin, m; dark envelope, and its standard deviation.
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
        Irradiance and range of the brightest near patch, per channel. The
        less white it is, the less the darkest patches may be trusted to be black.
    patches : (3, N, 3) float64 ndarray, optional
        Range, irradiance and code step of the bright envelope: see `priors.add_white_prior`.
        I∞ is near its lower bound where absent.

    Returns
    -------
    Fit
        With the sandwich covariance of the weighted estimate, plus
        the effect of a scene whose darkest patches are all not black.
    """
    lower, upper = np.empty((2, 6))
    lower[0::2], upper[0::2] = ATTENUATION_BOUNDS
    lower[1::2] = ambient_min
    upper[1::2] = AMBIENT_LIGHT_MAX
    # One kernel for arrays of any order in memory.
    distance, dark, deviation = (np.ascontiguousarray(a) for a in (distance, dark, deviation))
    known = active[:, np.newaxis] & np.isfinite(dark)
    bins = _Bins(
        np.where(known, distance, 1.0), np.where(known, dark, 0.0),
        np.where(known, deviation, 1.0), known, float(range_error),
        OUTLIER_BELOW_MEASURED if range_error > 0.0 else OUTLIER_BELOW)
    found = _minimise(
        bins, active, np.minimum(np.maximum(start.ravel(), lower), upper), lower, upper,
        clear_water, np.full((3, 2), np.inf) if bright is None else bright,
        np.empty((3, 0, 3)) if patches is None else np.ascontiguousarray(patches))
    parameters = np.where(active[:, np.newaxis], found.parameters.reshape(3, 2), np.nan)
    return Fit(
        parameters, blank(found.covariance, active), int(found.iterations),
        bool(found.converged))


class _Minimum(NamedTuple):
    """See `Fit`; the parameters are (6,)."""

    parameters: Array
    covariance: Array
    iterations: int
    converged: bool


@njit(nogil=True)
def _minimise(
    bins: Any, active: Any, start: Any, lower: Any, upper: Any, clear_water: Any, bright: Any,
    patches: Any,
) -> Any:
    """Damped Gauss-Newton within bounds; scales follow the parameters at first."""
    distance = bins.distance
    p = start.copy()
    scale = np.empty((SCALES, 3, distance.shape[1]))
    left, trial_left = np.empty(distance.shape), np.empty(distance.shape)
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
            set_scales(p, bins, left, darkness, scale)
            tolerance = weak_channel_tolerance(p, active, clear_water)
        hessian[:] = 0.0
        slope[:] = 0.0
        cost = add_normal_equations(p, bins, left, scale, hessian, slope)
        cost += add_weak_priors(
            p, active, clear_water, lower[1::2], tolerance, True, patches, hessian, slope)
        while True:
            trial = _step(p, hessian, slope, damping, lower, upper, active)
            move = np.max(np.abs(trial - p) / (1e-3 + np.abs(p)))
            if move < 1e-8:
                converged = iterations > BLACK_ITERATIONS
                break
            transmit(trial, distance, trial_left)
            trial_cost = total_loss(trial, bins, trial_left, scale)
            trial_cost += add_weak_priors(
                trial, active, clear_water, lower[1::2], tolerance, True, patches, scratch,
                scratch_slope)
            if trial_cost <= cost:
                p = trial
                left, trial_left = trial_left, left
                damping = max(damping * 0.1, 1e-9)
                converged = move < 1e-4 and iterations > BLACK_ITERATIONS
                break
            damping *= 10.0
    set_scales(p, bins, left, EXPECTED_DARKNESS, scale)
    covariance = _covariance(
        p, bins, left, active, clear_water, lower, bright, patches, scale)
    return _Minimum(p, covariance, iterations, converged)


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
    p: Any, bins: Any, left: Any, active: Any, clear_water: Any, lower: Any, bright: Any,
    patches: Any, scale: Any,
) -> Any:
    """Sandwich covariance, plus the effect of darkest patches that are not black."""
    distance, dark, known = bins.distance, bins.dark, bins.known
    curvature = np.zeros((6, 6))
    slope = np.zeros(6)
    tolerance = weak_channel_tolerance(p, active, clear_water)
    # A bound that holds attenuation up says nothing about how far it may be above.
    add_weak_priors(
        p, active, clear_water, lower[1::2], tolerance, False, patches, curvature, slope)
    # A prior's score varies as much as its curvature says; a bin's as much as
    # its residual shows.
    spread = curvature.copy()
    add_normal_equations(p, bins, left, scale, curvature, slope)
    typical = typical_darkness(p, bins, left, scale)
    common = np.zeros(6)
    derivative = np.empty(2)
    for c in range(3):
        darkness = darkness_deviation(typical[c], _radiance(p, bright[c], c))
        for i in range(distance.shape[1]):
            if not known[c, i]:
                continue
            r = residual(p, left, dark, scale, c, i)
            _, weight = loss(r, scale, c, i)
            differentiate(p, distance, left, scale, c, i, derivative)
            direct = p[2 * c + 1] * left[c, i]
            for j in range(2):
                common[2 * c + j] += weight * derivative[j] * darkness * direct
                for k in range(2):
                    spread[2 * c + j, 2 * c + k] += (
                        DARK_BINS_ALIKE * (weight * r) ** 2 * derivative[j] * derivative[k])
    for i in range(6):
        if not active[i // 2]:
            curvature[i, i] = 1.0
        curvature[i, i] += 1e-12
    inverse = np.linalg.inv(curvature)
    shift = inverse @ common
    return inverse @ spread @ inverse + np.outer(shift, shift)


@njit(nogil=True)
def _radiance(p: Any, patch: Any, c: int) -> float:
    """Radiance of a patch of known irradiance and range (eq. 8); at most 1."""
    if not np.isfinite(patch[0]):
        return 1.0
    gain = contrast_gain(p[2 * c], patch[1])
    return min(radiance_of(patch[0], gain, p[2 * c + 1], p[2 * c + 1]), 1.0)
