# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense, edge-preserving disparity from a coarse map and the image (section II-E).

By a weighted guided filter on a pyramid of coarse grids. Guided filter: He, Sun and Tang,
doi 10.1109/TPAMI.2012.213; its coefficients on a coarse grid: He and Sun, arXiv 1505.00996;
filling from coarser scales where data are thin: Gortler et al., doi 10.1145/237170.237200
(push-pull).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import EnhancementConfig
from uw_visibility.errors import InputError
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.images.pair import read_only

# Pixels of the image per cell of the finest grid, in either direction.
CELL = 4
# Variance of position (px²) added to that of the data, so that data in one row, or
# one pixel, which have no slope across it, get none.
SLOPE_PRIOR = 1.0
NO_PLANE = (0.0, 0.0, 0.0)


class Level:
    """One grid of the pyramid, with its buffers.

    guide: (h, w, 3) float32, mean of the guide, centred on 0.
    value, weight: (h, w) float32, disparity above the base plane, and its weight.
    place: (h, w, 2) float32, x and y, px, that `value` stands for; of the finest grid only.
    prior: (h, w) float32, what the next coarser level says about `value`.
    moments, solved: (h, n, w) float32, sums along rows.
    coefficients: (h, 4, w) float32, slopes for the three channels, offset.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        height, width = shape
        self.guide = np.empty((height, width, 3), np.float32)
        self.value = np.empty(shape, np.float32)
        self.weight = np.empty(shape, np.float32)
        self.prior = np.zeros(shape, np.float32)
        self.place = np.empty((height, width, 2), np.float32)
        self.moments = np.empty((height, MOMENTS, width), np.float32)
        self.solved = np.empty((height, SOLVED, width), np.float32)
        self.coefficients = np.empty((height, 4, width), np.float32)


class GuidedFilter:
    """Dense disparity from a coarse one and an image, for one size of image.

    Disparity is taken as a linear function of the image's colours within each
    window of a radius, px, over a plane fitted to all data. What has no data nearby follows
    the next coarser grid, up to the whole image. `smoothness` is the regularisation ε of the
    slopes, variance of a guide of 0..1. Holds its buffers: one call at a time.
    """

    def __init__(
        self, shape: tuple[int, int], radius: int, smoothness: float, workers: Workers
    ) -> None:
        self.shape = shape
        self._radius = max(1, round(radius / CELL))
        self.smoothness = smoothness
        self._workers = workers
        # Small grids are not worth a second thread.
        self._alone = Workers(1)
        size = (-(-shape[0] // CELL), -(-shape[1] // CELL))
        self.levels = [Level(size)]
        while max(size) > 2 * self._radius + 1:
            size = (-(-size[0] // 2), -(-size[1] // 2))
            self.levels.append(Level(size))
        self._extremes = np.empty((self.levels[0].value.shape[0], 2), np.float32)

    def run(
        self, coarse: DisparityMap, guide: NDArray[np.generic], disparity: DisparityMap
    ) -> bool:
        """Filter the map ``coarse`` (H, W), NaN where unknown, into ``disparity``; px.

        ``guide`` is the image (H, W, 3) whose edges the result follows. Without any disparity
        to start from nothing is written.
        """
        low, high = self.reduce(coarse, guide)
        if not low <= high:
            return False
        finest = self.levels[0]
        plane = subtract_plane(finest.value, finest.weight, finest.place, SLOPE_PRIOR)
        self._fill()
        self.apply(guide, plane, (low, high), disparity)
        return True

    def reduce(self, coarse: DisparityMap, guide: NDArray[np.generic]) -> tuple[float, float]:
        """Average the input over the cells of the finest grid; extremes of the disparities."""
        finest = self.levels[0]
        self._workers.rows(
            reduce_image, finest.value.shape[0], coarse, guide, _scale(guide), CELL, finest.guide,
            finest.value, finest.weight, finest.place, self._extremes,
        )
        return float(self._extremes[:, 0].min()), float(self._extremes[:, 1].max())

    def _fill(self) -> None:
        """Regress all grids, each over what the next coarser one says."""
        for fine, small in zip(self.levels[:-1], self.levels[1:], strict=True):
            pull(fine.guide, fine.value, fine.weight, small.guide, small.value, small.weight)
        for fine, small in zip(self.levels[-2::-1], self.levels[:0:-1], strict=True):
            self._regress(small, self._radius, self._alone)
            apply_coefficients(
                0, fine.value.shape[0], small.coefficients, fine.guide,
                np.float32(1), np.float32(0), 2, NO_PLANE,
                np.float32(-math.inf), np.float32(math.inf), fine.prior,
            )
        self.regress()

    def regress(self, radius: int | None = None) -> None:
        """Regress the finest grid's `value` on its guide, over windows of `radius` cells."""
        self._regress(self.levels[0], radius or self._radius, self._workers)

    def apply(
        self, guide: NDArray[np.generic], plane: tuple[float, float, float],
        limits: tuple[float, float], disparity: DisparityMap,
    ) -> None:
        """Evaluate the finest grid's coefficients on the image itself."""
        self._workers.rows(
            apply_coefficients, self.shape[0], self.levels[0].coefficients, guide, _scale(guide),
            np.float32(0.5), CELL, plane, np.float32(limits[0]), np.float32(limits[1]), disparity,
        )

    def _regress(self, level: Level, radius: int, workers: Workers) -> None:
        height = level.value.shape[0]
        workers.rows(
            moments, height, level.guide, level.value, level.weight, level.prior, radius,
            level.moments,
        )
        workers.rows(solve, height, level.moments, radius, self.smoothness, level.solved)
        workers.rows(average, height, level.solved, radius, level.coefficients)


def _scale(guide: NDArray[np.generic]) -> np.float32:
    return np.float32(1 / (255 if guide.dtype == np.uint8 else 65535))


class Matting:
    """Matting of coarse disparity maps: refined against the image and extended to all pixels.

    Keeps its buffers for the last size of image: one call at a time.
    """

    def __init__(
        self, config: EnhancementConfig | None = None, workers: Workers | None = None
    ) -> None:
        self._config = config or EnhancementConfig()
        self._workers = workers or Workers(1)
        self._filter: GuidedFilter | None = None

    def refine(self, coarse: DisparityMap, guide: NDArray[np.generic]) -> NDArray[np.float32]:
        """Refine a coarse disparity map, a mesh or single points, and make it dense.

        coarse: (H, W) float32, disparity, px; NaN where unknown.
        guide: (H, W, 3) or (H, W) of uint8 or uint16, image of the same view.
        Returns (H, W) float32, disparity, px, between the smallest and the largest given; NaN
        everywhere where there is none.
        """
        image = _colour(guide)
        if image.shape[:2] != coarse.shape:
            raise InputError(
                f"image of {image.shape[1]}x{image.shape[0]} px does not fit a disparity map of "
                f"{coarse.shape[1]}x{coarse.shape[0]} px: give both of the same view"
            )
        disparity = np.full(coarse.shape, np.nan, np.float32)
        size = (coarse.shape[0], coarse.shape[1])
        if self._filter is None or self._filter.shape != size:
            self._filter = GuidedFilter(
                size, self._config.matting_radius, self._config.matting_smoothness, self._workers
            )
        self._filter.run(coarse, image, disparity)
        return disparity


def _colour(guide: NDArray[np.generic]) -> NDArray[np.generic]:
    if guide.dtype not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise InputError(f"image of type {guide.dtype} cannot guide matting: give 8 or 16 bit")
    if guide.ndim == 2:
        # As contiguous as a colour image, so that there is one kernel for both.
        return read_only(np.repeat(guide[:, :, np.newaxis], 3, axis=2))
    return guide


# Weight of what the next coarser scale says. It keeps sums that divide away
# from zero where there are no data, and is negligible beside data.
FLOOR = np.float32(1e-3)
# Variance, px², added to a window's residual before windows are weighed with
# its inverse: windows across a depth edge that the image does not explain count little.
RESIDUAL = 0.05
# A mesh across a depth edge is a steep ramp that is nowhere true: where disparity
# changes by this much (px) within a cell, it counts half.
STEEP = np.float32(2)
# Sums over a window: Σw, Σwg (3), Σwd, Σwd², Σwdg (3), Σwgg (6).
MOMENTS = 15
# Sums over windows: slopes (3), offset, weight.
SOLVED = 5


@njit(nogil=True, error_model="numpy")
def reduce_image(
    start: int, stop: int, coarse: Any, guide: Any, scale: Any, cell: int,
    small_guide: Any, value: Any, weight: Any, place: Any, extremes: Any,
) -> None:
    """Average image and disparity over cells."""
    height, width = coarse.shape
    for i in range(start, stop):
        low = np.float32(np.inf)
        high = np.float32(-np.inf)
        top = i * cell
        bottom = min(top + cell, height)
        for j in range(value.shape[1]):
            first = j * cell
            last = min(first + cell, width)
            red = green = blue = np.float32(0)
            known = total = across = down = np.float32(0)
            near = np.float32(-np.inf)
            far = np.float32(np.inf)
            for y in range(top, bottom):
                for x in range(first, last):
                    red += np.float32(guide[y, x, 0])
                    green += np.float32(guide[y, x, 1])
                    blue += np.float32(guide[y, x, 2])
                    d = coarse[y, x]
                    if np.isfinite(d):
                        known += np.float32(1)
                        total += d
                        across += np.float32(x)
                        down += np.float32(y)
                        far = min(far, d)
                        near = max(near, d)
            low = min(low, far)
            high = max(high, near)
            share = scale / np.float32((bottom - top) * (last - first))
            small_guide[i, j, 0] = red * share - np.float32(0.5)
            small_guide[i, j, 1] = green * share - np.float32(0.5)
            small_guide[i, j, 2] = blue * share - np.float32(0.5)
            if known > 0:
                ramp = (near - far) / STEEP
                weight[i, j] = 1 / (1 + ramp * ramp)
                value[i, j] = total / known
                place[i, j, 0] = across / known
                place[i, j, 1] = down / known
            else:
                weight[i, j] = 0
                value[i, j] = 0
                place[i, j] = 0
        extremes[i, 0] = low
        extremes[i, 1] = high


@njit(nogil=True, error_model="numpy")
def subtract_plane(
    value: Any, weight: Any, place: Any, slope_prior: float
) -> tuple[Any, Any, Any]:
    """Subtract the plane that fits the weighted disparities.

    Returns its slopes per px along x and y and its value at (0, 0).
    """
    height, width = value.shape
    total = mean_x = mean_y = mean_d = 0.0
    for i in range(height):
        for j in range(width):
            w = np.float64(weight[i, j])
            total += w
            mean_x += w * place[i, j, 0]
            mean_y += w * place[i, j, 1]
            mean_d += w * value[i, j]
    mean_x /= total
    mean_y /= total
    mean_d /= total
    xx = yy = slope_prior * total
    xy = xd = yd = 0.0
    for i in range(height):
        for j in range(width):
            w = np.float64(weight[i, j])
            x = place[i, j, 0] - mean_x
            y = place[i, j, 1] - mean_y
            d = value[i, j] - mean_d
            xx += w * x * x
            xy += w * x * y
            yy += w * y * y
            xd += w * x * d
            yd += w * y * d
    determinant = xx * yy - xy * xy
    a = (xd * yy - yd * xy) / determinant
    b = (yd * xx - xd * xy) / determinant
    offset = mean_d - a * mean_x - b * mean_y
    for i in range(height):
        for j in range(width):
            if weight[i, j] > 0:
                value[i, j] -= np.float32(a * place[i, j, 0] + b * place[i, j, 1] + offset)
    return a, b, offset


@njit(nogil=True, error_model="numpy")
def pull(
    guide: Any, value: Any, weight: Any, small_guide: Any, small_value: Any, small_weight: Any
) -> None:
    """Average a grid over 2 x 2 cells into the next coarser one."""
    height, width = value.shape
    for i in range(small_value.shape[0]):
        for j in range(small_value.shape[1]):
            total = weighted = np.float32(0)
            known = 0
            cells = 0
            for k in range(3):
                small_guide[i, j, k] = 0
            for y in range(2 * i, min(2 * i + 2, height)):
                for x in range(2 * j, min(2 * j + 2, width)):
                    cells += 1
                    for k in range(3):
                        small_guide[i, j, k] += guide[y, x, k]
                    if weight[y, x] > 0:
                        known += 1
                        total += weight[y, x]
                        weighted += weight[y, x] * value[y, x]
            for k in range(3):
                small_guide[i, j, k] /= np.float32(cells)
            if known > 0:
                small_weight[i, j] = total / np.float32(known)
                small_value[i, j] = weighted / total
            else:
                small_weight[i, j] = 0
                small_value[i, j] = 0


@njit(nogil=True, error_model="numpy")
def _sum_columns(row: Any, radius: int, out: Any) -> None:
    """Sum a row over windows of 2 radius + 1 columns, cut at the ends."""
    width = row.shape[0]
    out[:] = row
    for k in range(1, min(radius + 1, width)):
        left = out[: width - k]
        right = out[k:]
        shifted = row[k:]
        for x in range(width - k):
            left[x] += shifted[x]
        for x in range(width - k):
            right[x] += row[x]


@njit(nogil=True, error_model="numpy")
def moments(
    start: int, stop: int, guide: Any, value: Any, weight: Any, prior: Any, radius: int, out: Any
) -> None:
    """Sum the products that a weighted regression needs along each row."""
    width = value.shape[1]
    row = np.empty((MOMENTS, width), np.float32)
    for i in range(start, stop):
        for x in range(width):
            w = weight[i, x] + FLOOR
            d = (weight[i, x] * value[i, x] + FLOOR * prior[i, x]) / w
            r = guide[i, x, 0]
            g = guide[i, x, 1]
            b = guide[i, x, 2]
            wr = w * r
            wg = w * g
            wb = w * b
            row[0, x] = w
            row[1, x] = wr
            row[2, x] = wg
            row[3, x] = wb
            row[4, x] = w * d
            row[5, x] = w * d * d
            row[6, x] = wr * d
            row[7, x] = wg * d
            row[8, x] = wb * d
            row[9, x] = wr * r
            row[10, x] = wr * g
            row[11, x] = wr * b
            row[12, x] = wg * g
            row[13, x] = wg * b
            row[14, x] = wb * b
        for m in range(MOMENTS):
            _sum_columns(row[m], radius, out[i, m])


@njit(nogil=True, error_model="numpy")
def _sum_rows(planes: Any, i: int, radius: int, out: Any) -> None:
    """Sum (h, n, w) planes over the rows around row i."""
    first = max(i - radius, 0)
    last = min(i + radius + 1, planes.shape[0])
    out[:] = 0
    for y in range(first, last):
        for m in range(out.shape[0]):
            source = planes[y, m]
            target = out[m]
            for x in range(target.shape[0]):
                target[x] += source[x]


@njit(nogil=True, error_model="numpy")
def solve(start: int, stop: int, sums: Any, radius: int, smoothness: float, out: Any) -> None:
    """Regress disparity on the guide in each window, and sum the solutions along each row."""
    width = sums.shape[2]
    s = np.empty((MOMENTS, width), np.float32)
    row = np.empty((SOLVED, width), np.float32)
    for i in range(start, stop):
        _sum_rows(sums, i, radius, s)
        for x in range(width):
            inverse = 1.0 / s[0, x]
            r = s[1, x] * inverse
            g = s[2, x] * inverse
            b = s[3, x] * inverse
            d = s[4, x] * inverse
            dr = s[6, x] * inverse - d * r
            dg = s[7, x] * inverse - d * g
            db = s[8, x] * inverse - d * b
            rr = s[9, x] * inverse - r * r + smoothness
            rg = s[10, x] * inverse - r * g
            rb = s[11, x] * inverse - r * b
            gg = s[12, x] * inverse - g * g + smoothness
            gb = s[13, x] * inverse - g * b
            bb = s[14, x] * inverse - b * b + smoothness
            c_rr = gg * bb - gb * gb
            c_rg = rb * gb - rg * bb
            c_rb = rg * gb - rb * gg
            determinant = rr * c_rr + rg * c_rg + rb * c_rb
            slope_r = slope_g = slope_b = 0.0
            if determinant > 0:
                c_gg = rr * bb - rb * rb
                c_gb = rg * rb - rr * gb
                c_bb = rr * gg - rg * rg
                slope_r = (c_rr * dr + c_rg * dg + c_rb * db) / determinant
                slope_g = (c_rg * dr + c_gg * dg + c_gb * db) / determinant
                slope_b = (c_rb * dr + c_gb * dg + c_bb * db) / determinant
            variance = s[5, x] * inverse - d * d
            residual = variance - slope_r * dr - slope_g * dg - slope_b * db
            q = s[0, x] / (max(residual, 0.0) + RESIDUAL)
            row[0, x] = q * slope_r
            row[1, x] = q * slope_g
            row[2, x] = q * slope_b
            row[3, x] = q * (d - slope_r * r - slope_g * g - slope_b * b)
            row[4, x] = q
        for m in range(SOLVED):
            _sum_columns(row[m], radius, out[i, m])


@njit(nogil=True, error_model="numpy")
def average(start: int, stop: int, solved: Any, radius: int, coefficients: Any) -> None:
    """Average the solutions of all windows that hold a cell, by their weight."""
    width = solved.shape[2]
    s = np.empty((SOLVED, width), np.float32)
    for i in range(start, stop):
        _sum_rows(solved, i, radius, s)
        for x in range(width):
            inverse = np.float32(1) / s[4, x]
            for m in range(4):
                coefficients[i, m, x] = s[m, x] * inverse


@njit(nogil=True, error_model="numpy")
def apply_coefficients(
    start: int, stop: int, coefficients: Any, guide: Any, scale: Any, centre: Any, factor: int,
    plane: Any, low: Any, high: Any, value: Any,
) -> None:
    """Evaluate coefficients, interpolated between cells, on a guide ``factor`` times finer."""
    small_height, _, small_width = coefficients.shape
    width = value.shape[1]
    a = np.empty((small_width, 4), np.float32)
    step = np.float32(1 / factor)
    half = np.float32(0.5)
    for y in range(start, stop):
        v = min(max((y + half) * step - half, np.float32(0)), np.float32(small_height - 1))
        i = index_of(v, 0, max(small_height - 2, 0))
        below = min(i + 1, small_height - 1)
        t = np.float32(v - i)
        for m in range(4):
            for j in range(small_width):
                upper = coefficients[i, m, j]
                a[j, m] = upper + t * (coefficients[below, m, j] - upper)
        # The guide is centred and scaled here once instead of at every pixel.
        for j in range(small_width):
            a[j, 3] -= (a[j, 0] + a[j, 1] + a[j, 2]) * centre
            for m in range(3):
                a[j, m] *= scale
        base = np.float32(plane[1] * y + plane[2])
        slope = np.float32(plane[0])
        # Between the centres of cells j and j + 1, coefficients change linearly.
        for j in range(-1, small_width):
            k = max(j, 0)
            after = min(j + 1, small_width - 1)
            r = a[k, 0]
            g = a[k, 1]
            b = a[k, 2]
            d = a[k, 3]
            more_r = a[after, 0] - r
            more_g = a[after, 1] - g
            more_b = a[after, 2] - b
            more_d = a[after, 3] - d
            first = j * factor + factor // 2
            for x in range(max(first, 0), min(first + factor, width)):
                s = (np.float32(x - first) + half) * step
                red = np.float32(guide[y, x, 0]) * (r + s * more_r)
                green = np.float32(guide[y, x, 1]) * (g + s * more_g)
                blue = np.float32(guide[y, x, 2]) * (b + s * more_b)
                linear = base + slope * np.float32(x)
                total = (red + green) + (blue + (d + s * more_d)) + linear
                value[y, x] = min(max(total, low), high)
