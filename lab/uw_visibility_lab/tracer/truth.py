# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What a camera could at best know of traced water: how surfaces' light falls with range."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array

BINS = 24
"""Of range, with equally many pixels."""

FEWEST_PIXELS = 60
"""Of a bin: for three coefficients, with room."""

LEAST_OPEN = 0.01
"""Share of open water that is enough to take the veil from."""


@dataclass(frozen=True)
class Decay:
    """Exponential decay of light over range, by channel, each (3,)."""

    attenuation: Array  # 1/m; NaN where it cannot be told
    stddev: Array  # 1/m: of the samples' noise and of the departure from an exponential
    # transmission at range 0 that the exponential comes to; 1 if it were one from there
    start: Array
    departure: Array  # rms of transmission over its exponential, less 1, weighted as in the fit


def range_bins(ranges: Array) -> list[NDArray[np.int64]]:
    """Return the flat indices of the pixels of each bin of range, nearest first."""
    flat = np.ravel(ranges)
    seen = np.flatnonzero(np.isfinite(flat))
    ordered = seen[np.argsort(flat[seen], kind="stable")]
    return [part for part in np.array_split(ordered, BINS) if len(part) >= FEWEST_PIXELS]


def transmissions(
    image: Array, veil: Array, surface: Array, ranges: Array, *, contrast: bool,
) -> tuple[Array, Array, Array]:
    """Transmission of surfaces' light by range.

    Without `contrast`, it is the sum of image - veil over the sum of the surfaces' radiance: all
    that surfaces add to the image. With it, it is the slope of image - veil over the surfaces'
    radiance within a bin, beside a constant and a trend with range: light that the floor sends
    into the water adds to the veil on dark and bright patches alike, and is no part of it.

    image: (H, W, 3), light in water; with noise, but not denoised: that flattens texture.
    veil: (H, W, 3), the same with black surfaces.
    surface: (H, W, 3), radiance of the surfaces themselves.
    ranges: (H, W), m, NaN in open water.
    contrast: which of the two.
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
    values = np.full((len(parts), 3), np.nan)
    stddevs = np.full((len(parts), 3), np.nan)
    for k, part in enumerate(parts):
        for channel in range(3):
            seen, source = light[part, channel], given[part, channel]
            if contrast:
                trend = distance[part] - middles[k]
                design = np.stack([source, np.ones(len(part)), trend], -1)
            else:
                design = source[:, None]
            inverse = np.linalg.pinv(design.T @ design)
            found = inverse @ (design.T @ seen)
            rest = seen - design @ found
            variance = rest @ rest / max(len(part) - design.shape[1], 1)
            values[k, channel] = found[0]
            stddevs[k, channel] = math.sqrt(max(variance * inverse[0, 0], 1e-24))
    return middles, values, stddevs


def fit_decay(middles: Array, values: Array, stddevs: Array) -> Decay:
    """Fit k e^(-βd) to transmissions, weighted by their noise, with both k and β free.

    k is free since a camera does not know it: reflectance and light are unknown to it alike.

    middles: (N,), m.
    values, stddevs: (N, 3).
    Returns its stddev is scaled by √χ² per degree of freedom where that is above 1.
    """
    result = np.full((4, 3), np.nan)
    for channel in range(3):
        value, noise = values[:, channel], stddevs[:, channel]
        used = np.isfinite(value) & np.isfinite(noise) & (noise > 0.0)
        # Without 3 bins above their noise there is no decay to be told.
        if used.sum() < 3 or (value[used] > 3.0 * noise[used]).sum() < 3:
            continue
        result[:, channel] = _fit(middles[used], value[used], noise[used])
    return Decay(*result)


def _fit(distance: Array, value: Array, noise: Array) -> tuple[float, float, float, float]:
    clear = value > 3.0 * noise
    weight = np.where(clear, value / noise, 0.0)
    slope, height = np.polyfit(
        distance, np.log(np.where(clear, value, 1.0)), 1, w=weight)

    # 0.5 % of each value beside the noise: no bin alone decides.
    spread = np.hypot(noise, 0.005 * np.abs(value))

    def residual(unknown: Array) -> Array:
        return np.asarray((np.exp(unknown[0] - unknown[1] * distance) - value) / spread)

    fit = least_squares(residual, [height, -slope])
    freedom = max(len(value) - 2, 1)
    scatter = max(1.0, float(fit.fun @ fit.fun) / freedom)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * scatter
    model = np.exp(fit.x[0] - fit.x[1] * distance)
    share = np.square(model / spread)
    departure = math.sqrt(float(share @ np.square(value / model - 1.0)) / float(share.sum()))
    return (float(fit.x[1]), math.sqrt(float(covariance[1, 1])), math.exp(float(fit.x[0])),
            departure)


def veil_at_infinity(image: Array, veil: Array, ranges: Array) -> tuple[Array, str, Array]:
    """Veil B: open water where it is in view, else what the veil's growth with range comes to.

    image, veil: (H, W, 3), light in water, and the same with black surfaces.
    ranges: (H, W), m, NaN in open water.
    Returns `veil`, (3,), NaN where it cannot be told; `source`, "open water", or "growth over
    range"; `growth`, (3,), 1/m: β of B (1 - e^(-βd)) that comes nearest to the black surfaces'
    veil; NaN where ranges are too short to show it.
    """
    parts = range_bins(ranges)
    # In 64 bit: NumPy 1 computes an array of 32 with scalars of 64 in 32 bit, NumPy 2 in 64, and
    # derivatives by differences need 64.
    along = np.ravel(ranges).astype(float)
    distance = np.array([along[part].mean() for part in parts])
    flat = np.asarray(veil, float).reshape(-1, 3)
    found, growth = np.full(3, np.nan), np.full(3, np.nan)
    for channel in range(3):
        grown = np.array([flat[part, channel].mean() for part in parts])
        top = max(float(grown.max()), 1e-12)

        def residual(unknown: Array, grown: Array = grown, top: float = top) -> Array:
            level = np.exp(unknown[0]) * -np.expm1(-np.exp(unknown[1]) * distance)
            return np.asarray(level - grown / top)

        fit = least_squares(residual, [0.3, -1.5], loss="soft_l1", f_scale=0.02)
        # An infinity beyond three times what is seen is no measurement, nor is its rate.
        if fit.x[0] < math.log(3.0):
            growth[channel] = math.exp(fit.x[1])
            found[channel] = top * math.exp(fit.x[0])
    opened = ~np.isfinite(ranges)
    if opened.mean() >= LEAST_OPEN:
        return np.median(image[opened], axis=0), "open water", growth
    return found, "growth over range", growth


def scene_light(surface: Array, reflectance: Array, ranges: Array) -> Array:
    """Light W on the scene: median of the surfaces' radiance over their reflectance, (3,)."""
    known = np.isfinite(ranges) & (reflectance.min(axis=-1) > 0.02)
    return np.asarray(np.median(surface[known] / reflectance[known], axis=0), float)
