# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Model averaging over the veil: the fits for each possible veil, weighted.

E = W ρ e^(−βd) + B (1 − e^(−βd)): in the sea the veil B is 0.2 to 1.2 of the light W on
the scene (Akkaynak and Treibitz 2018, doi:10.1109/CVPR.2018.00703). Each veil is as likely
as the fit, the decay of contrast and the likeness of the channels make it (Bayesian model
averaging).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.water.contrast import Decay
from uw_visibility.water.fit import Fit
from uw_visibility.water.observations import Envelopes
from uw_visibility.water.open_water import OpenWater
from uw_visibility.water.priors import BRIGHT_DEVIATION
from uw_visibility.water.veil_components import (
    COARSE_RATIOS,
    RATIOS,
    Component,
    EnvelopeFit,
    FitVeil,
    FuseVeil,
    RatioFits,
    bright_light,
    component_of_open_water,
    distance_of_contrast,
    fit_ratios,
)

# Light and veil that differ by no more than this, as a logarithm, are taken for one.
SAME_LIGHT = 0.3
# Part of the image at which what looks like open water is so as often as not.
MISTAKEN_AREA = 0.006
# What no frame can tell, as a part of β: the scale of range, the transfer, what a
# pixel's footprint adds to the darkest patches.
MODEL_ERROR = 0.09
# ... and as a part of the veil: where water is thick, the dark envelope knows it but for noise.
VEIL_ERROR = 0.015
# The decay of contrast and a fit that are farther apart than this contradict each other.
CONTRADICTION = 3.0
# Residuals of the dark envelope, a bin's mean, from which on no single water explains them:
# scenes in one water leave 0.4 to 5.0, since their darkest patches are not all black.
MISFIT = 5.5
# ... and from which on none does where they follow a smooth course over range besides, which
# darkest patches do not, but a layer does, and a veil that is brighter where things are far.
TREND_MISFIT, TREND = 2.8, 0.25
# Weight of a component below which nothing more is asked of it.
NEGLIGIBLE = 0.01


@dataclass(frozen=True)
class VeilFit:
    """Estimate with the veil apart from the light.

    Attributes
    ----------
    fit : Fit
        Attenuation and veil, with the spread between the veils that may be.
    scene_light : (3,) float64 ndarray
        W, irradiance of a white patch without water between.
    scene_light_stddev : (3,) float64 ndarray
        Its standard deviation.
    cues : dict of str to tuple of (3,) float64 ndarray
        What each cue says of β, and its standard deviation.
    disagreement : float
        Distance of the cues from each other, in standard deviations.
    ratios : RatioFits
        What is fitted without open water's veil.
    open_water_fit : EnvelopeFit
        The dark envelope's alone, with open water's veil.
    misfit : float
        Residuals of the veil that leaves the smallest; see `Fit`.
    durbin_watson : float
        That of these residuals.
    likelihood : float
        Its logarithm, of all veils together.
    """

    fit: Fit
    scene_light: NDArray[np.float64]
    scene_light_stddev: NDArray[np.float64]
    cues: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
    disagreement: float
    ratios: RatioFits
    open_water_fit: EnvelopeFit
    misfit: float
    durbin_watson: float
    likelihood: float

    @property
    def refuted(self) -> bool:
        """Whether no single water and veil explains the dark envelope."""
        return self.misfit > MISFIT or (
            self.misfit > TREND_MISFIT and self.durbin_watson < TREND)


def fit_free_veil(
    fit: FitVeil,
    fuse: FuseVeil,
    envelope: Envelopes,
    brightest: NDArray[np.float64],
    clear_water: NDArray[np.float64],
    contrast: Decay | None,
    open_water: OpenWater | None,
    coarse: bool = False,
    ratios: RatioFits | None = None,
) -> VeilFit | None:
    """Estimate attenuation, veil and light where the veil is not the light.

    Parameters
    ----------
    fit, fuse : callable
        The fit of the dark envelope, and its fusion with priors.
    envelope : Envelopes
        What is fitted.
    brightest : (3,) float64 ndarray
        The bright envelope at its brightest.
    clear_water : (3,) float64 ndarray
        κ, 1/m.
    contrast : Decay or None
        Decay of contrast with range.
    open_water : OpenWater or None
        Open water in view.
    coarse : bool
        Whether a rough estimate will do.
    ratios : RatioFits, optional
        Of the same envelopes and contrast, where they were fitted before.

    Returns
    -------
    VeilFit or None
        None where no veil gives a fit.
    """
    cues: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    in_open_water = EnvelopeFit()
    ratios = ratios or fit_ratios(
        fit, fuse, brightest, clear_water, contrast, COARSE_RATIOS if coarse else RATIOS)
    components = list(ratios.components)
    if open_water is not None:
        seen = component_of_open_water(fit, fuse, envelope, clear_water, contrast, open_water)
        if seen is not None:
            in_open_water = seen[1]
            # What looks like open water may be a smooth, far thing, the likelier the smaller.
            mistaken = 1.0 / (1.0 + open_water.fraction / MISTAKEN_AREA)
            components = [
                *(_weighted(component, math.log(mistaken)) for component in components),
                _weighted(seen[0], math.log1p(-mistaken))]
    if not components:
        return None
    logarithms = np.array([component.likelihood for component in components])
    weights = np.exp(logarithms - logarithms.max())
    likelihood = float(logarithms.max()) + math.log(weights.sum())
    weights /= weights.sum()
    fused = [component.fused for component in components]
    held = [
        _on_curve(fit, component, weight)
        for component, weight in zip(components, weights, strict=True)]
    nearest = min(fused, key=lambda component: component.misfit)
    alone = _mixture(fused, weights)
    name = "open water" if open_water is not None else "dark envelope"
    cues[name] = _attenuation(alone)
    disagreement = 0.0
    if contrast is not None:
        cues["contrast"] = contrast.attenuation, np.sqrt(np.diag(contrast.covariance))
        disagreement = distance_of_contrast(alone, contrast)
    light, deviation = _light(held, weights, envelope)
    return VeilFit(
        _with_model_error(_mixture(held, weights)), light, deviation, cues, disagreement, ratios,
        in_open_water, nearest.misfit, nearest.durbin_watson, likelihood)


def average(first: VeilFit, second: VeilFit, log_odds: float) -> VeilFit:
    """Average two estimates by the odds of the second.

    Parameters
    ----------
    first, second : VeilFit
    log_odds : float
        Logarithm of the odds of the second.

    Returns
    -------
    VeilFit
        What is no average is the likelier one's.
    """
    weight = 1.0 / (1.0 + math.exp(-min(max(log_odds, -50.0), 50.0)))
    weights = np.array((1.0 - weight, weight))
    light = weights @ (first.scene_light, second.scene_light)
    spread = weights @ [
        fit.scene_light_stddev**2 + (fit.scene_light - light)**2 for fit in (first, second)]
    return replace(
        second if log_odds > 0 else first, fit=_mixture([first.fit, second.fit], weights),
        scene_light=light, scene_light_stddev=np.sqrt(spread))


def _on_curve(fit: FitVeil, component: Component, weight: float) -> Fit:
    """Fit the veil again to the attenuation that is held, where it is as the paper has it.

    Priors move it along a straight line, far out of what the envelope shows where it knew the
    attenuation badly: darker than patches that are brighter for the veil alone. How bright any
    other veil is, they and open water know better than dark patches do.
    """
    if component.veil is None or weight < NEGLIGIBLE:
        return component.held
    attenuation = component.held.parameters[:, 0]
    found = fit(component.veil, attenuation)
    if found is None:
        return component.held
    return replace(
        component.held, parameters=np.stack((attenuation, found.parameters[:, 1]), axis=1))


def _weighted(component: Component, logarithm: float) -> Component:
    return component._replace(likelihood=component.likelihood + logarithm)


def _light(
    components: list[Fit], weights: NDArray[np.float64], envelope: Envelopes
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation of the light on the scene over the components."""
    values, deviations = np.empty((2, len(components), 3))
    for index, component in enumerate(components):
        attenuation, veil = component.parameters.T
        light = bright_light(attenuation, veil, envelope)
        # Bright patches that are about as bright as the veil are lit as it is (W = B).
        apart = np.log(light / veil)
        same = math.exp(-0.5 * float(apart @ apart) / (3.0 * SAME_LIGHT**2))
        values[index] = light * np.exp(-same * apart)
        # And it is known as the veil is.
        of_veil = same * np.sqrt(np.diag(component.covariance)[1::2]) / veil
        deviations[index] = values[index] * np.hypot((1.0 - same) * BRIGHT_DEVIATION, of_veil)
    mean = weights @ values
    spread = np.sqrt(weights @ ((values - mean) ** 2 + deviations**2))
    return mean, spread


def _mixture(components: list[Fit], weights: NDArray[np.float64]) -> Fit:
    """Mean and covariance over components: within them and between them."""
    values = np.array([c.parameters.ravel() for c in components])
    mean = weights @ values
    off = values - mean
    covariance = (off.T * weights) @ off + sum(
        w * c.covariance for w, c in zip(weights, components, strict=True))
    best = components[int(np.argmax(weights))]
    return replace(best, parameters=mean.reshape(3, 2), covariance=covariance)


def _with_model_error(fit: Fit) -> Fit:
    covariance = fit.covariance.copy()
    attenuation, veil = fit.parameters.T
    covariance[0::2, 0::2] += MODEL_ERROR**2 * np.outer(attenuation, attenuation)
    covariance[1::2, 1::2] += np.diag((VEIL_ERROR * veil) ** 2)
    return replace(fit, covariance=covariance)


def _attenuation(fit: Fit) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return fit.parameters[:, 0].copy(), np.sqrt(np.diag(fit.covariance)[0::2])
