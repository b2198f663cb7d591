# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit of lamp power and scattering to the envelopes of a lamp-lit image.

The dark envelope is W ρ D + s S with a small ρ, and so shows the scattered light s S; the
bright one shows W. Daylight beside the lamps adds a veil B (1 − e^(−βd)) to what is scattered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from uw_visibility.water.lamp_cells import Cells
from uw_visibility.water.lamp_fit import (
    FEWEST_CELLS,
    ITERATIONS,
    MOST_PIXELS,
    NEIGHBOURS,
    TAIL,
)
from uw_visibility.water.lamp_observations import BRIGHT_QUANTILE, DARK_QUANTILE

Array = NDArray[np.float64]

# Radiance of the brightest patches.
BRIGHT_RADIANCE = 0.9
# The bright envelope of the frame is that of so bright a part of its cells.
BRIGHT_CELLS, BRIGHT_DEVIATION = 0.7, 0.15
# Radiance of what is darkest in a cell differs so much, as a part of the direct light.
DARK_DEVIATION = 0.04


@dataclass(frozen=True)
class LightFit:
    """Light of the lamps and of the water for given attenuation.

    Attributes
    ----------
    power : (3,) float64 ndarray
        W: irradiance of white at 1 m from a lamp of relative power 1, without water.
    scattering : (3,) float64 ndarray
        s: what S is to be multiplied by for the light that the water scatters.
    veil : (3,) float64 ndarray
        B, daylight that the water scatters, at infinity; 0 without daylight.
    power_stddev, scattering_stddev : (3,) float64 ndarray
    """

    power: Array
    scattering: Array
    veil: Array
    power_stddev: Array
    scattering_stddev: Array


def fit_light(cells: Cells, attenuation: Array, daylight: Array) -> LightFit:
    """Fit the dark envelope by scattered light, and the bright one by white.

    Parameters
    ----------
    cells : Cells
    attenuation, daylight : (3,) float64 ndarray
        See `ContrastFit`; channels with NaN stay NaN.
    """
    out = np.full((5, 3), np.nan)
    for channel in np.flatnonzero(np.isfinite(attenuation)).tolist():
        beta = float(attenuation[channel])
        day = cells.daylight(beta)
        direct = np.exp(cells.direct(beta, channel)[0]) + daylight[channel] * day
        scattered = [cells.scattered(beta, channel)]
        unit = np.exp(cells.log_unit)
        if daylight[channel] > 0:
            scattered.append((np.exp(beta * cells.range) - 1.0) * day)
        dark, bright = _without_noise(cells, channel)
        # White by cells whose contrast is clear of noise and of the water's own light.
        contrast = cells.contrast[channel]
        clear = contrast > np.maximum(5.0 * cells.noise[channel], 0.1 * cells.mean[channel])
        if clear.sum() < FEWEST_CELLS:
            clear = contrast > 2.0 * cells.noise[channel]
        if not clear.any():
            continue
        number = np.sqrt(np.minimum(cells.count, MOST_PIXELS))
        white, added = 0.0, np.zeros(len(direct))
        for _ in range(2):
            white = _weighted_quantile(
                ((bright - added) / direct)[clear], number[clear], BRIGHT_CELLS) / BRIGHT_RADIANCE
            amount, error = _fit_dark(
                np.stack([*scattered, direct]) / unit, dark,
                cells.noise[channel] / unit, number, white)
            added = amount[:-1] @ np.array(scattered)
        out[:, channel] = (
            white, amount[0], amount[1] if len(scattered) > 1 else 0.0,
            BRIGHT_DEVIATION * white, error)
    return LightFit(*out)


def _fit_dark(
    terms: Array, dark: Array, noise: Array, count: Array, white: float
) -> tuple[Array, float]:
    """Fit what is not negative, from below: amounts of the terms, deviation of the first."""
    # Imported here, since it takes longer than all else and daylight does without.
    from scipy.optimize import nnls

    direct = terms[-1]
    scale = float(np.median(dark / np.maximum(terms[:-1].sum(axis=0), 1e-12)))
    amount = np.full(len(terms), scale)
    amount[-1] = 0.0
    weight = count / count.max()
    keep = weight
    for _ in range(ITERATIONS):
        sigma = np.sqrt(
            (DARK_DEVIATION * white * direct) ** 2 + noise**2
            + (0.05 * (amount[:-1] @ terms[:-1])) ** 2 + 1e-18)
        residual = (dark - amount @ terms) / sigma
        # Cells above the curve hold nothing dark.
        tail = np.where(residual > 0, 0.5, TAIL)
        keep = weight / (1.0 + (residual / tail) ** 2)
        root = np.sqrt(keep) / sigma
        fresh, _ = nnls((terms * root).T, dark * root)
        if np.allclose(fresh, amount, rtol=1e-4):
            break
        amount = fresh
    root = np.sqrt(keep) / sigma
    curvature = (terms * root) @ (terms * root).T + 1e-12 * np.eye(len(terms))
    return amount, math.sqrt(NEIGHBOURS * float(np.linalg.inv(curvature)[0, 0]))


def _without_noise(cells: Cells, channel: int) -> tuple[Array, Array]:
    """Dark and bright envelope without what noise adds to their distance from the mean."""
    # Of one square; the second difference holds one and half of two others.
    noise = cells.noise[channel] / math.sqrt(1.5)
    contrast = np.maximum(cells.contrast[channel], 0.0)
    added = np.hypot(noise, contrast) - contrast
    return (
        cells.dark[channel] - ndtri(DARK_QUANTILE) * added / np.exp(cells.log_unit),
        cells.bright[channel] - ndtri(BRIGHT_QUANTILE) * added)


def _weighted_quantile(values: Array, weight: Array, quantile: float) -> float:
    order = np.argsort(values)
    summed = np.cumsum(weight[order])
    if not summed[-1] > 0:
        return math.nan
    return float(values[order][np.searchsorted(summed, quantile * summed[-1])])
