# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit of attenuation, lamp power and scattering to what a lamp-lit image shows.

Contrast falls as W D(β) with the direct light of the lamps, whatever the water scatters;
the dark envelope is W ρ D + s S with a small ρ, and so shows the scattered light s S.
Daylight beside the lamps adds a share e^(−βd) to the direct light and a veil
B (1 − e^(−βd)) to what is scattered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from uw_visibility.optics.lamps import ATTENUATIONS
from uw_visibility.water.lamp_cells import Cells
from uw_visibility.water.lamp_observations import BRIGHT_QUANTILE, DARK_QUANTILE

Array = NDArray[np.float64]

# What a cell's contrast departs from the mean one by, as a part of it; and how well its noise
# is known. Less than this part of the mean light is no contrast, but the light's own pattern.
CELL_DEVIATION, NOISE_ERROR, LEAST_CONTRAST = 0.6, 0.3, 0.006
# Cells of so many pixels count as more do.
MOST_PIXELS = 200.0
# Cauchy's scale, in deviations of a cell.
TAIL = 2.0
ITERATIONS = 40
START = 0.3
# Logarithm of daylight's share to start from, and a weak prior about it, so that the fit has
# a curvature where nothing shows it.
LITTLE_DAYLIGHT, DAYLIGHT_WEIGHT = math.log(1e-2), 1e-3
# Cells that are needed, and what their contrast is over that of noise.
FEWEST_CELLS, ABOVE_NOISE = 6, 2.0
# Mean light over that noise: pixels have 2.4 times as much, and at least two deviations of it
# have to be above black.
ABOVE_BLACK = 5.0
# Cells beside one another show the same objects.
NEIGHBOURS = 4.0
# What a scene's texture changes over range, as the logarithm of contrast per one standard
# deviation of the path of light: common to the channels, and of each alone.
SCENE_DEVIATION, CHANNEL_DEVIATION = 0.085, 0.015
# Radiance of the brightest patches.
BRIGHT_RADIANCE = 0.9


@dataclass(frozen=True)
class ContrastFit:
    """Attenuation from the decay of contrast, all channels.

    Attributes
    ----------
    attenuation : (3,) float64 ndarray
        β, 1/m; NaN where too few cells show it.
    covariance : (3, 3) float64 ndarray
    daylight : (3,) float64 ndarray
        Direct light of daylight over that of the lamps (of power 1, at 1 m).
    spread : (3,) float64 ndarray
        Standard deviation of the light's path over the cells that show it, m.
    cells : (3,) int64 ndarray
        Cells whose contrast is above that of noise.
    iterations : int
    """

    attenuation: Array
    covariance: Array
    daylight: Array
    spread: Array
    cells: NDArray[np.int64]
    iterations: int


def fit_contrast(cells: Cells, both: bool) -> ContrastFit:
    """Robust least squares of contrast over the light's path, each channel of its own.

    Parameters
    ----------
    cells : Cells
    both : bool
        Whether daylight may light the scene beside the lamps.
    """
    found = [_fit_channel(cells, channel, both) for channel in range(3)]
    size = len(cells.range)
    beta = np.array([each[0] for each in found])
    # Score of each cell in each channel over the curvature: what a residual moves β by.
    influence = np.array([each[2] for each in found]).reshape(3, size)
    spread = np.array([each[3] for each in found])
    covariance = NEIGHBOURS * influence @ influence.T
    with np.errstate(divide="ignore", invalid="ignore"):
        scene = SCENE_DEVIATION / spread
        covariance += np.outer(scene, scene) + np.diag((CHANNEL_DEVIATION / spread) ** 2)
    for moved in np.array([each[5] for each in found]).reshape(3, -1).T:
        covariance += np.outer(moved, moved)
    return ContrastFit(
        beta, covariance, np.array([each[1] for each in found]), spread,
        np.array([each[4] for each in found]), max(each[6] for each in found))


def _fit_channel(
    cells: Cells, channel: int, both: bool
) -> tuple[float, float, Array, float, int, Array, int]:
    """β, daylight's share, influence of cells, spread of paths, cells, effect of lamps moved."""
    squared = cells.contrast[channel] * np.abs(cells.contrast[channel])
    noise = cells.noise[channel] ** 2
    least = (LEAST_CONTRAST * cells.mean[channel]) ** 2
    lit = cells.mean[channel] > ABOVE_BLACK * cells.noise[channel]
    seen = lit & (squared > ABOVE_NOISE**2 * noise + least)
    number = int(seen.sum())
    size = len(squared)
    if number < FEWEST_CELLS:
        return math.nan, 0.0, np.zeros(size), math.nan, number, np.zeros(len(cells.moved)), 0
    background = (NOISE_ERROR**2 + 40.0 / cells.count) * noise**2 + least**2
    weight = np.sqrt(np.minimum(cells.count, MOST_PIXELS))
    weight /= weight.max()
    # Noise that is cut off at black takes contrast with it.
    weight[~lit] = 0.0
    # β, logarithm of contrast, logarithm of daylight's share.
    p = np.array([START, 0.0, LITTLE_DAYLIGHT])[:3 if both else 2]
    p[1] = float(np.median(0.5 * np.log(squared[seen]) - cells.direct(START, channel)[0][seen]))
    iteration, step = 0, np.ones(1)
    # Scales and weights follow the parameters (quasi-likelihood), so that there is no cost
    # that steps could be held to.
    while iteration < ITERATIONS and np.abs(step).max() > 1e-5:
        iteration += 1
        jacobian, residual, w, path = _linearise(
            cells, channel, p, squared, background, weight)
        curvature = jacobian.T @ (w[:, None] * jacobian) + 1e-9 * np.eye(len(p))
        slope = jacobian.T @ (w * residual)
        if both:
            curvature[2, 2] += DAYLIGHT_WEIGHT
            slope[2] -= DAYLIGHT_WEIGHT * (p[2] - LITTLE_DAYLIGHT)
        step = np.clip(np.linalg.solve(curvature, slope), -0.5, 0.5)
        step[0] = np.clip(p[0] + step[0], ATTENUATIONS[0], ATTENUATIONS[-1]) - p[0]
        p = p + step
    score = np.linalg.solve(curvature, jacobian.T * w)[0]
    signal = w * jacobian[:, 1] ** 2
    mean = float(signal @ path / signal.sum())
    spread = math.sqrt(float(signal @ (path - mean) ** 2 / signal.sum()))
    # What a change of ln D moves β by: contrast and its logarithm change alike.
    moved = (score * jacobian[:, 1]) @ cells.moved.T
    share = math.exp(p[2]) if both else 0.0
    return float(p[0]), share, score * residual, spread, number, moved, iteration


def _linearise(
    cells: Cells, channel: int, p: Array, squared: Array, background: Array, weight: Array,
) -> tuple[Array, Array, Array, Array]:
    """Jacobian, residuals, weights and paths of squared contrast at parameters."""
    logarithm, path = cells.direct(p[0], channel)
    direct = np.exp(logarithm)
    day = math.exp(p[2]) * cells.daylight(p[0]) if len(p) == 3 else np.zeros(len(path))
    total = direct + day
    path = (direct * path + day * cells.range) / total
    model = np.exp(2.0 * np.clip(p[1] + np.log(total), -40.0, 40.0))
    deviation = np.sqrt((2.0 * CELL_DEVIATION * model) ** 2 + background)
    residual = (squared - model) / deviation
    slope = 2.0 * model / deviation
    jacobian = np.stack([-slope * path, slope, slope * day / total], axis=1)[:, :len(p)]
    return jacobian, residual, weight / (1.0 + (residual / TAIL) ** 2), path


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


# The bright envelope of the frame is that of so bright a part of its cells.
BRIGHT_CELLS, BRIGHT_DEVIATION = 0.7, 0.15
# Radiance of what is darkest in a cell differs so much, as a part of the direct light.
DARK_DEVIATION = 0.04


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
