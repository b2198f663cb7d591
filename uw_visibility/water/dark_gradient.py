# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Vertical gradient of veil or attenuation, as dark patches at equal range show it.

Looking ahead, far things are seen above near ones. A veil that is brighter above, or a layer
of turbid water below, then bends the dark envelope over range as no single water does. The
pixels of one range that are above their mean row and those below tell how much: a veil that
changes does so by the same part at every range, attenuation by the same optical depth per
metre. Each is as likely as the halves make it, against none (Bayesian model averaging).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.water.fit import Fit
from uw_visibility.water.observations import Envelopes
from uw_visibility.water.position import (
    DARKNESS,
    LEAST_TRANSMISSION,
    TAIL,
    HalfEnvelopes,
    attenuation_apart,
)
from uw_visibility.water.veil_gradient import PlaceCourse

# The split of `HalfEnvelopes` into the upper and the lower pixels of each range.
ROWS = 1
FEWEST_BINS = 4
# How far apart pixels of one range lie at least in the median range, as a part of the height:
# of ground that is seen in one row alone, the few that lie apart are wrong matches.
LEAST_APART = 0.04
# Images with either gradient beforehand: as light from above and particles that settle make
# it, and the other way round.
USUAL, UNUSUAL = 0.15, 0.03
# How large gradients are, as a part of veil or attenuation per height of the image.
VEIL_SPREAD, ATTENUATION_SPREAD = 0.6, 1.0
# A gradient that is less likely than this is none; logarithm of the largest evidence.
NEGLIGIBLE = 0.35
LARGEST_EVIDENCE = 50.0
# Least part of the light of dark patches that is the veil.
LEAST_VEIL = 0.6
# Channels have the same dark patches, and so err together; dark patches differ by no less
# than this part of the variance that is expected.
CHANNELS = 3.0
LEAST_SCATTER = 0.3
ITERATIONS = 4
# What makes a parabola over few ranges regular.
RIDGE = 1e-9
# Least irradiance, below that of any code value.
DARKEST = 1e-6
# Part of what a gradient of attenuation bends that an estimate follows, and its deviation.
FOLLOWED, FOLLOWED_DEVIATION = 0.4, 0.4


@dataclass(frozen=True)
class DarkGradient:
    """Change downwards of veil or attenuation, per height of the image.

    Attributes
    ----------
    slope, stddev : float
        Of the veil as a part of it, of attenuation in 1/m.
    odds : float
        How much likelier this is than no gradient.
    """

    slope: float
    stddev: float
    odds: float


def find_gradients(
    halves: HalfEnvelopes, active: NDArray[np.bool_], attenuation: NDArray[np.float64],
    veil: NDArray[np.float64], light: NDArray[np.float64],
) -> tuple[DarkGradient, DarkGradient] | None:
    """Find how the veil, or attenuation, changes downwards, each as if the other did not.

    Parameters
    ----------
    halves : HalfEnvelopes
    active : (3,) bool ndarray
        Channels that count.
    attenuation, veil, light : (3,) float64 ndarray
        β, B and W as estimated.

    Returns
    -------
    tuple of DarkGradient, or None
        Of the veil and of attenuation; None where too few ranges are seen in two places.
    """
    both = np.isfinite(halves.range[:, ROWS]).all(axis=0)
    if both.sum() < FEWEST_BINS:
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
        _sure_gradient(values[1], weights[1], beside, spread, (UNUSUAL, USUAL)),
    )


@njit(nogil=True)
def _values(
    distance: Any, rows: Any, dark: Any, attenuation: Any, veil: Any, light: Any, noise: Any,
    values: Any, weights: Any, beside: Any,
) -> None:
    """What halves differ in veil and attenuation, and in rows, but for what they do in range."""
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
    """Slopes of the parabola that fits values over x best."""
    off = x - x.mean()
    columns = np.stack((np.ones_like(off), off, off**2))
    found = np.linalg.solve(columns @ columns.T + RIDGE * np.eye(3), columns @ values)
    return found[1] + 2.0 * found[2] * off


def _sure_gradient(
    values: NDArray[np.float64], weights: NDArray[np.float64], rows: NDArray[np.float64],
    spread: float, priors: tuple[float, float],
) -> DarkGradient:
    """The less likely of the gradient that all ranges show, and that without the most telling one.

    Wrong matches put far rows side by side at one range, which then outweighs all others.
    """
    leverage = np.median(weights, axis=0) * rows**2
    others = np.arange(len(rows)) != int(leverage.argmax())
    return min(
        _gradient(values, weights.copy(), rows, spread, priors),
        _gradient(values[:, others], weights[:, others], rows[others], spread, priors),
        key=lambda gradient: gradient.odds)


def _gradient(
    values: NDArray[np.float64], weights: NDArray[np.float64], rows: NDArray[np.float64],
    spread: float, priors: tuple[float, float],
) -> DarkGradient:
    """Robust regression through the origin, shrunk to its spread, and its odds.

    The priors are those of what falls downwards and of what rises.
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
                robust = weights[c, at] / (1.0 + weights[c, at] * (off / TAIL) ** 2)
                total += robust * rows[at] ** 2
                product += robust * rows[at] * values[c, at]
                scatter += robust * off**2
        if total <= 0.0:
            break
        slope = product / total
    return slope, scatter / (values.size - len(values)), total


def bend_of(gradient: DarkGradient, places: PlaceCourse, envelope: Envelopes) -> float:
    """Slope over range of the optical depth that a gradient of attenuation adds, 1/m.

    Parameters
    ----------
    gradient : DarkGradient
        Of attenuation.
    places : PlaceCourse
        Where in the image the ranges lie.
    envelope : Envelopes
    """
    below = np.interp(envelope.range, places.range, places.place[:, 0])
    added = gradient.slope * (below - below.mean()) * envelope.range
    weight = np.sqrt(envelope.count)
    off = envelope.range - np.average(envelope.range, weights=weight)
    return float((weight * off) @ added / ((weight * off) @ off))


def unbent(fit: Fit, bend: float, share: float, clear_water: NDArray[np.float64]) -> Fit:
    """Average of a fit and of what it is without a bend.

    Parameters
    ----------
    fit : Fit
    bend : float
        That of `bend_of`, 1/m.
    share : float
        Probability of the gradient that makes it.
    clear_water : (3,) float64 ndarray
        κ, 1/m: attenuation is not lowered below it.
    """
    parameters, covariance = fit.parameters.copy(), fit.covariance.copy()
    least = np.minimum(parameters[:, 0], clear_water)
    parameters[:, 0] = np.maximum(parameters[:, 0] - share * FOLLOWED * bend, least)
    covariance[0::2, 0::2] += bend**2 * share * (
        (1.0 - share) * FOLLOWED**2 + FOLLOWED_DEVIATION**2)
    return replace(fit, parameters=parameters, covariance=covariance)
