# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense, edge-preserving disparity from a coarse map and the image (section II-E).

Uses a weighted guided filter on a pyramid of coarse grids (coefficients on a coarse grid: He and
Sun, arXiv 1505.00996). The guide is grey, since a colour guide gave no more correct pixels. Sparse
areas are filled from coarser scales (push-pull: Gortler et al., doi 10.1145/237170.237200).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.enhancement.guided import Coefficients, Plane, guided
from uw_visibility.images.arrays import DisparityMap, Mask
from uw_visibility.images.cells import fold, spread

# Side of a cell of the finest grid, px.
CELL = 4
# Variance of position, px², added to that of the data: the slope is 0 in directions in which the
# data do not extend, as across a single row.
SLOPE_PRIOR = 1.0
# Weight of the next coarser grid: negligible beside data, but avoids division by 0 without data.
FLOOR = np.float32(1e-3)
# Variance, px², added to a window's residual before windows are weighted by its inverse: windows
# across a depth edge that is not in the image count little.
RESIDUAL = 0.05
# Change of disparity within a cell, px, that halves its weight: a mesh is wrong across depth edges,
# where it is a steep ramp.
STEEP = 2.0


class _Cells(NamedTuple):
    """Cells of a grid: mean of the guide, disparity, px, and its weight, (h, w) each."""

    guide: NDArray[Any]
    value: NDArray[Any]
    weight: NDArray[Any]


def refine(
    coarse: DisparityMap, guide: NDArray[Any], config: EnhancementConfig | None = None
) -> DisparityMap:
    """Make a coarse disparity map, a mesh or single points, dense and edge-preserving.

    A plane is fitted to all data, and the residual disparity is modelled as a linear function of
    the grey image within each window. Windows without data use the next coarser grid, up to the
    whole image.

    `coarse` (H, W) is px, NaN where unknown; `guide` the image of the same view. Returns (H, W),
    px, between the smallest and the largest given; all NaN if none is given.
    """
    config = config or EnhancementConfig()
    known = np.isfinite(coarse)
    if not known.any():
        return np.full(coarse.shape, np.nan, np.float32)
    grey = guide.astype(np.float32)
    if guide.ndim == 3:
        grey = cv2.cvtColor(grey, cv2.COLOR_RGB2GRAY)
    image = grey / np.float32(np.iinfo(guide.dtype).max) - np.float32(0.5)
    down, across = (np.arange(n, dtype=np.float32) for n in coarse.shape)
    down = down[:, np.newaxis]
    cells, (along_x, along_y, offset) = _reduce(coarse, known, image, across, down)
    radius = max(1, round(config.matting_radius / CELL))
    coefficients = _regress(cells, radius, config.matting_smoothness)
    disparity = _evaluate(coefficients, CELL, image)
    disparity += np.float32(along_x) * across + (along_y * down + offset).astype(np.float32)
    return np.clip(disparity, np.nanmin(coarse), np.nanmax(coarse))


def _reduce(
    coarse: DisparityMap, known: Mask, image: Plane, across: Plane, down: Plane
) -> tuple[_Cells, tuple[float, float, float]]:
    """Average over cells, and subtract a plane fitted to the disparities.

    Returns the cells, and of the plane the slopes per px along x and y and the value at (0, 0).
    """
    seen = known.astype(np.float32)
    count = fold(seen, CELL, 0.0)
    some = np.maximum(count, 1.0)
    value, x, y = (
        fold(values, CELL, 0.0) / some.astype(np.float64)
        for values in (np.where(known, coarse, np.float32(0.0)), seen * across, seen * down))
    near, far = (fold(coarse, CELL, np.nan, how) for how in (np.fmax, np.fmin))
    ramp = np.where(count > 0, near - far, np.inf) / STEEP
    weight = 1.0 / (1.0 + ramp**2)
    place = np.stack((x, y), axis=2)[count > 0]
    disparity, share = value[count > 0], weight[count > 0]
    middle, level = np.average(place, 0, share), np.average(disparity, 0, share)
    away = place - middle
    square = (share[:, np.newaxis] * away).T @ away + SLOPE_PRIOR * share.sum() * np.eye(2)
    slopes = np.linalg.solve(square, (share * (disparity - level)) @ away)
    plane = (float(slopes[0]), float(slopes[1]), float(level - slopes @ middle))
    value -= np.where(count > 0, plane[0] * x + plane[1] * y + plane[2], value)
    means = fold(image, CELL) / np.float32(CELL**2)
    return _Cells(means, value.astype(np.float32), weight.astype(np.float32)), plane


def _halved(cells: _Cells) -> _Cells:
    """The next coarser grid: means over two by two cells, where they have data."""
    total = fold(cells.weight, 2, 0.0)
    known = fold((cells.weight > 0).astype(np.float32), 2, 0.0)
    weighted = fold(cells.weight * cells.value, 2, 0.0)
    return _Cells(
        fold(cells.guide, 2) / np.float32(4.0), weighted / np.where(total > 0, total, 1),
        total / np.maximum(known, 1))


def _regress(cells: _Cells, radius: int, smoothness: float) -> Coefficients:
    """Slope over the guide and offset of disparity, averaged over all windows that contain a cell.

    `smoothness` is the regularisation ε of the slope, in units of the guide's variance.
    """
    prior: Plane = np.zeros_like(cells.value)
    if max(cells.value.shape) > 2 * radius + 1:
        prior = _evaluate(_regress(_halved(cells), radius, smoothness), 2, cells.guide)
    weight: Plane = cells.weight + FLOOR
    value = (cells.weight * cells.value + FLOOR * prior) / weight
    return guided(value, weight, cells.guide, radius, smoothness, RESIDUAL)


def _evaluate(coefficients: Coefficients, side: int, guide: Plane) -> Plane:
    """Disparity (H, W) from the coefficients of cells and the guide."""
    slope, offset = (spread(plane, side, guide.shape) for plane in coefficients)
    return np.asarray(slope * guide + offset)
