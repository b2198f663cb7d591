# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit with the veil apart from the light, with the veil's gradients levelled."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from uw_visibility.status import Status
from uw_visibility.water.cues import Cues, Observations
from uw_visibility.water.dark_fit import brightest, fit_of_veil
from uw_visibility.water.dark_gradient import NEGLIGIBLE, bend_of, find_gradients, unbent
from uw_visibility.water.fit import Fit
from uw_visibility.water.open_water import OpenWater
from uw_visibility.water.priors import Daylight, fuse
from uw_visibility.water.validation import refuse_channel
from uw_visibility.water.veil import MISTAKEN_AREA, VeilFit, average, fit_free_veil
from uw_visibility.water.veil_components import RatioFits
from uw_visibility.water.veil_gradient import UNCERTAIN, VeilGradient

# Where the veil of an image without open water is wanted.
MIDDLE = np.array((0.5, 0.5))


class VeilFitter:
    """Fits what one frame shows, with the veil apart from the light.

    Parameters
    ----------
    clear_water : (3,) float64 ndarray
        κ, 1/m.
    daylight : Daylight or None
        What is known of the colour of the ambient light.
    daylight_tolerance : float
        See `uw_visibility.water.priors.fuse`.
    """

    def __init__(
        self, clear_water: NDArray[np.float64], daylight: Daylight | None,
        daylight_tolerance: float,
    ) -> None:
        self._clear_water, self._daylight = clear_water, daylight
        self._daylight_tolerance = daylight_tolerance

    def fit(
        self, seen: Observations, active: NDArray[np.bool_], cues: Cues
    ) -> tuple[VeilFit, Observations] | None:
        """Fit attenuation, veil and light, with gradients of the veil levelled.

        Parameters
        ----------
        seen : Observations
            Envelopes, contrast and halves as the image shows them.
        active : (3,) bool ndarray
            Channels that count.
        cues : Cues
            Open water, and what levels pixels by a gradient.

        Returns
        -------
        tuple of VeilFit and Observations, or None
            The fit, and what it rests on, levelled or not; None where there is no fit.
        """
        fitted = self._fit(seen, active, cues)
        return None if fitted is None else self._level_rows(*fitted, active, cues)

    def _fit(
        self, seen: Observations, active: NDArray[np.bool_], cues: Cues
    ) -> tuple[VeilFit, Observations] | None:
        """Fit with the veil apart from the light, and with open water's gradient levelled.

        Returns the fit, and what it rests on, levelled or not; None where there is no fit.
        """
        certain = cues.certain_water
        found = self._fit_observations(seen, active, certain, cues.coarse)
        if found is None or cues.open_water is None or (certain and cues.level is None):
            return None if found is None else (found, seen)
        level = cues.level or seen
        in_water = self._fit_observations(
            level, active, cues.open_water, cues.coarse, found.ratios if level is seen else None)
        if in_water is None:
            return None if certain else (found, seen)
        if cues.level is not None:
            change = UNCERTAIN * (in_water.fit.parameters - found.fit.parameters).ravel()
            in_water = replace(in_water, fit=replace(
                in_water.fit, covariance=in_water.fit.covariance + np.outer(change, change)))
        log_odds = in_water.likelihood - found.likelihood
        if certain:
            # Of a small area, what differs in it need not be the veil's gradient.
            log_odds += math.log(certain.fraction / MISTAKEN_AREA)
        averaged = average(found, in_water, log_odds)
        if not certain:
            # What refutes an estimate without open water is not made good by what may be a wall.
            averaged = replace(
                averaged, misfit=found.misfit, durbin_watson=found.durbin_watson,
                disagreement=max(found.disagreement, in_water.disagreement))
        return averaged, level if log_odds > 0 else seen

    def _level_rows(
        self, found: VeilFit, seen: Observations, active: NDArray[np.bool_], cues: Cues
    ) -> tuple[VeilFit, Observations]:
        """Average with fits that a vertical gradient of veil or attenuation is levelled in."""
        if seen.halves is None or cues.places is None or cues.level_by is None:
            return found, seen
        attenuation, veil = found.fit.parameters.T
        gradients = find_gradients(
            seen.halves, active, attenuation, veil, found.scene_light)
        if gradients is None:
            return found, seen
        of_veil, of_attenuation = gradients
        shares = np.array((of_veil.odds, of_attenuation.odds))
        shares /= 1.0 + shares.sum()
        if shares[1] > NEGLIGIBLE:
            bend = bend_of(of_attenuation, cues.places, seen.envelope)
            found = replace(found, fit=unbent(found.fit, bend, shares[1], self._clear_water))
        # What open water shows of the veil is not asked of dark patches again.
        if shares[0] < NEGLIGIBLE or seen is cues.level:
            return found, seen
        water = cues.certain_water
        level = cues.level_by(VeilGradient(
            np.tile((of_veil.slope, 0.0), (3, 1)),
            MIDDLE if water is None else water.gradient.place))
        levelled = self._fit_observations(level, active, water, cues.coarse)
        if levelled is None:
            return found, seen
        change = (levelled.fit.parameters - found.fit.parameters).ravel()
        change *= of_veil.stddev / of_veil.slope
        levelled = replace(levelled, fit=replace(
            levelled.fit, covariance=levelled.fit.covariance + np.outer(change, change)))
        log_odds = math.log(shares[0] / max(1.0 - shares[0], 1e-9))
        return average(found, levelled, log_odds), level if log_odds > 0 else seen

    def _fit_observations(
        self, seen: Observations, active: NDArray[np.bool_], water: OpenWater | None,
        coarse: bool, ratios: RatioFits | None = None,
    ) -> VeilFit | None:
        """Fit with the veil apart from the light; None where there is no fit."""
        # Levelled pixels may be saturated, or too few.
        if any(refuse_channel(seen.envelope, int(c)) is not Status.OK
               for c in np.flatnonzero(active)):
            return None

        def fuse_priors(
            found: Fit, light: NDArray[np.float64], veil: NDArray[np.float64],
            tolerance: NDArray[np.float64],
        ) -> Fit:
            return fuse(
                found, self._clear_water, np.full(3, 1e-6), self._daylight,
                self._daylight_tolerance, light, veil, tolerance)

        return fit_free_veil(
            fit_of_veil(seen.envelope, active, self._clear_water), fuse_priors, seen.envelope,
            brightest(seen.envelope, active), self._clear_water, seen.contrast, water, coarse,
            ratios)
