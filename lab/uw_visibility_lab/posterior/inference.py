# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Posterior of attenuation, veil and light of one image, from the network's mixture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from uw_visibility.images.arrays import Array, Mask
from uw_visibility_lab.posterior.network import UNKNOWNS, Mixture, Network
from uw_visibility_lab.posterior.statistics import Statistics

# Draws of each component, for quantiles that have no closed form.
DRAWS = 128


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of the logarithms of attenuation, veil and light.

    Attributes
    ----------
    mean : (3, 3) float64 ndarray
        For each channel the means of ln β (1/m), ln B and ln W (irradiance).
    covariance : (9, 9) float64 ndarray
        Of the same, channel by channel.
    draws : (D, 3) float64 ndarray
        Draws of ln β.
    weight : (D,) float64 ndarray
        Of the draws; sums to 1.
    """

    mean: Array
    covariance: Array
    draws: Array
    weight: Array

    def clearest(self, seen: Mask, quantiles: Array) -> Array:
        """Quantiles of −ln min β over the channels seen; β in 1/m."""
        values = -self.draws[:, seen].min(axis=1)
        order = np.argsort(values)
        reached = np.cumsum(self.weight[order]) - 0.5 * self.weight[order]
        return np.interp(quantiles, reached, values[order])


def infer(network: Network, statistics: Statistics) -> Posterior:
    """Infer the posterior of an image's statistics."""
    mixture = network.infer(statistics)
    units = np.tile(
        (-math.log(statistics.median_range), 0.0, 0.0), (3, 1))
    units[:, 1:] += np.log(statistics.brightest)[:, np.newaxis]
    mean = mixture.weight @ mixture.mean
    away = mixture.mean - mean
    covariance = (
        np.tensordot(mixture.weight, mixture.covariance, 1)
        + (mixture.weight[:, np.newaxis] * away).T @ away)
    draws, weight = _draw(mixture)
    return Posterior(
        mean.reshape(3, UNKNOWNS) + units, covariance, draws + units[:, 0], weight)


def _draw(mixture: Mixture) -> tuple[Array, Array]:
    """Draws of ln β, the same number of each component, and their weights."""
    attenuation = slice(None, None, UNKNOWNS)
    standard = _standard_normal()
    draws = [
        mean[attenuation] + standard @ np.linalg.cholesky(covariance[attenuation, attenuation]).T
        for mean, covariance in zip(mixture.mean, mixture.covariance, strict=True)]
    return np.concatenate(draws), np.repeat(mixture.weight / DRAWS, DRAWS)


@lru_cache(maxsize=1)
def _standard_normal() -> Array:
    """(DRAWS, 3): draws whose mean is 0 and whose covariance is 1, the same in every run."""
    half = np.random.default_rng(0).standard_normal((DRAWS // 2, 3))
    draws = np.concatenate((half, -half))
    return np.asarray(np.linalg.solve(np.linalg.cholesky(np.cov(draws.T, bias=True)), draws.T).T)
