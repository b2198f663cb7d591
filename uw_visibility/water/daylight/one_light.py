# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""One light for veil and scene, as the paper has it (eq. 4-7).

With B = W the dark envelope has far more information than the trained posterior uses. So the
posterior is conditioned on B = W, and refined by the likelihood of the dark envelope:

    E = B (1 − e^(−βd)) + ρ B e^(−βd),    ρ ≥ 0.

ρ is mostly near 0, but not always: scenes lack black. So residuals above the curve of black count
little, and less the farther they are (Cauchy); below it there is nothing but noise, rounding and
wrong ranges, and residuals count by these (Geman-McClure).

Parameters are p = (ln β_R, ln B_R, ln β_G, ln B_G, ln β_B, ln B_B).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.light_model import transmission
from uw_visibility.water.daylight.inference import ATTENUATION_AND_VEIL, Posterior
from uw_visibility.water.observations import Envelopes

# Deviation of ln B − ln W.
ONE_LIGHT = 0.02
# Factor that widens the posterior, since the networks use the dark envelope, too.
WIDENED = 1.4
# Deviation of the darkest blocks from black, as a part of the direct light, below it and above; and
# the deviations beyond which residuals lose weight.
BELOW, ABOVE = 0.01, 0.2
OUTLIER_BELOW, OUTLIER_ABOVE = 1.0, 0.25
# A curve that starts above all bins would treat them all as outliers. So a second descent starts
# with ln β lower by this, and the better one is taken.
LOWER_START = 0.5
# Bins show darkness if direct light is so many times the noise. Distance of a scene's darkest
# blocks from black, as a part of their median radiance, and its least deviation.
INFORMATIVE = 5.0
DARKNESS = 0.2
LEAST_DARKNESS = 0.015
# Number of bins whose darkest blocks are of one object, with one error.
BINS_ALIKE = 3.0
# Deviation of ln B below the bright envelope, which no light is above (eq. 7).
BEYOND_WHITE = 0.02
# Deviation of ln β and ln B by errors of the model; in turbid water the fit has only noise.
MODEL_ERROR = np.array((0.02, 0.01) * 3)
ITERATIONS = 60
LONGEST_STEP = 0.5
SMALL_STEP = 1e-4
MOST_DAMPING = 1e9
# Tolerance that makes the prior of the light's colour negligible.
NOTHING_EXPECTED = 10.0


@dataclass(frozen=True)
class Daylight:
    """Daylight prior of the ambient light (eq. 2): I∞ ∝ white · exp(−K z) at some depth z."""

    white_reference: Array  # (3,), the camera's R, G, B of white at the surface; the scale is free
    # (3,), K of the water above, 1/m; None where it is the estimated attenuation itself
    diffuse_attenuation: Array | None

    def colour(self, attenuation: Array) -> tuple[Array, float]:
        """Direction in ln I∞, (3,), without effect of brightness or depth, and its value."""
        rate = attenuation if self.diffuse_attenuation is None else self.diffuse_attenuation
        direction = np.array([rate[2] - rate[1], rate[0] - rate[2], rate[1] - rate[0]])
        direction /= max(float(np.sqrt(direction @ direction)), 1e-9)
        return direction, float(direction @ np.log(self.white_reference))


class _Scales(NamedTuple):
    """Deviations of residuals below and above the curve, and expected darkness; (3, N), (3, 1)."""

    below: Array
    above: Array
    darkness: Array


class _Residuals(NamedTuple):
    """Residuals (3, N), their weights and derivatives by ln β and ln B, and the cost of all."""

    value: Array
    weight: Array
    slopes: Array
    cost: float


def fit_one_light(
    posterior: Posterior, envelope: Envelopes, seen: Mask, daylight: Daylight | None,
    daylight_tolerance: float,
) -> tuple[Array, Array]:
    """Fit β, 1/m, and B = W to the dark envelope, from the posterior: (3, 2).

    Also returns their covariance, (6, 6), channel by channel. `seen` (3,) are the channels whose
    envelope counts, `daylight` None for no prior of colour, `daylight_tolerance` the standard
    deviation of the logarithms of the ambient lights about those of daylight.
    """
    expected, spread = _with_one_light(posterior)
    least = np.full(3, -np.inf)
    for c in np.flatnonzero(seen).tolist():
        least[c] = np.log(max(envelope.least_light(c), 1e-9))
    known = np.broadcast_to(seen[:, np.newaxis], envelope.dark.shape)
    precision = np.asarray(np.linalg.inv(spread), np.float64)
    right = precision @ expected
    if daylight is not None and seen.all():
        direction, value = daylight.colour(np.exp(expected[0::2]))
        row = np.zeros(6)
        row[1::2] = direction / daylight_tolerance
        precision += np.outer(row, row)
        right += row * value / daylight_tolerance
    prior = _Prior(precision, right, least)
    start = expected.copy()
    start[1::2] = np.maximum(start[1::2], least)
    lower = start.copy()
    lower[0::2] -= LOWER_START
    found = [_descend(each, envelope, known, prior) for each in (start, lower)]
    p, _ = min(found, key=lambda each: each[1])
    covariance = _covariance(p, envelope, known, prior) + np.diag(MODEL_ERROR**2)
    parameters = np.exp(p)
    return parameters.reshape(3, 2), covariance * np.outer(parameters, parameters)


class _Prior(NamedTuple):
    """Gaussian prior p ~ N(P⁻¹ r, P⁻¹), and ln of the least light of each channel.

    `precision` P (6, 6), `right` r (6,), `least` (3,).
    """

    precision: Array
    right: Array
    least: Array

    def cost(self, p: Array) -> float:
        missing = np.maximum(self.least - p[1::2], 0.0) / BEYOND_WHITE
        return float(0.5 * p @ self.precision @ p - self.right @ p + 0.5 * missing @ missing)

    def normal_equations(self, p: Array) -> tuple[Array, Array]:
        """Curvature (6, 6) and descent direction (6,)."""
        missing = np.zeros(6)
        missing[1::2] = np.maximum(self.least - p[1::2], 0.0)
        weight = 1.0 / BEYOND_WHITE**2
        return (
            self.precision + np.diag(weight * (missing > 0.0)),
            self.right - self.precision @ p + weight * missing)


def _descend(p: Array, envelope: Envelopes, known: Mask, prior: _Prior) -> tuple[Array, float]:
    """Minimum next to `p`, and its cost; by Levenberg and Marquardt's steps."""
    damping = 1e-3
    for _ in range(ITERATIONS):
        scales = _scales(p, envelope)
        residuals = _residuals(p, envelope, known, scales)
        curvature = _squares(residuals.slopes, residuals.weight)
        slope = _sums(residuals.slopes, residuals.weight * residuals.value)
        of_prior, prior_slope = prior.normal_equations(p)
        before = residuals.cost + prior.cost(p)
        curvature += of_prior
        while damping < MOST_DAMPING:
            damped = curvature + damping * np.diag(np.diag(curvature))
            step = np.linalg.solve(damped, slope + prior_slope)
            moved = p + np.clip(step, -LONGEST_STEP, LONGEST_STEP)
            cost = _residuals(moved, envelope, known, scales).cost + prior.cost(moved)
            if cost <= before:
                break
            damping *= 10.0
        else:
            break
        p, length = moved, float(np.abs(moved - p).max())
        damping = max(damping * 0.1, 1e-9)
        if length < SMALL_STEP:
            break
    scales = _scales(p, envelope)
    return p, _residuals(p, envelope, known, scales).cost + prior.cost(p)


def _with_one_light(posterior: Posterior) -> tuple[Array, Array]:
    """Mean (6,) and covariance (6, 6) of ln β and ln B by turns, given B = W."""
    difference = np.zeros((3, 9))
    for c in range(3):
        difference[c, 3 * c + 1], difference[c, 3 * c + 2] = 1.0, -1.0
    off = posterior.covariance @ difference.T
    gain = off @ np.linalg.inv(difference @ off + ONE_LIGHT**2 * np.eye(3))
    mean = posterior.mean.ravel()
    mean = mean - gain @ (difference @ mean)
    covariance = posterior.covariance - gain @ off.T
    both = ATTENUATION_AND_VEIL
    return mean[both], WIDENED**2 * covariance[np.ix_(both, both)]


def _light(p: Array, envelope: Envelopes) -> tuple[Array, Array, Array]:
    """β and B, (3, 1), and direct light of white, (3, N)."""
    attenuation, light = np.exp(p[0::2])[:, np.newaxis], np.exp(p[1::2])[:, np.newaxis]
    direct = light * transmission(attenuation, envelope.dark_range)
    return attenuation, light, np.maximum(direct, 1e-12)


def _scales(p: Array, envelope: Envelopes) -> _Scales:
    attenuation, light, direct = _light(p, envelope)
    moved = envelope.range_error * envelope.dark_range**2 * attenuation * direct
    noise = np.hypot(envelope.deviation, moved)
    radiance = np.clip((envelope.dark - light + direct) / direct, 0.0, 1.0)
    radiance[direct <= INFORMATIVE * noise] = np.nan
    darkness = np.array([[_median(of_channel)] for of_channel in radiance]) * DARKNESS
    return _Scales(np.hypot(noise, BELOW * direct), np.hypot(noise, ABOVE * direct), darkness)


def _median(values: Array) -> float:
    """Median of the finite values; 0 without any."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def _residuals(p: Array, envelope: Envelopes, known: Mask, scales: _Scales) -> _Residuals:
    attenuation, light, direct = _light(p, envelope)
    dimmed = direct * (1.0 - scales.darkness)
    value = envelope.dark - light + dimmed
    below = value < 0.0
    sigma = np.where(below, scales.below, scales.above)
    limit = sigma * np.where(below, OUTLIER_BELOW, OUTLIER_ABOVE)
    q = 1.0 + (value / limit) ** 2
    cost = np.where(below, (value / sigma) ** 2 / q, (limit / sigma) ** 2 * np.log(q))
    weight = np.where(below, 1.0 / (q * sigma) ** 2, 1.0 / (q * sigma**2)) * known
    slopes = np.stack((attenuation * envelope.dark_range * dimmed, light - dimmed))
    return _Residuals(value, weight, slopes, 0.5 * float((cost * known).sum()))


def _squares(slopes: Array, weight: Array) -> Array:
    """Weighted squares of slopes (2, 3, N), summed for each channel: (6, 6)."""
    found = np.zeros((6, 6))
    for c in range(3):
        block, by = slice(2 * c, 2 * c + 2), slopes[:, c]
        found[block, block] = (by * weight[c]) @ by.T
    return found


def _sums(slopes: Array, factor: Array) -> Array:
    """Slopes (2, 3, N) times a factor (3, N), summed for each channel: (6,)."""
    return np.concatenate([slopes[:, c] @ factor[c] for c in range(3)])


def _covariance(p: Array, envelope: Envelopes, known: Mask, prior: _Prior) -> Array:
    """Sandwich covariance, plus the effect of darkest blocks that are not black."""
    scales = _scales(p, envelope)
    residuals = _residuals(p, envelope, known, scales)
    slopes, weight = residuals.slopes, residuals.weight
    spread = prior.precision + BINS_ALIKE * _squares(slopes, (weight * residuals.value) ** 2)
    _, _, direct = _light(p, envelope)
    # The standard deviation of darkness equals its mean.
    common = _sums(slopes, weight * direct * (LEAST_DARKNESS + scales.darkness))
    inverse = np.linalg.inv(_squares(slopes, weight) + prior.precision)
    shift = inverse @ common
    return np.asarray(inverse @ spread @ inverse + np.outer(shift, shift))
