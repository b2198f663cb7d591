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

import numpy as np
from numpy.typing import NDArray

from uw_visibility.optics.light_model import transmission, veil_thickness
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
# Images with either gradient beforehand: as light from above and particles that settle make
# it, and the other way round.
USUAL, UNUSUAL = 0.1, 0.02
# How large gradients are, as a part of veil or attenuation per height of the image.
VEIL_SPREAD, ATTENUATION_SPREAD = 0.6, 1.0
# A gradient that is less likely than this is none; logarithm of the largest evidence.
NEGLIGIBLE = 0.1
LARGEST_EVIDENCE = 50.0
# Least part of the light of dark patches that is the veil.
LEAST_VEIL = 0.6
# Channels have the same dark patches, and so err together; dark patches differ by no less
# than this part of the variance that is expected.
CHANNELS = 3.0
LEAST_SCATTER = 0.3
ITERATIONS = 3
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
    apart, weight = attenuation_apart(halves, ROWS, attenuation, veil, light)
    apart, weight = apart[active], weight[active]
    veil, light, noise = (
        of_channel[active, np.newaxis] for of_channel in (veil, light, halves.noise))
    rows, distance = halves.place[:, ROWS, both, 0], halves.range[:, ROWS, both]
    dark = np.maximum(halves.dark[:, ROWS, active][:, :, both], DARKEST)
    mean = dark.mean(axis=0)
    left = transmission(attenuation[active, np.newaxis], distance.mean(axis=0))
    # Halves differ in range as well, though less: by as much as neighbouring bins do.
    farther = np.log(distance[0] / distance[1])
    black = veil_thickness(np.minimum(dark / veil, 1.0 - LEAST_TRANSMISSION), 1.0)
    by_range = _slopes(
        np.log(distance.mean(axis=0)),
        np.concatenate((np.log(mean), (black / distance[:, np.newaxis]).mean(axis=0),
                        rows.mean(axis=0)[np.newaxis])))
    count = len(veil)
    beside = rows[0] - rows[1] - by_range[-1] * farther
    # Of what is not black, the veil is a part.
    part = np.clip(veil * (1.0 - left) / mean, LEAST_VEIL, 1.0)
    of_veil = (np.log(dark[0] / dark[1]) - by_range[:count] * farther) / part
    variance = ((DARKNESS * light * left) ** 2 + noise**2) / (part * mean) ** 2
    of_attenuation = apart - by_range[count:-1] * farther
    spread = ATTENUATION_SPREAD * float(attenuation[active].mean())
    return (
        _gradient(of_veil, 1.0 / variance, beside, VEIL_SPREAD, (USUAL, UNUSUAL)),
        _gradient(of_attenuation, weight, beside, spread, (UNUSUAL, USUAL)),
    )


def _slopes(x: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Slopes of the parabolas that fit (K, N) values over x best."""
    off = x - x.mean()
    found = np.linalg.lstsq(
        np.stack((np.ones_like(off), off, off**2), axis=1), values.T, rcond=None)[0]
    return np.asarray(found[1][:, np.newaxis] + 2.0 * found[2][:, np.newaxis] * off)


def _gradient(
    value: NDArray[np.float64], weight: NDArray[np.float64], rows: NDArray[np.float64],
    spread: float, priors: tuple[float, float],
) -> DarkGradient:
    """Robust regression through the origin, shrunk to its spread, and its odds.

    The priors are those of what falls downwards and of what rises.
    """
    weight = np.minimum(weight, np.median(weight, axis=1, keepdims=True))
    slope = total = 0.0
    for _ in range(ITERATIONS):
        robust = weight / (1.0 + weight * ((value - slope * rows) / TAIL) ** 2)
        total = float((robust * rows**2).sum())
        if total <= 0.0:
            return DarkGradient(0.0, spread, 0.0)
        slope = float((robust * rows * value).sum()) / total
    scatter = float((robust * (value - slope * rows) ** 2).sum()) / (value.size - len(value))
    variance = CHANNELS * max(scatter, LEAST_SCATTER) / total
    kept = spread**2 / (spread**2 + variance)
    evidence = 0.5 * (math.log(1.0 - kept) + kept * slope**2 / variance)
    prior = priors[0] if slope < 0 else priors[1]
    odds = prior / (1.0 - USUAL - UNUSUAL) * math.exp(min(evidence, LARGEST_EVIDENCE))
    return DarkGradient(kept * slope, math.sqrt(kept * variance), odds)


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
