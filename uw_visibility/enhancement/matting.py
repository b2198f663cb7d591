# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense, edge-preserving disparity from a coarse map and the image (section II-E).

By a weighted guided filter on a pyramid of coarse grids. Guided filter: He, Sun and Tang,
doi 10.1109/TPAMI.2012.213; its coefficients on a coarse grid: He and Sun, arXiv 1505.00996;
filling from coarser scales where data are thin: Gortler et al., doi 10.1145/237170.237200
(push-pull).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array, DisparityMap, Mask
from uw_visibility.images.cells import fold, spread

# Pixels of the image per cell of the finest grid, in either direction.
CELL = 4
# Variance of position (px²) added to that of the data, so that data in one row, or
# one pixel, which have no slope across it, get none.
SLOPE_PRIOR = 1.0
# Weight of what the next coarser grid says. It keeps sums that divide away
# from zero where there are no data, and is negligible beside data.
FLOOR = 1e-3
# Variance, px², added to a window's residual before windows are weighed with
# its inverse: windows across a depth edge that the image does not explain count little.
RESIDUAL = 0.05
# A mesh across a depth edge is a steep ramp that is nowhere true: where disparity
# changes by this much (px) within a cell, it counts half.
STEEP = 2.0


class _Cells(NamedTuple):
    """Cells of a grid: mean of the guide (h, w, 3), disparity, px, and its weight, (h, w) each."""

    guide: Array
    value: Array
    weight: Array


def refine(
    coarse: DisparityMap, guide: NDArray[Any], config: EnhancementConfig | None = None
) -> DisparityMap:
    """Refine a coarse disparity map, a mesh or single points, and make it dense.

    Disparity is taken as a linear function of the image's colours within each window of a radius,
    over a plane fitted to all data. What has no data nearby follows the next coarser grid, up to
    the whole image.

    Parameters
    ----------
    coarse : (H, W) float32 ndarray
        Disparity, px; NaN where unknown.
    guide : (H, W, 3) or (H, W) ndarray of uint8 or uint16
        Image of the same view.
    config : EnhancementConfig, optional
        Radius and smoothness of the filter.

    Returns
    -------
    (H, W) float32 ndarray
        Disparity, px, between the smallest and the largest given; NaN everywhere where there is
        none.

    Raises
    ------
    InputError
        If the image does not fit the map.
    """
    config = config or EnhancementConfig()
    if guide.shape[:2] != coarse.shape:
        raise InputError(
            f"image of {guide.shape[1]}x{guide.shape[0]} px does not fit a disparity map of "
            f"{coarse.shape[1]}x{coarse.shape[0]} px: give both of the same view")
    if guide.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise InputError(f"image of type {guide.dtype} cannot guide matting: give 8 or 16 bit")
    known = np.isfinite(coarse)
    if not known.any():
        return np.full(coarse.shape, np.nan, np.float32)
    colours = guide if guide.ndim == 3 else guide[..., np.newaxis]
    image = np.broadcast_to(
        colours / np.float32(np.iinfo(guide.dtype).max) - np.float32(0.5), (*coarse.shape, 3))
    down, across = (np.arange(n, dtype=np.float64) for n in coarse.shape)
    down = down[:, np.newaxis]
    cells, (along_x, along_y, offset) = _reduce(coarse, known, image, across, down)
    radius = max(1, round(config.matting_radius / CELL))
    coefficients = _regress(cells, radius, config.matting_smoothness).astype(np.float32)
    disparity = _evaluate(spread(coefficients, CELL, coarse.shape), image) + (
        along_x * across + along_y * down + offset)
    return np.clip(disparity, coarse[known].min(), coarse[known].max()).astype(np.float32)


def _reduce(
    coarse: DisparityMap, known: Mask, image: NDArray[Any], across: Array, down: Array
) -> tuple[_Cells, tuple[float, float, float]]:
    """Average over cells, and take off the plane of the disparities.

    Of the plane returns the slopes per px along x and y and the value at (0, 0).
    """
    count = fold(known.astype(np.float32), CELL, 0.0)
    some = np.maximum(count, 1.0)
    value, x, y = (
        np.asarray(fold(np.where(known, values, 0.0), CELL, 0.0) / some)
        for values in (coarse, across, down))
    near = fold(np.where(known, coarse, -np.inf), CELL, -np.inf, np.maximum)
    far = fold(np.where(known, coarse, np.inf), CELL, np.inf, np.minimum)
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
    return _Cells(fold(image, CELL) / CELL**2, value, weight), plane


def _halved(cells: _Cells) -> _Cells:
    """The next coarser grid: means of what is known in two by two cells."""
    total = fold(cells.weight, 2, 0.0)
    known = np.maximum(fold((cells.weight > 0).astype(np.float64), 2, 0.0), 1.0)
    weighted = fold(cells.weight * cells.value, 2, 0.0)
    return _Cells(
        fold(cells.guide, 2) / 4.0, weighted / np.where(total > 0, total, 1.0), total / known)


def _regress(cells: _Cells, radius: int, smoothness: float) -> Array:
    """Coefficients (h, w, 4) of disparity: slopes over the colours, and an offset.

    They are means over all windows that hold a cell. `smoothness` is the regularisation ε of the
    slopes, variance of a guide of 0..1.
    """
    prior: Array | float = 0.0
    if max(cells.value.shape) > 2 * radius + 1:
        coarser = _regress(_halved(cells), radius, smoothness).astype(np.float32)
        prior = _evaluate(spread(coarser, 2, cells.value.shape), cells.guide)
    weight = cells.weight + FLOOR
    value = (cells.weight * cells.value + FLOOR * prior) / weight
    each = np.concatenate((
        np.ones((*value.shape, 1)), cells.guide, value[..., np.newaxis]), axis=2)
    summed = _box(
        weight[..., np.newaxis, np.newaxis] * each[..., np.newaxis] * each[..., np.newaxis, :],
        radius)
    total = summed[..., 0, 0]
    mean = summed[..., 0, 1:] / total[..., np.newaxis]
    covariance = (
        summed[..., 1:, 1:] / total[..., np.newaxis, np.newaxis]
        - mean[..., np.newaxis] * mean[..., np.newaxis, :])
    of_guide, with_value = covariance[..., :3, :3], covariance[..., :3, 3]
    slopes = np.linalg.solve(
        of_guide + smoothness * np.eye(3), with_value[..., np.newaxis])[..., 0]
    residual = covariance[..., 3, 3] - (slopes * with_value).sum(axis=2)
    offset = mean[..., 3] - (slopes * mean[..., :3]).sum(axis=2)
    trust = total / (np.maximum(residual, 0.0) + RESIDUAL)
    solved = np.concatenate((
        slopes, offset[..., np.newaxis], np.ones_like(offset)[..., np.newaxis]), axis=2)
    averaged = _box(trust[..., np.newaxis] * solved, radius)
    return np.asarray(averaged[..., :4] / averaged[..., 4:])


def _box(values: Array, radius: int) -> Array:
    """Sums over windows of 2 radius + 1 cells, cut at the border, (h, w, ...)."""
    flat = values.reshape(*values.shape[:2], -1)
    side = 2 * radius + 1
    return np.asarray(cv2.boxFilter(
        flat, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT,
    )).reshape(values.shape)


def _evaluate(coefficients: NDArray[Any], guide: NDArray[Any]) -> NDArray[Any]:
    """Disparity by coefficients (H, W, 4) and the guide (H, W, 3)."""
    return np.asarray(
        np.einsum("yxc,yxc->yx", coefficients[..., :3], guide) + coefficients[..., 3])
