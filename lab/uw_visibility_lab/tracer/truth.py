# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a camera could at best know of traced water: how surfaces' light falls with range."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array

BINS = 24
"""Of range, with equally many pixels."""

FEWEST_PIXELS = 60
"""Of a bin."""

LEAST_OPEN = 0.01
"""Share of open water that is enough to take the veil from."""


def range_bins(ranges: Array) -> list[NDArray[np.int64]]:
    """Return the flat indices of the pixels of each bin of range, nearest first."""
    flat = np.ravel(ranges)
    seen = np.flatnonzero(np.isfinite(flat))
    ordered = seen[np.argsort(flat[seen], kind="stable")]
    return [part for part in np.array_split(ordered, BINS) if len(part) >= FEWEST_PIXELS]


def transmissions(
    image: Array, veil: Array, surface: Array, ranges: Array,
) -> tuple[Array, Array, Array]:
    """Transmission of surfaces' light by range: all that surfaces add to the image, over theirs.

    image: (H, W, 3), light in water; with noise, but not denoised: that flattens texture.
    veil: (H, W, 3), the same with black surfaces.
    surface: (H, W, 3), radiance of the surfaces themselves.
    ranges: (H, W), m, NaN in open water.
    Returns `middles`, (N,), mean range of each bin, m; `values, stddevs`, (N, 3).
    Raises `InputError` if too few pixels have a range.
    """
    parts = range_bins(ranges)
    if len(parts) < 3:
        raise InputError("too few pixels have a range: the view needs more of the scene")
    distance = np.ravel(ranges).astype(float)
    light = (np.asarray(image, float) - veil).reshape(-1, 3)
    given = np.asarray(surface, float).reshape(-1, 3)
    middles = np.array([distance[part].mean() for part in parts])
    values, stddevs = np.empty((2, len(parts), 3))
    for k, part in enumerate(parts):
        seen, source = light[part], given[part]
        # A channel that lights nothing has no slope.
        power = np.maximum((source * source).sum(axis=0), 1e-300)
        values[k] = (source * seen).sum(axis=0) / power
        variance = np.square(seen - values[k] * source).sum(axis=0) / (len(part) - 1)
        stddevs[k] = np.sqrt(np.maximum(variance / power, 1e-24))
    return middles, values, stddevs


def fit_decay(middles: Array, values: Array, stddevs: Array) -> tuple[Array, Array]:
    """Fit k e^(-βd) to transmissions, weighted by their noise, with both k and β free.

    k is free since a camera does not know it: reflectance and light are unknown to it alike.

    middles: (N,), m.
    values, stddevs: (N, 3).
    Returns `attenuation`, β, and `stddev`, (3,), 1/m; NaN where it cannot be told. The deviation is
    of the samples' noise and of the departure from an exponential: it is scaled by √χ² per degree
    of freedom where that is above 1.
    """
    attenuation, stddev = np.full((2, 3), np.nan)
    for channel in range(3):
        value, noise = values[:, channel], stddevs[:, channel]
        used = np.isfinite(value) & np.isfinite(noise) & (noise > 0.0)
        # Without 3 bins above their noise there is no decay to be told.
        if used.sum() >= 3 and (value[used] > 3.0 * noise[used]).sum() >= 3:
            attenuation[channel], stddev[channel] = _fit(middles[used], value[used], noise[used])
    return attenuation, stddev


def _fit(distance: Array, value: Array, noise: Array) -> tuple[float, float]:
    clear = value > 3.0 * noise
    weight = np.where(clear, value / noise, 0.0)
    slope, height = np.polyfit(
        distance, np.log(np.where(clear, value, 1.0)), 1, w=weight)

    # 0.5 % of each value beside the noise: no bin alone decides.
    spread = np.hypot(noise, 0.005 * np.abs(value))

    def residual(unknown: Array) -> Array:
        return np.asarray((np.exp(unknown[0] - unknown[1] * distance) - value) / spread)

    fit = least_squares(residual, [height, -slope])
    scatter = max(1.0, float(fit.fun @ fit.fun) / max(len(value) - 2, 1))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * scatter
    return float(fit.x[1]), math.sqrt(float(covariance[1, 1]))


def open_water(image: Array, ranges: Array) -> Array:
    """Veil B: the median of open water, (3,); NaN where too little of it is in view.

    image: (H, W, 3). ranges: (H, W), m, NaN in open water.
    """
    opened = ~np.isfinite(ranges)
    if opened.mean() < LEAST_OPEN:
        return np.full(3, np.nan)
    return np.asarray(np.median(image[opened], axis=0))


def scene_light(surface: Array, reflectance: Array, ranges: Array) -> Array:
    """Light W on the scene: median of the surfaces' radiance over their reflectance, (3,)."""
    known = np.isfinite(ranges) & (reflectance.min(axis=-1) > 0.02)
    return np.asarray(np.median(surface[known] / reflectance[known], axis=0), float)
