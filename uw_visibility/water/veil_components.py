# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fits of the dark envelope for each veil that may be, and how likely each is.

The dark envelope shows little more than B β. So it is fitted for a grid of veils over the
brightest patch, and for the veil that open water shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.optics.light_model import transmission
from uw_visibility.water.clear_water import hold_above_clear_water
from uw_visibility.water.contrast import Decay
from uw_visibility.water.fit import (
    AMBIENT_LIGHT_MAX,
    ATTENUATION_BOUNDS,
    Fit,
    measure,
    moved,
)
from uw_visibility.water.lower_envelope import NEIGHBOURING_BINS
from uw_visibility.water.observations import Envelopes
from uw_visibility.water.open_water import OpenWater
from uw_visibility.water.priors import BRIGHT_RADIANCE, CLEAR_WATER_TOLERANCE

# Veil over the brightest patch, and how likely each is beforehand: half of the frames
# are as the paper has it. In this order, so that what is hopeless is not fitted.
RATIOS = (1.0, 0.7, 0.5, 0.36, 0.26, 1.2)
PRIOR = (0.45, 0.16, 0.13, 0.11, 0.09, 0.06)
COARSE_RATIOS = (1.0, 0.5)
# A ratio whose logarithm of likelihood is so far below that of the best ends the search
# among lower ones.
HOPELESS = 8.0
# How far a channel's veil is from such a ratio, as a logarithm; and where it is as the paper has
# it, which is said more narrowly.
RATIO_TOLERANCE = 0.25
PAPER_TOLERANCE = 0.22
# Bounds of the veil in units of what is known of it, or of its deviation.
BELOW, ABOVE, DEVIATIONS = 0.8, 1.4, 2.5
LIGHT_LIMITS = (0.5, 8.0)
# Eigenvalue of a fit's correlations from which on rounding has not spoilt it.
LEAST_EIGENVALUE = 1e-6
# Likelihoods have longer tails than a normal law (Cauchy's scale, in deviations).
TAIL = 2.0
# What bins say together is worth so many times less than as if neighbours alone were alike:
# the darkest patches of a whole scene follow no law.
TEMPERATURE = 6.0


class PossibleVeil(NamedTuple):
    """Veil that is taken for possible, and the light on the scene that goes with it.

    Attributes
    ----------
    lower, upper : (3,) float64 ndarray
        Bounds of the veil.
    light : (3,) float64 ndarray
        Light on the scene over the veil, W / B.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    light: NDArray[np.float64]


class FitVeil(Protocol):
    """Fit of the dark envelope for a veil that may be.

    None where most dark patches are lighter than its upper bound by more than noise: no water
    makes black so light.
    Where the attenuation is given, 1/m, (3,), the veil alone is fitted.
    """

    def __call__(
        self, veil: PossibleVeil, attenuation: NDArray[np.float64] | None = None
    ) -> Fit | None: ...


FuseVeil = Callable[
    [Fit, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], Fit]
"""Fuse with priors: the fit, W / B, the veil and the deviation of its logarithm."""


class EnvelopeFit(NamedTuple):
    """Fit of the dark envelope for one ratio of veil and brightest patch.

    Attributes
    ----------
    fit : Fit or None
        None where no ratio gives one.
    likelihood : float
        Its logarithm, of the dark envelope.
    """

    fit: Fit | None = None
    likelihood: float = -math.inf


class Component(NamedTuple):
    """Fit for one veil that may be, and how likely it is.

    Attributes
    ----------
    fused : Fit
        With priors.
    held : Fit
        With the decay of contrast too, and above clear water's attenuation.
    likelihood : float
        Its logarithm.
    veil : PossibleVeil or None
        What the dark envelope was fitted with, where it is as the paper has it; else None.
    """

    fused: Fit
    held: Fit
    likelihood: float
    veil: PossibleVeil | None


class RatioFits(NamedTuple):
    """Fits for the ratios of veil and brightest patch.

    Attributes
    ----------
    components : list of Component
    best : EnvelopeFit
        Of the likeliest by the dark envelope alone.
    """

    components: list[Component]
    best: EnvelopeFit


def fit_ratios(
    fit: FitVeil, fuse: FuseVeil, brightest: NDArray[np.float64],
    clear_water: NDArray[np.float64], contrast: Decay | None, ratios: tuple[float, ...],
) -> RatioFits:
    """Fit for each ratio of veil and brightest patch."""
    components: list[Component] = []
    best, hopeless = EnvelopeFit(), False
    for ratio in ratios:
        if hopeless and ratio < 1.0:
            continue
        veil = _veil_of_ratio(ratio, brightest)
        found = _fit_ratio(fit, veil)
        if found is None:
            continue
        alone = _likelihood(found, clear_water)
        best = _likelier(best, found, alone)
        hopeless = alone < best.likelihood - HOPELESS
        as_the_paper = ratio == 1.0
        tolerance = PAPER_TOLERANCE if as_the_paper else RATIO_TOLERANCE
        fused = fuse(found, veil.light, 1.05 * ratio * brightest, np.full(3, tolerance))
        likelihood = alone + math.log(PRIOR[RATIOS.index(ratio)])
        components.append(_component(
            fused, likelihood, clear_water, contrast, veil if as_the_paper else None))
    return RatioFits(components, best)


def fit_best_ratio(
    fit: FitVeil, brightest: NDArray[np.float64], clear_water: NDArray[np.float64],
) -> EnvelopeFit:
    """Fit the dark envelope for the best of a few ratios.

    Parameters
    ----------
    fit : callable
        The fit of the dark envelope.
    brightest : (3,) float64 ndarray
        The bright envelope at its brightest.
    clear_water : (3,) float64 ndarray
        κ, 1/m.
    """
    best = EnvelopeFit()
    for ratio in COARSE_RATIOS:
        found = _fit_ratio(fit, _veil_of_ratio(ratio, brightest))
        if found is not None:
            best = _likelier(best, found, _likelihood(found, clear_water))
    return best


def component_of_open_water(
    fit: FitVeil, fuse: FuseVeil, envelope: Envelopes, clear_water: NDArray[np.float64],
    contrast: Decay | None, water: OpenWater,
) -> tuple[Component, EnvelopeFit] | None:
    """Fit with the veil that open water shows; also returns the envelope's alone."""
    light, alone = fit_open_water(fit, envelope, clear_water, water.veil, water.stddev)
    if alone.fit is None:
        return None
    fused = fuse(alone.fit, light, water.veil, water.stddev / water.veil)
    return _component(fused, alone.likelihood, clear_water, contrast, None), alone


def fit_open_water(
    fit: FitVeil, envelope: Envelopes, clear_water: NDArray[np.float64],
    veil: NDArray[np.float64], stddev: NDArray[np.float64],
) -> tuple[NDArray[np.float64], EnvelopeFit]:
    """Fit the dark envelope with the veil that open water shows.

    Parameters
    ----------
    fit : callable
        The fit of the dark envelope.
    envelope : Envelopes
        What is fitted.
    clear_water : (3,) float64 ndarray
        κ, 1/m.
    veil, stddev : (3,) float64 ndarray
        Of open water.

    Returns
    -------
    light : (3,) float64 ndarray
        W / B.
    fit : EnvelopeFit
    """
    light = np.clip(
        np.nan_to_num(envelope.bright).max(axis=1) / BRIGHT_RADIANCE / veil, *LIGHT_LIMITS)
    possible = PossibleVeil(
        np.maximum(veil - DEVIATIONS * stddev, 0.3 * veil), veil + DEVIATIONS * stddev, light)
    found = fit(possible)
    if found is None:
        return light, EnvelopeFit()
    light = np.clip(
        bright_light(found.parameters[:, 0], veil, envelope) / veil, *LIGHT_LIMITS)
    found = fit(possible._replace(light=light))
    if found is None or not found.converged or not np.isfinite(found.covariance).all():
        return light, EnvelopeFit()
    return light, EnvelopeFit(found, _likelihood(found, clear_water))


def bright_light(
    attenuation: NDArray[np.float64], veil: NDArray[np.float64], envelope: Envelopes
) -> NDArray[np.float64]:
    """Light on the scene for which the brightest near patches are bright, (3,)."""
    near = slice(0, -(-len(envelope.range) // 4))
    left = transmission(attenuation[:, np.newaxis], envelope.range[near])
    light = (envelope.bright[:, near] - veil[:, np.newaxis] * (1.0 - left)) / left
    return np.maximum(np.nan_to_num(light).max(axis=1), 1e-3) / BRIGHT_RADIANCE


def likelihood_of_contrast(fit: Fit, contrast: Decay) -> float:
    """Logarithm of how likely the decay of contrast is, if the fit holds."""
    regular = _regular(fit)
    _, _, information, distance = measure(
        regular.parameters, regular.covariance, contrast.attenuation, contrast.covariance)
    _, logarithm = np.linalg.slogdet(information)
    return -0.5 * (3.0 * TAIL**2 * math.log1p(distance / (3.0 * TAIL**2)) - float(logarithm))


def distance_of_contrast(fit: Fit, contrast: Decay) -> float:
    """Distance of the decay of contrast from the fit, in standard deviations of one number."""
    *_, distance = measure(
        fit.parameters, fit.covariance, contrast.attenuation, contrast.covariance)
    return math.sqrt(distance / 3.0)


def _likelier(best: EnvelopeFit, fit: Fit, likelihood: float) -> EnvelopeFit:
    return EnvelopeFit(fit, likelihood) if likelihood > best.likelihood else best


def _fit_ratio(fit: FitVeil, veil: PossibleVeil) -> Fit | None:
    """Fit for a ratio of veil and brightest patch; None where there is no fit."""
    found = fit(veil)
    if found is None:
        return None
    failed = (
        not found.converged or not np.isfinite(found.covariance).all()
        or (found.parameters[:, 0] >= ATTENUATION_BOUNDS[1]).any()
    )
    return None if failed else found


def _veil_of_ratio(ratio: float, brightest: NDArray[np.float64]) -> PossibleVeil:
    veil = ratio * brightest
    as_the_paper = ratio == 1.0
    return PossibleVeil(
        veil if as_the_paper else BELOW * veil,
        np.full(3, AMBIENT_LIGHT_MAX) if as_the_paper else ABOVE * veil,
        np.full(3, min(max(1.0 / ratio, 1.0), LIGHT_LIMITS[1])))


def _component(
    fit: Fit, likelihood: float, clear_water: NDArray[np.float64], contrast: Decay | None,
    veil: PossibleVeil | None,
) -> Component:
    """Add the decay of contrast, and clear water, to a fit with priors and its log likelihood."""
    fused = held = _regular(fit)
    if contrast is not None:
        likelihood += likelihood_of_contrast(fused, contrast)
        held = _update(fused, contrast)
    return Component(fused, hold_above_clear_water(held, clear_water), likelihood, veil)


def _likelihood(fit: Fit, clear_water: NDArray[np.float64]) -> float:
    """Logarithm of how likely the dark envelope is, and channels that differ so."""
    off = _off(fit.parameters, fit.covariance, clear_water)
    bins = fit.cost / (TEMPERATURE * NEIGHBOURING_BINS)
    return -0.5 * (bins + TAIL**2 * math.log1p(off / TAIL**2))


@njit(nogil=True)
def _off(parameters: Any, covariance: Any, clear_water: Any) -> float:
    """Squared deviations of the channels from one another, and below clear water."""
    particles = parameters[:, 0] - clear_water
    mean = (particles[0] + particles[1] + particles[2]) / 3
    alike = (0.02 + 0.3 * max(mean, 0.0)) ** 2
    differing, below = 0.0, 0.0
    for c in range(3):
        variance = covariance[2 * c, 2 * c]
        differing += (particles[c] - mean) ** 2 / (alike + variance)
        below += min(particles[c], 0.0) ** 2 / (
            (CLEAR_WATER_TOLERANCE * clear_water[c]) ** 2 + variance)
    return differing + below


def _update(fit: Fit, contrast: Decay) -> Fit:
    """Measure β by the decay of contrast (Kalman's update); less so where it is far off."""
    noise = contrast.covariance * (1.0 + (distance_of_contrast(fit, contrast) / TAIL) ** 2)
    step, known, *_ = measure(fit.parameters, fit.covariance, contrast.attenuation, noise)
    return _regular(moved(fit, step, known))


def _regular(fit: Fit) -> Fit:
    """The fit with a covariance that is positive definite in spite of rounding.

    By numpy and not in a kernel: there, eigenvectors are those of SciPy's own library, whose
    last digit depended on its number of threads in Ubuntu 24.04's versions.
    """
    if _is_regular(fit.covariance):
        return fit
    scale = np.sqrt(np.maximum(np.abs(np.diag(fit.covariance)), 1e-18))
    scales = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(fit.covariance / scales)
    regular = (vectors * np.maximum(values, LEAST_EIGENVALUE)) @ vectors.T * scales
    return replace(fit, covariance=regular)


@njit(nogil=True)
def _is_regular(covariance: Any) -> bool:
    """Whether no eigenvalue of the correlations is below the least: then Cholesky's factor is."""
    factor = np.empty((6, 6))
    for i in range(6):
        for j in range(i + 1):
            scale = math.sqrt(
                max(abs(covariance[i, i]), 1e-18) * max(abs(covariance[j, j]), 1e-18))
            rest = covariance[i, j] / scale
            for k in range(j):
                rest -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = rest / factor[j, j]
            elif rest > LEAST_EIGENVALUE:
                factor[i, i] = math.sqrt(rest - LEAST_EIGENVALUE)
            else:
                return False
    return True
