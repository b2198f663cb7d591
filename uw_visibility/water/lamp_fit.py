# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fit of attenuation to the contrast of a lamp-lit image.

Contrast falls as W D(β) with the direct light of the lamps, whatever the water scatters.
Daylight beside the lamps adds a share e^(−βd) to the direct light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.optics.lamps import ATTENUATIONS
from uw_visibility.water.lamp_cells import Cells

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
# Shares of daylight that are tried at first, in so many iterations each.
DAYLIGHT_SHARES, TRIAL_ITERATIONS = (1e-3, 0.02, 0.06, 0.15, 0.4, 1.0), 15
# What β may be below clear water's by chance, 1/m.
CLEARER = 0.03
# Cells that are needed, and what their contrast is over that of noise.
FEWEST_CELLS, ABOVE_NOISE = 6, 2.0
# Mean light over that noise: pixels have 2.4 times as much, and at least two deviations of it
# have to be above black.
ABOVE_BLACK = 5.0
# Cells beside one another show the same objects.
NEIGHBOURS = 4.0
# What a scene's texture changes over range, as the logarithm of contrast per one standard
# deviation of the path of light: common to the channels, and of each alone.
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
    """Robust least squares of contrast over the light's path, each channel of its own.

    Parameters
    ----------
    cells : Cells
    both : bool
        Whether daylight may light the scene beside the lamps.
    clear_water : (3,) float64 ndarray
        κ, 1/m, below which no water attenuates.
    """
    share = _share_of_daylight(cells, clear_water) if both else None
    found = [_fit_channel(cells, channel, share) for channel in range(3)]
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
        beta, covariance, np.array([each[1] for each in found]),
        np.array([each[4] for each in found]), max(each[6] for each in found))


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


def _fit_channel(
    cells: Cells, channel: int, share: float | None
) -> tuple[float, float, Array, float, int, Array, int]:
    """β, daylight's share, influence of cells, spread of paths, cells, effect of lamps moved."""
    data = _data_of(cells, channel)
    if data.number < FEWEST_CELLS:
        return (
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
    return float(p[0]), day, score * residual, spread, data.number, moved, iteration


def _share_of_daylight(cells: Cells, clear_water: Array) -> float:
    """Daylight's share from which contrast fits best, in all channels alike.

    Contrast under lamps and daylight looks much like that under lamps alone in water that is
    clearer than any.
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
    """Take Gauss-Newton's steps in the first so many parameters; parameters and their number."""
    iteration, step = 0, np.ones(1)
    # Scales and weights follow the parameters (quasi-likelihood), so that there is no cost
    # that steps could be held to.
    while iteration < most and np.abs(step).max() > 1e-5:
        iteration += 1
        jacobian, residual, w, _, _ = _linearise(data, p)
        curvature, slope = _normal_equations(jacobian, residual, w, p)
        step = np.zeros(len(p))
        step[:free] = np.clip(
            np.linalg.solve(curvature[:free, :free], slope[:free]), -0.5, 0.5)
        step[0] = np.clip(p[0] + step[0], ATTENUATIONS[0], ATTENUATIONS[-1]) - p[0]
        p = p + step
    return p, iteration


def _normal_equations(
    jacobian: Array, residual: Array, w: Array, p: Array
) -> tuple[Array, Array]:
    curvature = jacobian.T @ (w[:, None] * jacobian) + 1e-9 * np.eye(len(p))
    slope = jacobian.T @ (w * residual)
    if len(p) == 3:
        curvature[2, 2] += DAYLIGHT_WEIGHT
        slope[2] -= DAYLIGHT_WEIGHT * (p[2] - LITTLE_DAYLIGHT)
    return curvature, slope


def _misfit(data: _Data, p: Array) -> float:
    """Negative logarithm of the likelihood by Cauchy's loss, whose scale the model sets."""
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
    return jacobian, residual, data.weight / (1.0 + (residual / TAIL) ** 2), path, deviation
