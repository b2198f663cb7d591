# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fits of the dark envelope for each possible veil, and their likelihood.

The dark envelope shows little more than B β. So it is fitted for a grid of veils relative to the
brightest patch, and for the veil that open water shows. Likelihoods are logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array
from uw_visibility.optics.light_model import transmission
from uw_visibility.water.daylight.clear_water import hold_above_clear_water
from uw_visibility.water.daylight.contrast import Decay
from uw_visibility.water.daylight.fit import (
    AMBIENT_LIGHT_MAX,
    ATTENUATION_BOUNDS,
    Fit,
    measure,
    moved,
)
from uw_visibility.water.daylight.lower_envelope import DARK_BINS_ALIKE
from uw_visibility.water.daylight.open_water import OpenWater
from uw_visibility.water.daylight.priors import BRIGHT_RADIANCE, CLEAR_WATER_TOLERANCE
from uw_visibility.water.observations import Envelopes

# Veil over the brightest patch, and the prior of each: half of the frames are as the paper has it.
# In this order, so that hopeless ratios are not fitted.
RATIOS = (1.0, 0.7, 0.5, 0.36, 0.26, 1.2)
PRIOR = (0.45, 0.16, 0.13, 0.11, 0.09, 0.06)
COARSE_RATIOS = (1.0, 0.5)
# A log likelihood so far below the best ends the search among lower ratios.
HOPELESS = 8.0
# Deviation of the logarithm of a channel's veil from such a ratio, and where veil and light are
# one.
RATIO_TOLERANCE = 0.25
PAPER_TOLERANCE = 0.22
# Bounds of the veil over its prior value, or in its deviations.
BELOW, ABOVE, DEVIATIONS = 0.8, 1.4, 2.5
LIGHT_LIMITS = (0.5, 8.0)
# Of full light this leaves a code of 16 bits; less tells nothing of the light.
LEAST_TRANSMISSION = 1.0 / 65535.0
# Least eigenvalue of a fit's correlations that rounding has not spoilt.
LEAST_EIGENVALUE = 1e-6
# Cauchy's scale of the likelihoods' tails, in deviations.
TAIL = 2.0
# The bins' log likelihood is divided by this: the darkest patches of a whole scene depend on each
# other more than neighbours do.
TEMPERATURE = 6.0


class PossibleVeil(NamedTuple):
    """Bounds of a possible veil, and the light on the scene over it (W / B), (3,) each."""

    lower: Array
    upper: Array
    light: Array


class FitVeil(Protocol):
    """Fit of the dark envelope for a possible veil, with free or given attenuation.

    None where most dark patches are lighter than the upper bound by more than noise: no water makes
    black so light.
    """

    def __call__(
        self, veil: PossibleVeil, attenuation: Array | None = None
    ) -> Fit | None: ...


FuseVeil = Callable[[Fit, Array, Array, Array], Fit]
"""Fuse with priors: the fit, W / B, the veil and the deviation of its logarithm."""


class EnvelopeFit(NamedTuple):
    """Fit of the dark envelope, and its log likelihood."""

    fit: Fit | None = None
    likelihood: float = -math.inf


class Component(NamedTuple):
    """Fit for one possible veil, and its log likelihood.

    `fused` holds the priors, `held` the decay of contrast and the bound of clear water too. `veil`
    is what was fitted, if veil and light are one as in the paper; else None.
    """

    fused: Fit
    held: Fit
    likelihood: float
    veil: PossibleVeil | None


class RatioFits(NamedTuple):
    """Fits for the ratios of veil and brightest patch; `best` is likeliest by the envelope."""

    components: list[Component]
    best: EnvelopeFit


def fit_ratios(
    fit: FitVeil, fuse: FuseVeil, brightest: Array,
    clear_water: Array, contrast: Decay | None, ratios: tuple[float, ...],
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


def fit_best_ratio(fit: FitVeil, brightest: Array, clear_water: Array) -> EnvelopeFit:
    """Fit the dark envelope for the best of a few ratios."""
    best = EnvelopeFit()
    for ratio in COARSE_RATIOS:
        found = _fit_ratio(fit, _veil_of_ratio(ratio, brightest))
        if found is not None:
            best = _likelier(best, found, _likelihood(found, clear_water))
    return best


def component_of_open_water(
    fit: FitVeil, fuse: FuseVeil, envelope: Envelopes, clear_water: Array,
    contrast: Decay | None, water: OpenWater,
) -> tuple[Component, EnvelopeFit] | None:
    """Fit with the veil of open water; also return the envelope's fit alone."""
    if not (water.veil > 0.0).all():
        # A channel that has light shows none of it there: that is no open water.
        return None
    light, alone = fit_open_water(fit, envelope, clear_water, water.veil, water.stddev)
    if alone.fit is None:
        return None
    fused = fuse(alone.fit, light, water.veil, water.stddev / water.veil)
    return _component(fused, alone.likelihood, clear_water, contrast, None), alone


def fit_open_water(
    fit: FitVeil, envelope: Envelopes, clear_water: Array, veil: Array, stddev: Array
) -> tuple[Array, EnvelopeFit]:
    """Fit the dark envelope with the veil of open water; return W / B, (3,), and the fit."""
    light = np.clip(
        np.nan_to_num(envelope.bright).max(axis=1) / BRIGHT_RADIANCE / veil, *LIGHT_LIMITS)
    possible = PossibleVeil(
        np.maximum(veil - DEVIATIONS * stddev, 0.3 * veil), veil + DEVIATIONS * stddev, light)
    found = fit(possible)
    if found is None:
        return light, EnvelopeFit()
    light = np.clip(bright_light(found.parameters[:, 0], veil, envelope) / veil, *LIGHT_LIMITS)
    found = fit(possible._replace(light=light))
    if found is None or not found.converged or not np.isfinite(found.covariance).all():
        return light, EnvelopeFit()
    return light, EnvelopeFit(found, _likelihood(found, clear_water))


def bright_light(attenuation: Array, veil: Array, envelope: Envelopes) -> Array:
    """Light on the scene for which the brightest near patches are bright, (3,)."""
    near = slice(0, -(-len(envelope.range) // 4))
    left = np.maximum(
        transmission(attenuation[:, np.newaxis], envelope.range[near]), LEAST_TRANSMISSION)
    light = (envelope.bright[:, near] - veil[:, np.newaxis] * (1.0 - left)) / left
    return np.maximum(np.nan_to_num(light).max(axis=1), 1e-3) / BRIGHT_RADIANCE


def likelihood_of_contrast(fit: Fit, contrast: Decay) -> float:
    """Log likelihood of the decay of contrast, given the fit."""
    regular = _regular(fit)
    _, _, information, distance = measure(
        regular.parameters, regular.covariance, contrast.attenuation, contrast.covariance)
    _, logarithm = np.linalg.slogdet(information)
    return -0.5 * (3.0 * TAIL**2 * math.log1p(distance / (3.0 * TAIL**2)) - float(logarithm))


def distance_of_contrast(fit: Fit, contrast: Decay) -> float:
    """Distance of the decay of contrast from the fit, in standard deviations."""
    *_, distance = measure(
        fit.parameters, fit.covariance, contrast.attenuation, contrast.covariance)
    return math.sqrt(distance / 3.0)


def _likelier(best: EnvelopeFit, fit: Fit, likelihood: float) -> EnvelopeFit:
    return EnvelopeFit(fit, likelihood) if likelihood > best.likelihood else best


def _fit_ratio(fit: FitVeil, veil: PossibleVeil) -> Fit | None:
    """Fit for a ratio of veil and brightest patch; None where it fails."""
    found = fit(veil)
    if found is None:
        return None
    failed = (
        not found.converged or not np.isfinite(found.covariance).all()
        or (found.parameters[:, 0] >= ATTENUATION_BOUNDS[1]).any())
    return None if failed else found


def _veil_of_ratio(ratio: float, brightest: Array) -> PossibleVeil:
    veil = ratio * brightest
    as_the_paper = ratio == 1.0
    return PossibleVeil(
        veil if as_the_paper else BELOW * veil,
        np.full(3, AMBIENT_LIGHT_MAX) if as_the_paper else ABOVE * veil,
        np.full(3, min(max(1.0 / ratio, 1.0), LIGHT_LIMITS[1])))


def _component(
    fit: Fit, likelihood: float, clear_water: Array, contrast: Decay | None,
    veil: PossibleVeil | None,
) -> Component:
    """Add the decay of contrast, and clear water, to a fit with priors."""
    fused = held = _regular(fit)
    if contrast is not None:
        likelihood += likelihood_of_contrast(fused, contrast)
        held = _update(fused, contrast)
    return Component(fused, hold_above_clear_water(held, clear_water), likelihood, veil)


def _likelihood(fit: Fit, clear_water: Array) -> float:
    """Log likelihood of the dark envelope, and of the differences between channels."""
    off = _off(fit.parameters, fit.covariance, clear_water)
    bins = fit.cost / (TEMPERATURE * DARK_BINS_ALIKE)
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
    """Kalman update of β by the decay of contrast; weaker where it is far off."""
    noise = contrast.covariance * (1.0 + (distance_of_contrast(fit, contrast) / TAIL) ** 2)
    step, known, *_ = measure(fit.parameters, fit.covariance, contrast.attenuation, noise)
    return _regular(moved(fit, step, known))


def _regular(fit: Fit) -> Fit:
    """The fit with a covariance that is positive definite in spite of rounding.

    Not a kernel: numba takes eigenvectors from SciPy's library, whose last digit depends on its
    number of threads in the versions of Ubuntu 24.04.
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
    """Whether all eigenvalues of the correlations exceed the least (by Cholesky)."""
    factor = np.empty((6, 6))
    for i in range(6):
        for j in range(i + 1):
            scale = math.sqrt(max(abs(covariance[i, i]), 1e-18) * max(abs(covariance[j, j]), 1e-18))
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
