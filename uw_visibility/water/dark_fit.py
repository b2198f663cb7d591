# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fits of the dark envelope: with one ambient light, and for a given veil and light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.water.contrast import envelope_decay
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.fit import Fit, fit_plain
from uw_visibility.water.lower_envelope import fit_lower_envelope
from uw_visibility.water.observations import Envelopes, quantile_of_known
from uw_visibility.water.open_water import OpenWater
from uw_visibility.water.transfer_check import (
    OtherTransfer,
    negligible,
    other_transfer,
    other_veil,
)
from uw_visibility.water.validation import (
    black_attenuation,
    brightest_patch,
    least_ambient_light,
)
from uw_visibility.water.veil import VeilFit
from uw_visibility.water.veil_components import (
    EnvelopeFit,
    FitVeil,
    PossibleVeil,
    fit_best_ratio,
    fit_open_water,
    likelihood_of_contrast,
)

# The most that contrast may say for or against a transfer, as a logarithm of odds.
MOST_BY_CONTRAST = 3.0
# Standard deviations by noise and rounding that dark patches may be lighter than a veil: where
# little of a channel's light is left, they are its veil, and a code value is a part of that.
LIGHTER_DEVIATIONS = 2.0


def fit_one_light(
    envelope: Envelopes,
    active: NDArray[np.bool_],
    start: WaterEstimate | None,
    range_error: float,
    clear_water: NDArray[np.float64],
    plain: bool,
) -> Fit:
    """Fit the dark envelope with one ambient light for veil and scene (eq. 6-7).

    Parameters
    ----------
    envelope : Envelopes
    active : (3,) bool ndarray
        Channels that count.
    start : WaterEstimate or None
        An earlier estimate to start from.
    range_error : float
        Standard deviation of range over its square, 1/m.
    clear_water : (3,) float64 ndarray
        κ of the camera, 1/m.
    plain : bool
        Whether to fit as the paper does.
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
            envelope.step), axis=2),
    )


def fit_of_veil(
    envelope: Envelopes, active: NDArray[np.bool_], clear_water: NDArray[np.float64],
) -> FitVeil:
    """Return the fit of the dark envelope as a function of the veil that may be."""
    patches = brightest_patches(envelope)
    typical = quantile_of_known(
        envelope.dark - LIGHTER_DEVIATIONS * envelope.deviation, 0.5)

    def fit(veil: PossibleVeil, attenuation: NDArray[np.float64] | None = None) -> Fit | None:
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
    envelope: Envelopes, active: NDArray[np.bool_], clear_water: NDArray[np.float64],
    transfer: str, as_told: VeilFit, open_water: OpenWater | None,
) -> OtherTransfer | None:
    """Fit the envelopes as they are if the camera's transfer is the other one.

    Parameters
    ----------
    envelope : Envelopes
        As the transfer gives them.
    active : (3,) bool ndarray
        Channels that count.
    clear_water : (3,) float64 ndarray
        κ of the camera, 1/m.
    transfer : str
        ``"linear"`` or ``"srgb"``.
    as_told : VeilFit
        Fits with that transfer.
    open_water : OpenWater or None
        Open water in view: what is likelier has to be so with its veil and without.

    Returns
    -------
    OtherTransfer or None
        None where the other transfer is out of the question.
    """
    other, change = other_transfer(envelope, transfer)
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
        return OtherTransfer(
            float(odds), counts * one.fit.parameters, counts * told.fit.parameters)

    found = compare(
        fit_best_ratio(fit, brightest(other, active), clear_water), as_told.ratios.best)
    if found is None or open_water is None or as_told.open_water_fit.fit is None:
        return found
    veil = other_veil(open_water.veil, open_water.stddev, transfer)
    seen = compare(fit_open_water(fit, other, clear_water, *veil)[1], as_told.open_water_fit)
    return None if seen is None else min(found, seen, key=lambda one: one.log_odds)


def brightest(envelope: Envelopes, active: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(3,): the bright envelope at its brightest; 1 for a channel that is left out."""
    return np.array([least_ambient_light(envelope, c) if active[c] else 1.0 for c in range(3)])


def brightest_patches(envelope: Envelopes) -> NDArray[np.float64]:
    """(3, 2): irradiance and range of the brightest patch near by, of each channel."""
    return np.array([brightest_patch(envelope, c) for c in range(3)])


def _with_all_channels(
    fit: Fit, active: NDArray[np.bool_], clear_water: NDArray[np.float64],
    veil: NDArray[np.float64],
) -> Fit:
    """Put a guess with a large deviation in the place of channels that were left out."""
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
        covariance[2 * c + 1, 2 * c + 1] = veil[c] ** 2
    return replace(fit, parameters=values, covariance=covariance)
