# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Veil for restoration: within its uncertainty, that for which radiance depends least on range.

Restoration of the far multiplies an error of the veil by e^(βd): of 2 % at an optical
thickness of 3 it makes 0.4 of white. What lies far is as bright as what lies near, but for
the scatter from one range to another; as a prior of Bayes' rule that tells the veil better
than the dark envelope does. Nothing of it goes into the estimate that is published.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array
from uw_visibility.optics.light_model import radiance_of, transmission

# Bins of range, of equal ratio, the pixels that one needs, and how many neighbours show one object.
_BINS, _FEWEST, _NEIGHBOURS = 24, 50, 3.0
# Scatter of the mean radiance from one range to another.
_SCATTER = 0.3
# A veil that is known worse than to this part is not moved as far as it may be: dark depths stay
# dark.
_MOST = 0.1
# Of a bin of which less light is left, nothing is seen.
_LEAST_LEFT = 1e-3


def level_veil(
    irradiance: Array,
    distance: Array,
    attenuation: Array,
    veil: Array,
    light: Array,
    stddev: Array,
    error: float,
) -> Array:
    """Return the veil for which radiance is even over range, as far as its deviation lets it.

    The mean radiance of a bin is linear in it, so that the mean of what may be is a weighted
    least squares' solution.

    Parameters
    ----------
    irradiance : (C, N) float64 ndarray
        Of pixels, 0..1.
    distance : (N,) float64 ndarray
        Their range, m, above 0 and finite.
    attenuation : (C,) float64 ndarray
        β, 1/m.
    veil, light : (C,) float64 ndarray
        Veil B, and light W on the scene.
    stddev : (C,) float64 ndarray
        Standard deviation of the veil.
    error : float
        Of a bin's irradiance: what quantisation leaves.

    Returns
    -------
    (C,) float64 ndarray
    """
    low, high = distance.min(), distance.max()
    place = np.log(distance / low) / max(np.log(high / low), 1e-9)
    bins = np.minimum((place * _BINS).astype(np.intp), _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    full = count >= _FEWEST
    if np.count_nonzero(full) < 2:
        return veil
    level = veil.copy()
    for c in range(len(veil)):
        # The bin's mean of e^(-βd) is not that at its mean range.
        left = _mean(transmission(attenuation[c], distance), bins, count)[full]
        shown = left > _LEAST_LEFT
        gain = shown / np.where(shown, left, 1.0)
        radiance = radiance_of(
            _mean(irradiance[c], bins, count)[full], gain, veil[c], light[c])
        change = (gain - 1.0) / light[c]
        weight = shown / (_NEIGHBOURS * (_SCATTER**2 + (error * gain / light[c]) ** 2))
        for values in (radiance, change):
            values -= weight @ values / max(weight.sum(), 1e-9)
        prior = 1.0 / min(max(stddev[c], 1e-6), _MOST * veil[c]) ** 2
        step = weight @ (change * radiance) / (weight @ change**2 + prior)
        if step > -veil[c]:
            level[c] += step
    return level


def _mean(values: Array, bins: NDArray[np.intp], count: NDArray[np.intp]) -> Array:
    return np.bincount(bins, values, minlength=_BINS) / np.maximum(count, 1)
