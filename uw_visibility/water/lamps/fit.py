# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fits to the cells of a lamp-lit image: attenuation by contrast, power and scattering by light.

Contrast falls as W D(β) with the direct light of the lamps, whatever the water scatters. The dark
envelope is W ρ D + s S with a small ρ, and so shows the scattered light s S; the bright one shows
W. Daylight beside the lamps adds a share e^(−βd) to the direct light, and a veil B (1 − e^(−βd)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from uw_visibility.compute.robust import cauchy_weight
from uw_visibility.images.arrays import Array
from uw_visibility.optics.lamps import ATTENUATIONS
from uw_visibility.water.lamps.cells import Cells
from uw_visibility.water.lamps.observations import BRIGHT_QUANTILE, DARK_QUANTILE

# Relative deviation of a cell's contrast and of its noise; least contrast over the mean light,
# which the pattern of the lamps' own light makes.
CELL_DEVIATION, NOISE_ERROR, LEAST_CONTRAST = 0.6, 0.3, 0.006
# Cells of more pixels count alike.
MOST_PIXELS = 200.0
# Cauchy's scale, in deviations of a cell.
TAIL = 2.0
ITERATIONS = 40
START = 0.3
# Weak prior of the logarithm of daylight's share, which regularises the fit.
LITTLE_DAYLIGHT, DAYLIGHT_WEIGHT = math.log(1e-2), 1e-3
# Shares of daylight to start from, and iterations to try each.
DAYLIGHT_SHARES, TRIAL_ITERATIONS = (1e-3, 0.02, 0.06, 0.15, 0.4, 1.0), 15
# Deviation of β below clear water's, 1/m.
CLEARER = 0.03
# Cells that are needed, and their contrast over that of noise.
FEWEST_CELLS, ABOVE_NOISE = 6, 2.0
# Mean light over that noise: pixels have 2.4 times as much, and at least two deviations of it
# have to be above black.
ABOVE_BLACK = 5.0
# Neighbouring cells show the same objects.
NEIGHBOURS = 4.0
# Deviation of the logarithm of contrast by texture, per standard deviation of the path of light:
# common to the channels, and of each alone.
SCENE_DEVIATION, CHANNEL_DEVIATION = 0.065, 0.015


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
    cells : (3,) int64 ndarray
        Cells whose contrast is above that of noise.
    iterations : int
    """

    attenuation: Array
    covariance: Array
    daylight: Array
    cells: NDArray[np.int64]
    iterations: int


def fit_contrast(cells: Cells, both: bool, clear_water: Array) -> ContrastFit:
    """Robust least squares of contrast over the light's path, each channel alone.

    `both`: daylight may light the scene beside the lamps.
    """
    share = _share_of_daylight(cells, clear_water) if both else None
    found = [_fit_channel(cells, channel, share) for channel in range(3)]
    beta, daylight, influence, spread, number, moved, iterations = (
        np.array(values) for values in zip(*found, strict=True))
    covariance = NEIGHBOURS * influence @ influence.T
    with np.errstate(divide="ignore", invalid="ignore"):
        scene = SCENE_DEVIATION / spread
        covariance += np.outer(scene, scene) + np.diag((CHANNEL_DEVIATION / spread) ** 2)
    for by_lamp in moved.T:
        covariance += np.outer(by_lamp, by_lamp)
    return ContrastFit(beta, covariance, daylight, number, int(iterations.max()))


class _ChannelFit(NamedTuple):
    """Fit of one channel."""

    attenuation: float
    daylight: float
    # Change of attenuation by each cell's residual, (N,).
    influence: Array
    # Standard deviation of the light's path over the cells, m.
    spread: float
    cells: int
    # Change of attenuation by the displacement of each lamp.
    moved: Array
    iterations: int


class _Data(NamedTuple):
    """What a channel of the cells shows."""

    cells: Cells
    channel: int
    squared: Array
    background: Array
    weight: Array
    # Logarithm of contrast for the attenuation to start from; cells above noise.
    start: float
    number: int


def _data_of(cells: Cells, channel: int) -> _Data:
    squared = cells.contrast[channel] * np.abs(cells.contrast[channel])
    noise = cells.noise[channel] ** 2
    least = (LEAST_CONTRAST * cells.mean[channel]) ** 2
    lit = cells.mean[channel] > ABOVE_BLACK * cells.noise[channel]
    seen = lit & (squared > ABOVE_NOISE**2 * noise + least)
    background = (NOISE_ERROR**2 + 40.0 / cells.count) * noise**2 + least**2
    weight = np.sqrt(np.minimum(cells.count, MOST_PIXELS))
    weight /= max(float(weight.max(initial=0.0)), 1.0)
    # Noise that is cut off at black takes contrast with it.
    weight[~lit] = 0.0
    number, start = int(seen.sum()), math.nan
    if number >= FEWEST_CELLS:
        start = float(np.median(
            0.5 * np.log(squared[seen]) - cells.direct(START, channel)[0][seen]))
    return _Data(cells, channel, squared, background, weight, start, number)


def _fit_channel(cells: Cells, channel: int, share: float | None) -> _ChannelFit:
    """Fit one channel, from a share of daylight if any."""
    data = _data_of(cells, channel)
    if data.number < FEWEST_CELLS:
        return _ChannelFit(
            math.nan, 0.0, np.zeros(len(cells.range)), math.nan, data.number,
            np.zeros(len(cells.moved)), 0)
    # β, logarithm of contrast, logarithm of daylight's share.
    p = np.array([START, data.start]) if share is None else _trial(data, share)
    p, iteration = _iterate(data, p, len(p), ITERATIONS)
    jacobian, residual, w, path, _ = _linearise(data, p)
    curvature, _ = _normal_equations(jacobian, residual, w, p)
    score = np.linalg.solve(curvature, jacobian.T * w)[0]
    signal = w * jacobian[:, 1] ** 2
    mean = float(signal @ path / signal.sum())
    spread = math.sqrt(float(signal @ (path - mean) ** 2 / signal.sum()))
    # What a change of ln D moves β by: contrast and its logarithm change alike.
    moved = (score * jacobian[:, 1]) @ cells.moved.T
    day = 0.0 if share is None else math.exp(p[2])
    return _ChannelFit(float(p[0]), day, score * residual, spread, data.number, moved, iteration)


def _share_of_daylight(cells: Cells, clear_water: Array) -> float:
    """Daylight's share, of all channels alike, for which contrast fits best.

    Contrast under lamps and daylight looks like that under lamps alone in impossibly clear water.
    """
    seen = [data for data in (_data_of(cells, c) for c in range(3)) if data.number >= FEWEST_CELLS]

    def misfit(share: float) -> float:
        tried = [(data, _trial(data, share)) for data in seen]
        short = [max(float(clear_water[data.channel] - p[0]), 0.0) for data, p in tried]
        return sum(_misfit(data, p) for data, p in tried) + 0.5 * float(
            np.sum((np.array(short) / CLEARER) ** 2))

    return min(DAYLIGHT_SHARES, key=misfit)


def _trial(data: _Data, share: float) -> Array:
    """Parameters that fit best by a share of daylight."""
    start = np.array([START, data.start, math.log(share)])
    return _iterate(data, start, 2, TRIAL_ITERATIONS)[0]


def _iterate(data: _Data, p: Array, free: int, most: int) -> tuple[Array, int]:
    """Gauss-Newton steps in the first `free` parameters; parameters and number of steps."""
    iteration, step = 0, np.ones(1)
    # Scales and weights follow the parameters (quasi-likelihood), so that there is no cost
    # that steps could be held to.
    while iteration < most and np.abs(step).max() > 1e-5:
        iteration += 1
        jacobian, residual, w, _, _ = _linearise(data, p)
        curvature, slope = _normal_equations(jacobian, residual, w, p)
        step = np.zeros(len(p))
        step[:free] = np.clip(np.linalg.solve(curvature[:free, :free], slope[:free]), -0.5, 0.5)
        step[0] = np.clip(p[0] + step[0], ATTENUATIONS[0], ATTENUATIONS[-1]) - p[0]
        p = p + step
    return p, iteration


def _normal_equations(jacobian: Array, residual: Array, w: Array, p: Array) -> tuple[Array, Array]:
    curvature = jacobian.T @ (w[:, None] * jacobian) + 1e-9 * np.eye(len(p))
    slope = jacobian.T @ (w * residual)
    if len(p) == 3:
        curvature[2, 2] += DAYLIGHT_WEIGHT
        slope[2] -= DAYLIGHT_WEIGHT * (p[2] - LITTLE_DAYLIGHT)
    return curvature, slope


def _misfit(data: _Data, p: Array) -> float:
    """Negative log likelihood by Cauchy's loss, whose scale the model sets."""
    _, residual, _, _, deviation = _linearise(data, p)
    loss = 0.5 * TAIL**2 * np.log1p((residual / TAIL) ** 2) + np.log(deviation)
    return float(data.weight @ loss)


def _linearise(data: _Data, p: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Jacobian, residuals, weights, paths and deviations of squared contrast at parameters."""
    cells, squared = data.cells, data.squared
    logarithm, path = cells.direct(p[0], data.channel)
    direct = np.exp(logarithm)
    day = math.exp(p[2]) * cells.daylight(p[0]) if len(p) == 3 else np.zeros(len(path))
    total = direct + day
    path = (direct * path + day * cells.range) / total
    model = np.exp(2.0 * np.clip(p[1] + np.log(total), -40.0, 40.0))
    deviation = np.sqrt((2.0 * CELL_DEVIATION * model) ** 2 + data.background)
    residual = (squared - model) / deviation
    slope = 2.0 * model / deviation
    jacobian = np.stack([-slope * path, slope, slope * day / total], axis=1)[:, :len(p)]
    return jacobian, residual, cauchy_weight(residual, TAIL, data.weight), path, deviation


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
    """Fit the dark envelope by scattered light, and the bright one by white; see `ContrastFit`."""
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
    """Non-negative fit from below: amounts of the terms, deviation of the first."""
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
        keep = cauchy_weight(residual, tail, weight)
        root = np.sqrt(keep) / sigma
        fresh, _ = nnls((terms * root).T, dark * root)
        if np.allclose(fresh, amount, rtol=1e-4):
            break
        amount = fresh
    root = np.sqrt(keep) / sigma
    curvature = (terms * root) @ (terms * root).T + 1e-12 * np.eye(len(terms))
    return amount, math.sqrt(NEIGHBOURS * float(np.linalg.inv(curvature)[0, 0]))


def _without_noise(cells: Cells, channel: int) -> tuple[Array, Array]:
    """Dark and bright envelope with the bias by noise removed."""
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
    return float(values[order][np.searchsorted(summed, quantile * summed[-1])])
