# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Least-squares fit of attenuation and ambient light to the dark envelope (eq. 6-7)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.light_model import transmission, veil_of

ATTENUATION_BOUNDS = (1e-4, 10.0)
# Above the largest code: open water may be overexposed.
AMBIENT_LIGHT_MAX = 2.0

# Least ambient light over that before, where a measurement of attenuation moves it.
LEAST_LIGHT = 0.3

# Plain fit: residuals beyond this irradiance lose weight (soft L1).
PLAIN_SCALE = 0.01


@dataclass(frozen=True)
class Fit:
    """Outcome of a fit of all channels.

    Attributes
    ----------
    parameters : (3, 2) float64 ndarray
        Attenuation (1/m) and ambient light of R, G, B; NaN for inactive channels.
    covariance : (6, 6) float64 ndarray
        Of β_R, I∞_R, β_G, I∞_G, β_B, I∞_B; NaN for inactive channels.
    iterations : int
        Largest number over the channels.
    converged : bool
    cost : float
        Minus twice the log likelihood of the bins, up to a constant and as if they
        were independent; 0 for the plain fit.
    misfit : float
        Its part by residuals, per bin; 0 for the plain fit.
    durbin_watson : float
        See `lower_envelope.durbin_watson`; 2 for the plain fit.
    """

    parameters: Array
    covariance: Array
    iterations: int
    converged: bool
    cost: float = 0.0
    misfit: float = 0.0
    durbin_watson: float = 2.0


def fit_plain(distance: Array, dark: Array, ambient_min: Array, start: Array, active: Mask) -> Fit:
    """Fit E = I∞(1 − e^(−βd)) with a symmetric robust loss, as the paper does.

    `ambient_min` is the lower bound of I∞ (eq. 7), `start` (3, 2) holds β and I∞ to start from.
    """
    # Imported here, since it takes long, and other methods do without.
    from scipy.optimize import least_squares

    parameters = np.full((3, 2), np.nan)
    covariance = np.zeros((6, 6))
    iterations, converged = 0, True
    for channel in np.flatnonzero(active):
        known = np.isfinite(dark[channel])
        d, observed = distance[known], dark[channel, known]
        lower = np.array([ATTENUATION_BOUNDS[0], ambient_min[channel]])
        upper = np.array([ATTENUATION_BOUNDS[1], AMBIENT_LIGHT_MAX])
        inside = 1e-6 * (upper - lower)
        solution = least_squares(
            _residual, np.clip(start[channel], lower + inside, upper - inside), jac=_jacobian,
            bounds=(lower, upper), method="trf", loss="soft_l1", f_scale=PLAIN_SCALE,
            args=(d, observed))
        parameters[channel] = solution.x
        information = solution.jac.T @ solution.jac
        variance = 2 * solution.cost / max(len(d) - 2, 1)
        block = slice(2 * channel, 2 * channel + 2)
        covariance[block, block] = variance * np.linalg.pinv(information)
        iterations = max(iterations, solution.njev)
        converged &= bool(solution.status > 0)
    return Fit(parameters, blank(covariance, active), iterations, converged)


def _residual(parameters: Array, distance: Array, observed: Array) -> Array:
    return np.asarray(veil_of(parameters[1], transmission(parameters[0], distance)) - observed)


def _jacobian(parameters: Array, distance: Array, observed: Array) -> Array:
    transmitted = transmission(parameters[0], distance)
    return np.stack((parameters[1] * distance * transmitted, 1 - transmitted), axis=1)


def moved(fit: Fit, step: Array, known: Array) -> Fit:
    """Add a step to the parameters, and subtract known information from their covariance."""
    values, covariance = move(fit.parameters, fit.covariance, step, known)
    return replace(fit, parameters=values, covariance=covariance)


@njit(nogil=True)
def move(parameters: Any, covariance: Any, step: Any, known: Any) -> tuple[Any, Any]:
    """Parameters and covariance after a step; within bounds, and symmetric."""
    least, largest = ATTENUATION_BOUNDS
    values, rest = np.empty((3, 2)), np.empty((6, 6))
    for c in range(3):
        values[c, 0] = min(max(parameters[c, 0] + step[2 * c], least), largest)
        values[c, 1] = max(parameters[c, 1] + step[2 * c + 1], LEAST_LIGHT * parameters[c, 1])
    for i in range(6):
        for j in range(6):
            rest[i, j] = 0.5 * ((covariance[i, j] - known[i, j]) + (covariance[j, i] - known[j, i]))
    return values, rest


@njit(nogil=True)
def measure(
    parameters: Any, covariance: Any, attenuation: Any, noise: Any
) -> tuple[Any, Any, Any, Any]:
    """Measure the attenuations, (3,) 1/m, with a noise covariance, (3, 3): Kalman's update.

    Returns step (6,) and known (6, 6) for `move`, the inverse of the innovation's covariance (3,
    3), and the squared distance of the measurement from the fit, in standard deviations.
    """
    total = np.empty((3, 3))
    off = np.empty(3)
    for a in range(3):
        off[a] = attenuation[a] - parameters[a, 0]
        for b in range(3):
            total[a, b] = covariance[2 * a, 2 * b] + noise[a, b]
    information = np.linalg.inv(total)
    weighted = information @ off
    seen = np.empty((3, 6))
    for a in range(3):
        seen[a] = covariance[2 * a]
    return seen.T @ weighted, seen.T @ (information @ seen), information, off @ weighted


def blank(covariance: Array, known: Mask) -> Array:
    """Copy of a (6, 6) covariance with NaN for unknown channels, (3,), or parameters, (6,)."""
    both = np.repeat(known, 6 // len(known))
    return np.where(np.outer(both, both), covariance, np.nan)
