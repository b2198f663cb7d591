# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fits of the dark envelope: with one ambient light, and for a given veil and light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.water.daylight.contrast import envelope_decay
from uw_visibility.water.daylight.fit import Fit, fit_plain
from uw_visibility.water.daylight.lower_envelope import fit_lower_envelope
from uw_visibility.water.daylight.open_water import OpenWater
from uw_visibility.water.daylight.transfer_check import (
    OtherTransfer,
    negligible,
    other_transfer,
    other_veil,
)
from uw_visibility.water.daylight.validation import (
    black_attenuation,
    brightest_patch,
    least_ambient_light,
)
from uw_visibility.water.daylight.veil import VeilFit
from uw_visibility.water.daylight.veil_components import (
    EnvelopeFit,
    FitVeil,
    PossibleVeil,
    fit_best_ratio,
    fit_open_water,
    likelihood_of_contrast,
)
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.observations import Envelopes, quantile_of_known

# The most that contrast may say for or against a transfer, as a logarithm of odds.
MOST_BY_CONTRAST = 3.0
# Standard deviations by noise and rounding that dark patches may be lighter than a veil: where
# little of a channel's light is left, they are its veil, and a code value is a part of that.
LIGHTER_DEVIATIONS = 2.0
# Standard deviation of the veil of a channel that is not seen, over any guess of it.
UNSEEN_VEIL = 100.0


def fit_one_light(
    envelope: Envelopes, active: Mask, start: WaterEstimate | None, range_error: float,
    clear_water: Array, plain: bool,
) -> Fit:
    """Fit the dark envelope with one ambient light for veil and scene (eq. 6-7).

    `start` is an earlier estimate; `plain` fits as the paper does.
    """
    ambient_min = brightest(envelope, active)
    first = np.stack((clear_water, ambient_min), axis=1)
    for c in np.flatnonzero(active):
        if plain:
            first[c, 1] = np.nanmax(envelope.bright[c])
        else:
            # From above: what is brighter than the curve of the water holds it less.
            first[c, 0] = np.median(black_attenuation(envelope, int(c), ambient_min[c]))
    if start is not None:
        known = np.isfinite(start.attenuation)
        first[known, 0] = start.attenuation[known]
        first[known, 1] = start.ambient_light[known]
    if plain:
        return fit_plain(envelope.range, envelope.dark, ambient_min, first, active)
    return fit_lower_envelope(
        envelope.dark_range, envelope.dark, envelope.deviation, ambient_min, first,
        clear_water, active, range_error, brightest_patches(envelope),
        patches=np.stack((
            np.broadcast_to(envelope.range, envelope.bright.shape), envelope.bright,
            envelope.step), axis=2))


def fit_of_veil(envelope: Envelopes, active: Mask, clear_water: Array) -> FitVeil:
    """Return the fit of the dark envelope as a function of a possible veil."""
    patches = brightest_patches(envelope)
    typical = quantile_of_known(envelope.dark - LIGHTER_DEVIATIONS * envelope.deviation, 0.5)

    def fit(veil: PossibleVeil, attenuation: Array | None = None) -> Fit | None:
        lower, upper, light = veil
        if (typical > upper)[active].any():
            return None
        share = np.clip(envelope.dark / lower[:, np.newaxis], 0.0, 0.98)
        black = -np.log1p(-share) / envelope.dark_range
        first = np.stack((clear_water, lower), axis=1)
        first[active, 0] = quantile_of_known(black[active], 0.5)
        found = fit_lower_envelope(
            envelope.dark_range, envelope.dark, envelope.deviation, lower, first,
            clear_water, active, envelope.range_error, patches, light, upper,
            attenuation=attenuation)
        return _with_all_channels(found, active, clear_water, lower)

    return fit


def fit_other_transfer(
    envelope: Envelopes, active: Mask, clear_water: Array,
    transfer: str, as_told: VeilFit, open_water: OpenWater | None,
) -> OtherTransfer | None:
    """Fit the envelopes as they are if the camera has the other transfer.

    None where that is out of the question. With open water in view, the other transfer has to be
    likelier both with its veil (`as_told` holds the fits by the declared transfer) and without.
    """
    other, change = other_transfer(envelope, transfer, active)
    fit = fit_of_veil(other, active, clear_water)

    def compare(one: EnvelopeFit, told: EnvelopeFit) -> OtherTransfer | None:
        if one.fit is None or told.fit is None:
            return None
        odds = one.likelihood + change - told.likelihood
        if negligible(odds + MOST_BY_CONTRAST):
            return None
        decays = envelope_decay(other, active), envelope_decay(envelope, active)
        if decays[0] is not None and decays[1] is not None:
            contrast = likelihood_of_contrast(one.fit, decays[0]) - likelihood_of_contrast(
                told.fit, decays[1])
            odds += min(max(contrast, -MOST_BY_CONTRAST), MOST_BY_CONTRAST)
        if negligible(odds):
            return None
        counts = np.where(active[:, np.newaxis], 1.0, np.nan)
        return OtherTransfer(float(odds), counts * one.fit.parameters, counts * told.fit.parameters)

    found = compare(fit_best_ratio(fit, brightest(other, active), clear_water), as_told.ratios.best)
    if found is None or open_water is None or as_told.open_water_fit.fit is None:
        return found
    veil = other_veil(open_water.veil, open_water.stddev, transfer)
    seen = compare(fit_open_water(fit, other, clear_water, *veil)[1], as_told.open_water_fit)
    return None if seen is None else min(found, seen, key=lambda one: one.log_odds)


def brightest(envelope: Envelopes, active: Mask) -> Array:
    """(3,): least ambient light by the bright envelope; 1 for inactive channels."""
    return np.array([least_ambient_light(envelope, c) if active[c] else 1.0 for c in range(3)])


def brightest_patches(envelope: Envelopes) -> Array:
    """(3, 2): irradiance and range of the brightest near patch of each channel."""
    return np.array([brightest_patch(envelope, c) for c in range(3)])


def _with_all_channels(fit: Fit, active: Mask, clear_water: Array, veil: Array) -> Fit:
    """Put a guess of no weight in the place of inactive channels."""
    if active.all():
        return fit
    particles = max(float(np.mean(fit.parameters[active, 0] - clear_water[active])), 0.0)
    absent = ~active
    values = fit.parameters.copy()
    values[absent, 0] = clear_water[absent] + particles
    values[absent, 1] = veil[absent]
    covariance = np.nan_to_num(fit.covariance)
    for c in np.flatnonzero(absent):
        covariance[2 * c, 2 * c] = (1.0 + particles) ** 2
        covariance[2 * c + 1, 2 * c + 1] = (UNSEEN_VEIL * veil[c]) ** 2
    return replace(fit, parameters=values, covariance=covariance)
