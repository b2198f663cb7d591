# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Vertical gradient of veil or attenuation, from dark patches at equal range.

Looking ahead, far things are seen above near ones. A veil that is brighter above, or a layer of
turbid water below, then bends the dark envelope over range as no single water does. The pixels of a
range above and below their mean row show how much: a gradient of the veil changes it by the same
part at every range, one of attenuation by the same optical depth per metre. Each is weighed against
none by the likelihood of the halves (Bayesian model averaging).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.water.daylight.fit import Fit
from uw_visibility.water.daylight.position import (
    DARKNESS,
    LEAST_TRANSMISSION,
    TAIL,
    HalfEnvelopes,
    attenuation_apart,
)
from uw_visibility.water.daylight.veil_gradient import PlaceCourse
from uw_visibility.water.observations import Envelopes
from uw_visibility.water.robust import cauchy_weight_by_precision

# The split of `HalfEnvelopes` into the upper and the lower pixels of each range.
ROWS = 1
FEWEST_GRADIENT_BINS = 4
# Least distance of upper and lower pixels in the median range, over the height: on ground that is
# seen in one row alone, the few that lie apart are wrong matches.
LEAST_APART = 0.04
# Priors of a gradient: as by light from above and settling particles, and the other way round.
USUAL, UNUSUAL = 0.15, 0.03
# Prior deviation of gradients, relative to veil or attenuation, per height of the image.
VEIL_SPREAD, ATTENUATION_SPREAD = 0.6, 1.0
# Less likely gradients are ignored; largest log evidence.
LEAST_SHARE = 0.35
LARGEST_EVIDENCE = 50.0
# Least part of the light of dark patches that is the veil.
LEAST_VEIL = 0.6
# Channels share dark patches, and so their errors; least scatter over the expected variance.
CHANNELS = 3.0
LEAST_SCATTER = 0.3
ITERATIONS = 4
# Regularises a parabola over few ranges.
RIDGE = 1e-9
# Least irradiance, below that of any code value.
DARKEST = 1e-6
# Part of a gradient's bend that an estimate follows, and its deviation.
FOLLOWED, FOLLOWED_DEVIATION = 0.4, 0.4


@dataclass(frozen=True)
class DarkGradient:
    """Change downwards of veil (relative) or attenuation (1/m), per height of the image.

    `odds` are those of the gradient against none.
    """

    slope: float
    stddev: float
    odds: float


def find_gradients(
    halves: HalfEnvelopes, active: Mask, attenuation: Array, veil: Array, light: Array
) -> tuple[DarkGradient, DarkGradient] | None:
    """Find the gradients of the veil and of attenuation, each as if the other were none.

    None where too few ranges are seen in two places.
    """
    both = np.isfinite(halves.range[:, ROWS]).all(axis=0)
    if both.sum() < FEWEST_GRADIENT_BINS:
        return None
    values, weights = np.zeros((2, 2, np.count_nonzero(active), np.count_nonzero(both)))
    beside = np.empty(values.shape[2])
    # Of one layout, or the kernel would be compiled once more, in flight.
    _values(*map(np.ascontiguousarray, (
        halves.range[:, ROWS, both], halves.place[:, ROWS, both, 0],
        np.maximum(halves.dark[:, ROWS, active][:, :, both], DARKEST), attenuation[active],
        veil[active], light[active], halves.noise[active])), values, weights, beside)
    if np.median(np.abs(beside)) < LEAST_APART:
        return None
    spread = ATTENUATION_SPREAD * float(attenuation[active].mean())
    return (
        _sure_gradient(values[0], weights[0], beside, VEIL_SPREAD, (USUAL, UNUSUAL)),
        _sure_gradient(values[1], weights[1], beside, spread, (UNUSUAL, USUAL)))


@njit(nogil=True)
def _values(
    distance: Any, rows: Any, dark: Any, attenuation: Any, veil: Any, light: Any, noise: Any,
    values: Any, weights: Any, beside: Any,
) -> None:
    """Upper minus lower half: veil and attenuation differences per bin, range effect removed."""
    logarithm = np.log(0.5 * (distance[0] + distance[1]))
    farther = np.log(distance[0] / distance[1])
    beside[:] = rows[0] - rows[1] - _slopes(logarithm, 0.5 * (rows[0] + rows[1])) * farther
    for c in range(len(veil)):
        mean = 0.5 * (dark[0, c] + dark[1, c])
        black = -np.log(np.maximum(1.0 - dark[:, c] / veil[c], LEAST_TRANSMISSION)) / distance
        of_veil = _slopes(logarithm, np.log(mean)) * farther
        of_attenuation = _slopes(logarithm, 0.5 * (black[0] + black[1])) * farther
        for at in range(len(farther)):
            left = math.exp(-attenuation[c] * 0.5 * (distance[0, at] + distance[1, at]))
            # Of what is not black, the veil is a part.
            part = min(max(veil[c] * (1.0 - left) / mean[at], LEAST_VEIL), 1.0)
            values[0, c, at] = (math.log(dark[0, c, at] / dark[1, c, at]) - of_veil[at]) / part
            weights[0, c, at] = (part * mean[at]) ** 2 / (
                (DARKNESS * light[c] * left) ** 2 + noise[c] ** 2)
            apart, weights[1, c, at] = attenuation_apart(
                distance[0, at], distance[1, at], dark[0, c, at], dark[1, c, at], veil[c],
                light[c], noise[c])
            values[1, c, at] = apart - of_attenuation[at]


@njit(nogil=True)
def _slopes(x: Any, values: Any) -> Any:
    """Slopes of the least-squares parabola of values over x."""
    off = x - x.mean()
    columns = np.stack((np.ones_like(off), off, off**2))
    found = np.linalg.solve(columns @ columns.T + RIDGE * np.eye(3), columns @ values)
    return found[1] + 2.0 * found[2] * off


def _sure_gradient(
    values: Array, weights: Array, rows: Array, spread: float, priors: tuple[float, float]
) -> DarkGradient:
    """The less likely gradient of two: by all ranges, and without the most influential one.

    Wrong matches put far rows side by side at one range, which then outweighs all others.
    """
    leverage = np.median(weights, axis=0) * rows**2
    others = np.arange(len(rows)) != int(leverage.argmax())
    return min(
        _gradient(values, weights.copy(), rows, spread, priors),
        _gradient(values[:, others], weights[:, others], rows[others], spread, priors),
        key=lambda gradient: gradient.odds)


def _gradient(
    values: Array, weights: Array, rows: Array, spread: float, priors: tuple[float, float]
) -> DarkGradient:
    """Robust regression through the origin, shrunk to its prior spread, and its odds.

    The priors are those of a fall and of a rise downwards.
    """
    slope, scatter, total = _regress(values, weights, rows)
    if total <= 0.0:
        return DarkGradient(0.0, spread, 0.0)
    variance = CHANNELS * max(scatter, LEAST_SCATTER) / total
    kept = spread**2 / (spread**2 + variance)
    evidence = 0.5 * (math.log(1.0 - kept) + kept * slope**2 / variance)
    prior = priors[0] if slope < 0 else priors[1]
    odds = prior / (1.0 - USUAL - UNUSUAL) * math.exp(min(evidence, LARGEST_EVIDENCE))
    return DarkGradient(kept * slope, math.sqrt(kept * variance), odds)


@njit(nogil=True)
def _regress(values: Any, weights: Any, rows: Any) -> tuple[float, float, float]:
    """Slope through the origin, mean square of the residuals, and sum of the weights."""
    slope = total = scatter = 0.0
    for c in range(len(values)):
        weights[c] = np.minimum(weights[c], np.median(weights[c]))
    for _ in range(ITERATIONS):
        total = product = scatter = 0.0
        for c in range(len(values)):
            for at in range(len(rows)):
                off = values[c, at] - slope * rows[at]
                robust = cauchy_weight_by_precision(off, weights[c, at], TAIL)
                total += robust * rows[at] ** 2
                product += robust * rows[at] * values[c, at]
                scatter += robust * off**2
        if total <= 0.0:
            break
        slope = product / total
    return slope, scatter / (values.size - len(values)), total


def bend_of(gradient: DarkGradient, places: PlaceCourse, envelope: Envelopes) -> float:
    """Slope over range of the optical depth that a gradient of attenuation adds, 1/m."""
    below = np.interp(envelope.range, places.range, places.place[:, 0])
    added = gradient.slope * (below - below.mean()) * envelope.range
    weight = np.sqrt(envelope.count)
    off = envelope.range - np.average(envelope.range, weights=weight)
    return float((weight * off) @ added / ((weight * off) @ off))


def unbent(fit: Fit, bend: float, share: float, clear_water: Array) -> Fit:
    """Average of a fit and of the same fit without a bend (1/m) of probability `share`.

    Attenuation is not lowered below clear water's.
    """
    parameters, covariance = fit.parameters.copy(), fit.covariance.copy()
    least = np.minimum(parameters[:, 0], clear_water)
    parameters[:, 0] = np.maximum(parameters[:, 0] - share * FOLLOWED * bend, least)
    covariance[0::2, 0::2] += bend**2 * share * (
        (1.0 - share) * FOLLOWED**2 + FOLLOWED_DEVIATION**2)
    return replace(fit, parameters=parameters, covariance=covariance)
