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

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.water.daylight.contrast import Decay
from uw_visibility.water.daylight.fit import Fit
from uw_visibility.water.daylight.open_water import OpenWater
from uw_visibility.water.daylight.priors import BRIGHT_DEVIATION
from uw_visibility.water.daylight.veil_components import (
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
from uw_visibility.water.observations import Envelopes

# Light and veil that differ less, as a logarithm, are taken as equal.
SAME_LIGHT = 0.3
# Fraction of the image at which apparent open water is real in half of the cases.
MISTAKEN_AREA = 0.006
# Error of the model relative to β: scale of range, transfer, size of a pixel's footprint;
MODEL_ERROR = 0.09
# and relative to the veil.
VEIL_ERROR = 0.015
# Distance of the decay of contrast and a fit, in deviations, that refutes the estimate.
CONTRADICTION = 3.0
# Mean squared residual of the dark envelope that refutes a single water: scenes in one water leave
# 0.4 to 5.0, since their darkest patches are not all black;
MISFIT = 5.5
# less if residuals are smooth over range, as by a layer or by a veil that is brighter far away.
TREND_MISFIT, TREND = 2.8, 0.25
# Components of less weight are not refined.
LEAST_WEIGHT = 0.01


@dataclass(frozen=True)
class VeilFit:
    """Estimate with the veil apart from the light.

    Attributes
    ----------
    fit : Fit
        Attenuation and veil, with the spread between the possible veils.
    scene_light, scene_light_stddev : (3,) float64 ndarray
        W, irradiance of white with no water between.
    cues : dict of str to tuple of (3,) float64 ndarray
        β by each cue alone, and its standard deviation.
    disagreement : float
        Distance of the cues from each other, in standard deviations.
    ratios : RatioFits
        Fits without the veil of open water.
    open_water_fit : EnvelopeFit
        Fit of the dark envelope alone, with the veil of open water.
    misfit, durbin_watson : float
        Of the component with the smallest misfit; see `Fit`.
    likelihood : float
        Log likelihood of all veils together.
    """

    fit: Fit
    scene_light: Array
    scene_light_stddev: Array
    cues: dict[str, tuple[Array, Array]]
    disagreement: float
    ratios: RatioFits
    open_water_fit: EnvelopeFit
    misfit: float
    durbin_watson: float
    likelihood: float

    @property
    def refuted(self) -> bool:
        """Whether no single water and veil explains the dark envelope."""
        return self.misfit > MISFIT or (self.misfit > TREND_MISFIT and self.durbin_watson < TREND)


def fit_free_veil(
    fit: FitVeil, fuse: FuseVeil, envelope: Envelopes, active: Mask, brightest: Array,
    clear_water: Array, contrast: Decay | None, open_water: OpenWater | None, coarse: bool = False,
    ratios: RatioFits | None = None,
) -> VeilFit | None:
    """Estimate attenuation, veil and light where the veil is not the light.

    `ratios` are fits of the same envelopes and contrast, where made before. None where no veil
    fits.
    """
    cues: dict[str, tuple[Array, Array]] = {}
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
    light, deviation = _light(held, weights, envelope, active)
    return VeilFit(
        _with_model_error(_mixture(held, weights)), light, deviation, cues, disagreement, ratios,
        in_open_water, nearest.misfit, nearest.durbin_watson, likelihood)


def average(first: VeilFit, second: VeilFit, log_odds: float) -> VeilFit:
    """Average two estimates, given the log odds of the second.

    What cannot be averaged is that of the likelier one.
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
    """Fit the veil again for the attenuation held, where veil and light are one.

    Priors move the veil along a straight line. Where attenuation was badly known, that leaves what
    the envelope shows: bright patches would be brighter than the veil. Other veils are known better
    by their prior and by open water than by dark patches.
    """
    if component.veil is None or weight < LEAST_WEIGHT:
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
    components: list[Fit], weights: Array, envelope: Envelopes, active: Mask
) -> tuple[Array, Array]:
    """Mean and standard deviation of the light on the scene over the components."""
    values, deviations = np.empty((2, len(components), 3))
    for index, component in enumerate(components):
        attenuation, veil = component.parameters.T
        light = bright_light(attenuation, veil, envelope)
        # Bright patches that are about as bright as the veil are lit as it is (W = B).
        apart = np.log(light / veil)
        seen = apart[active]
        same = math.exp(-0.5 * float(seen @ seen) / (len(seen) * SAME_LIGHT**2))
        values[index] = light * np.exp(-same * apart)
        # And it is known as the veil is.
        of_veil = same * np.sqrt(np.diag(component.covariance)[1::2]) / veil
        deviations[index] = values[index] * np.hypot((1.0 - same) * BRIGHT_DEVIATION, of_veil)
    mean = weights @ values
    spread = np.sqrt(weights @ ((values - mean) ** 2 + deviations**2))
    return mean, spread


def _mixture(components: list[Fit], weights: Array) -> Fit:
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


def _attenuation(fit: Fit) -> tuple[Array, Array]:
    return fit.parameters[:, 0].copy(), np.sqrt(np.diag(fit.covariance)[0::2])
