# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Least-squares fit of attenuation and ambient light to the dark envelope (eq. 6-7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.light_model import transmission, veil_of
from uw_visibility.water.observations import Envelopes

ATTENUATION_BOUNDS = (1e-4, 10.0)
# Above the largest code: open water may be overexposed.
AMBIENT_LIGHT_MAX = 2.0

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
    """

    parameters: Array
    covariance: Array
    iterations: int
    converged: bool


def fit_plain(envelope: Envelopes, clear_water: Array, active: Mask) -> Fit:
    """Fit E = I∞(1 − e^(−βd)) with a symmetric robust loss, as the paper does.

    I∞ is at least the bright envelope (eq. 7); κ, `clear_water` (3,) in 1/m, is what β starts from.
    """
    # Imported here, since it takes long, and other methods do without.
    from scipy.optimize import least_squares

    parameters = np.full((3, 2), np.nan)
    covariance = np.zeros((6, 6))
    iterations, converged = 0, True
    for channel in np.flatnonzero(active).tolist():
        d, observed = envelope.range, envelope.dark[channel]
        lower = np.array([ATTENUATION_BOUNDS[0], envelope.least_light(channel)])
        start = np.array([clear_water[channel], envelope.bright[channel].max()])
        upper = np.array([ATTENUATION_BOUNDS[1], AMBIENT_LIGHT_MAX])
        inside = 1e-6 * (upper - lower)
        solution = least_squares(
            _residual, np.clip(start, lower + inside, upper - inside), jac=_jacobian,
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


def blank(covariance: Array, known: Mask) -> Array:
    """Copy of a (6, 6) covariance with NaN for unknown channels, (3,), or parameters, (6,)."""
    both = np.repeat(known, 6 // len(known))
    return np.where(np.outer(both, both), covariance, np.nan)
