# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Posterior of attenuation, veil and light of one image, and its check against the image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import logit

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.status import Status
from uw_visibility.water.daylight.network import UNKNOWNS, Network, lit
from uw_visibility.water.daylight.statistics import FLOOR, QUANTILES, RANGES, Statistics
from uw_visibility.water.estimate import one_sigma

# Draws of each component, for quantiles that have no closed form.
DRAWS = 128
# Probability of undeclared lamps before the view is seen, as in training (belief `lamps.share` of
# the laboratory). A view that makes lamps more probable than that is not taken for daylight.
EXPECTED_LAMPS = 0.03
# Largest probability of lamps, if they are on board or several views are judged together, at which
# daylight is assumed.
MOST_LAMPS = 0.1
# Log odds to add if lamps are known to be on board: then they are as probable as daylight.
DECLARED = -float(logit(EXPECTED_LAMPS))
# Quantiles of the darkest and the brightest surfaces, by place in QUANTILES.
DARKEST, LIGHTEST = 1, len(QUANTILES) - 1
# Places of ln β and ln B of each channel among the nine unknowns.
ATTENUATION_AND_VEIL = np.array([0, 1, 3, 4, 6, 7])


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of the logarithms of attenuation, veil and light."""

    mean: Array  # (3, 3), for each channel the means of ln β (1/m), ln B and ln W (irradiance)
    covariance: Array  # (9, 9), of the same, channel by channel
    draws: Array  # (D, 3, 3), draws of the same
    weight: Array  # (D,), of the draws; sums to 1
    other_curve: float = 0.0  # these three: see `Mixture`
    lamps: float = 0.0
    unlike: float = 0.0
    misfit: float = 0.0  # how far the image is from what the draws predict, see `_misfit`

    def clearest(self, seen: Mask) -> Array:
        """16, 50 and 84 % of −ln min β over the channels seen; β in 1/m."""
        return one_sigma(-self.draws[:, seen, 0].min(axis=1), self.weight)


def light_status(lamps: float, most: float = EXPECTED_LAMPS) -> Status:
    """OK for daylight, else why a view is refused, by the probability of undeclared lamps.

    An estimate by daylight from a view under lamps is wrong by a large factor, so that it is
    refused from a probability above `most`.
    """
    if lamps > 0.5:
        return Status.LIT_BY_LAMPS
    return Status.LIGHT_UNCERTAIN if lamps > most else Status.OK


def infer(network: Network, statistics: Statistics) -> Posterior:
    """Infer the posterior of an image's statistics."""
    mixture = network.infer(statistics)
    units = np.zeros((3, UNKNOWNS))
    units[:, 0] = -math.log(statistics.median_range)
    units[:, 1:] = np.log(statistics.brightest)[:, np.newaxis]
    mean = mixture.weight @ mixture.mean
    away = mixture.mean - mean
    covariance = (
        np.tensordot(mixture.weight, mixture.covariance, 1)
        + (mixture.weight[:, np.newaxis] * away).T @ away)
    # The same number of draws of each component.
    draws = mixture.mean[:, np.newaxis] + _standard_normal() @ np.linalg.cholesky(
        mixture.covariance).swapaxes(1, 2)
    draws = draws.reshape(-1, 3, UNKNOWNS)
    weight = np.repeat(mixture.weight / DRAWS, DRAWS)
    return Posterior(
        mean.reshape(3, UNKNOWNS) + units, covariance, draws + units, weight,
        mixture.other_curve, mixture.lamps, mixture.unlike, _misfit(draws, weight, statistics))


@lru_cache(maxsize=1)
def _standard_normal() -> Array:
    """(DRAWS, 9): draws whose mean is 0 and whose covariance is 1, the same in every run."""
    half = np.random.default_rng(0).standard_normal((DRAWS // 2, 3 * UNKNOWNS))
    draws = np.concatenate((half, -half))
    return np.asarray(np.linalg.solve(np.linalg.cholesky(np.cov(draws.T, bias=True)), draws.T).T)


def _misfit(draws: Array, weight: Array, statistics: Statistics) -> float:
    """Posterior predictive discrepancy (Gelman, Meng and Stern 1996); 0 for a perfect fit.

    No surface is darker than the veil before it, B (1 − e^(−βd)), and none brighter than white,
    W e^(−βd) + B (1 − e^(−βd)) (eq. 4). Mean over bins, channels and draws of the square of ln
    irradiance beyond these bounds. `draws` are in the units of the statistics.
    """
    # A channel without light shows no veil.
    there = (statistics.of_bins[..., -1] > 0) & lit(statistics)[:, np.newaxis]
    if not there.any():
        return 0.0
    darkest, lightest = (
        np.exp(statistics.of_bins[..., place].astype(np.float64)) for place in (DARKEST, LIGHTEST))
    attenuation, veil, light = np.moveaxis(np.exp(np.clip(draws, -20.0, 20.0)), 2, 0)
    # (D, 3, BINS): NumPy takes exponentials of many in a fraction of the time.
    left = -attenuation[..., np.newaxis] * np.exp(statistics.of_image[RANGES]).astype(np.float64)
    beyond = np.zeros(len(draws))
    _sum_up_beyond(np.exp(left, out=left), veil, light, darkest, lightest, there, beyond)
    return float(weight @ beyond) / int(there.sum())


@njit(nogil=True)
def _sum_up_beyond(
    left: Any, veil: Any, light: Any, darkest: Any, lightest: Any, there: Any, beyond: Any
) -> None:
    """Sum up the squares of ln irradiance beyond the bounds, for each draw."""
    many, channels, bins = left.shape
    for d in range(many):
        for c in range(channels):
            for n in range(bins):
                if not there[c, n]:
                    continue
                black = veil[d, c] * (1.0 - left[d, c, n]) + FLOOR
                white = black + light[d, c] * left[d, c, n]
                if black > darkest[c, n]:
                    beyond[d] += np.log(black / darkest[c, n]) ** 2
                if white < lightest[c, n]:
                    beyond[d] += np.log(lightest[c, n] / white) ** 2
