# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles of the normal and the chi-squared distribution.

`scipy.special` has them too, but importing it takes a tenth of a node's start.
"""

from __future__ import annotations

import functools
import math
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

_STANDARD_NORMAL = NormalDist()


def normal_quantile(probability: ArrayLike) -> NDArray[np.float64]:
    """Return what a standard normal variable falls below with given probabilities.

    Parameters
    ----------
    probability : array_like
        0 to 1, of any shape.

    Returns
    -------
    float64 ndarray
        Of the same shape; infinite at 0 and 1.
    """
    asked = np.asarray(probability, np.float64)
    found = np.fromiter(map(_normal_quantile, asked.ravel().tolist()), np.float64, asked.size)
    return found.reshape(asked.shape)


def _normal_quantile(probability: float) -> float:
    if 0.0 < probability < 1.0:
        return _STANDARD_NORMAL.inv_cdf(probability)
    return math.copysign(math.inf, probability - 0.5)


@functools.cache
def chi_squared_quantile(degrees: int, probability: float) -> float:
    """Return what a chi-squared variable falls below with a given probability.

    Parameters
    ----------
    degrees : int
        Degrees of freedom: 1, or an even number.
    probability : float
        At least 0 and less than 1.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If the degrees of freedom are others.
    """
    if degrees == 1:
        return _normal_quantile((1.0 + probability) / 2) ** 2
    if degrees < 1 or degrees % 2:
        raise ValueError(f"{degrees} degrees of freedom: neither 1 nor an even number")
    # Halves of it are distributed as the waiting time for so many events, and fewer
    # than those have come with the probability that Poisson's distribution gives.
    terms = range(degrees // 2)

    def beyond(time: float) -> float:
        return math.exp(-time) * sum(time**n / math.factorial(n) for n in terms)

    low, high = 0.0, 1.0
    while beyond(high) > 1.0 - probability:
        high *= 2
    while low < (middle := (low + high) / 2) < high:
        if beyond(middle) > 1.0 - probability:
            low = middle
        else:
            high = middle
    return 2 * high
