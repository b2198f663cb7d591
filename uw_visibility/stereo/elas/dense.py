# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense matching: the best disparity near the mesh's plane or a support point's.

Section 2.2 of Geiger, Roser and Urtasun, "Efficient Large-Scale Stereo Matching",
ACCV 2010, doi:10.1007/978-3-642-19315-6_3: maximum a posteriori over the disparities
that the prior deems likely.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.kernel_cache import njit
from uw_visibility.parallel import Workers
from uw_visibility.stereo.airlight import AirlightPrior
from uw_visibility.stereo.elas.absolute_difference import BYTES, absolute_difference
from uw_visibility.stereo.elas.descriptors import MIDDLE

# Side of the cells that collect the support points' disparities, px.
CELL = 20
# Descriptors reach two pixels to each side, and the border's repeats prove nothing.
BORDER = 2
# Energy and disparity share one integer, energy above, so that the best of both
# is one minimum without a branch; of equal energies the smaller disparity stays.
_DISPARITY_BITS = 11
_DISPARITY_MASK = (1 << _DISPARITY_BITS) - 1
_NOTHING = np.int32((1 << 30) - 1)
# Sum of gradient responses from which a pixel's match needs no help of the airlight.
_TEXTURED = np.float32(400.0)
# What a range beyond the bound costs, over what thickness within it does, and the
# thickness of which more within it costs no more.
_BEYOND = np.float32(5.0)
_MOST_THICKNESS = np.float32(30.0)


@dataclass(frozen=True)
class DenseSettings:
    """Weights of likelihood and prior; see `StereoConfig` for their meaning."""

    likelihood: float
    plane_radius: int
    plane_deviation: float
    outlier: float
    airlight: float

    def prior(self) -> NDArray[np.int32]:
        """Energy by distance from the plane, in units of descriptor difference.

        Returns
        -------
        ndarray
            ``(plane_radius + 1,)`` int32, at most 0.
        """
        distance = np.arange(self.plane_radius + 1)
        probability = self.outlier + np.exp(-(distance**2) / (2 * self.plane_deviation**2))
        energy = -(np.log(probability) - np.log(self.outlier)) / self.likelihood
        return np.round(energy).astype(np.int32)


class CellCandidates:
    """Disparities that the support points around each cell propose.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the images, px.
    disparities : int
        Number of disparities, from 0 on.
    """

    def __init__(self, shape: tuple[int, int], disparities: int) -> None:
        rows, columns = -(-shape[0] // CELL), -(-shape[1] // CELL)
        self._seen = np.empty((rows, columns, disparities), np.bool_)
        self.count: NDArray[np.int32] = np.empty((rows, columns), np.int32)
        self.values: NDArray[np.int16] = np.empty((rows, columns, disparities), np.int16)

    def fill(self, points: NDArray[np.float32]) -> None:
        """Collect the candidates from points ``(N, 3)``: u, v, disparity."""
        _fill_cells(points, self._seen, self.count, self.values)


def match(
    descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    plane: NDArray[np.float32],
    candidates: CellCandidates,
    disparities: tuple[int, int],
    settings: DenseSettings,
    best: NDArray[np.int16],
    workers: Workers,
    airlight: AirlightPrior | None = None,
) -> None:
    """Match every pixel of the left view, and every one of the right view with it.

    A pixel of the right view takes the best of the pairs that were tried for
    the left view: its own search would try nearly the same ones again.

    Parameters
    ----------
    descriptors : tuple of ndarray
        Of the left and of the right view, ``(H * W * 16,)`` uint8.
    plane : ndarray
        ``(H, W)`` float32, the mesh's disparity in the left view, NaN outside.
    candidates : CellCandidates
        What the support points propose.
    disparities : tuple of int
        Smallest and largest disparity, inclusive, px.
    settings : DenseSettings
        Weights.
    best : ndarray
        ``(2, H, W)`` int16, overwritten: disparity at the pixels of the left and
        of the right view, -1 where nothing was tried.
    workers : Workers
        Threads.
    airlight : AirlightPrior, optional
        What decides where texture does not.
    """
    farthest, thickness, strength = plane, np.empty(0, np.float32), 0.0
    if airlight is not None and settings.airlight > 0:
        farthest, thickness = airlight.farthest, airlight.thickness
        strength = settings.airlight * airlight.trust
    workers.rows(
        _match, plane.shape[0], descriptors[0], descriptors[1], plane, candidates.count,
        candidates.values, disparities[0], disparities[1], settings.prior(), farthest, thickness,
        np.float32(strength), best[0], best[1],
    )


@njit(nogil=True)
def _fill_cells(points: Any, seen: Any, count: Any, values: Any) -> None:
    rows, columns, disparities = seen.shape
    seen[:] = False
    for i in range(points.shape[0]):
        column = int(points[i, 0]) // CELL
        row = int(points[i, 1]) // CELL
        d = int(points[i, 2] + 0.5)
        for y in range(max(row - 1, 0), min(row + 2, rows)):
            for x in range(max(column - 1, 0), min(column + 2, columns)):
                for near in range(max(d - 1, 0), min(d + 2, disparities)):
                    seen[y, x, near] = True
    for y in range(rows):
        for x in range(columns):
            n = 0
            for d in range(disparities):
                if seen[y, x, d]:
                    values[y, x, n] = d
                    n += 1
            count[y, x] = n


@njit(nogil=True)
def _match(
    start: int, stop: int, left: Any, right: Any, plane: Any, count: Any, candidates: Any,
    low: int, high: int, prior: Any, farthest: Any, thickness: Any, strength: Any,
    best_left: Any, best_right: Any,
) -> None:
    height, width = plane.shape
    radius = len(prior) - 1
    here = np.empty(width, np.int32)
    there = np.empty(width, np.int32)
    middle = np.empty(width, np.int32)
    need = np.zeros(width, np.float32)
    needy = np.zeros(count.shape[1], np.bool_)
    cost = np.zeros(width, np.int32)
    blank = np.full(BYTES, MIDDLE, np.uint8)
    for y in range(start, stop):
        for x in range(width):
            here[x] = _NOTHING
            there[x] = _NOTHING
            mean = plane[y, x]
            middle[x] = np.int32(mean + np.float32(0.5)) if mean == mean else np.int32(-1 << 20)
        if BORDER <= y < height - BORDER:
            at = y * width * BYTES
            if thickness.size > 0:
                _weigh_need(left, at, blank, strength, need, needy)
            for column in range(count.shape[1]):
                for i in range(count[y // CELL, column]):
                    d = np.int32(candidates[y // CELL, column, i])
                    if low <= d <= high:
                        first = max(column * CELL, d + BORDER)
                        last = min((column + 1) * CELL, width - BORDER)
                        if needy[column]:
                            _airlight_cost(need, farthest[y], thickness[d], first, last, cost)
                            _try_with_cost(left, right, at, d, first, last, cost, here, there)
                        else:
                            _try_disparity(left, right, at, d, first, last, here, there)
            if thickness.size > 0:
                _plane_cost(need, farthest[y], thickness, middle, cost)
            for offset in range(-radius, radius + 1):
                _try_plane(
                    left, right, at, offset, low, high, middle, prior[abs(offset)], cost, here,
                    there,
                )
        for x in range(width):
            best_left[y, x] = _disparity_of(here[x])
            best_right[y, x] = _disparity_of(there[x])


@njit(nogil=True)
def _disparity_of(key: Any) -> Any:
    return np.int16(-1) if key == _NOTHING else np.int16(key & _DISPARITY_MASK)


@njit(nogil=True)
def as_disparity(start: int, stop: int, best: Any, disparity: Any) -> None:
    """Write what was found as float32, px, with NaN for nothing."""
    for y in range(start, stop):
        for x in range(best.shape[1]):
            d = np.float32(best[y, x])
            disparity[y, x] = d if d >= 0 else np.float32(np.nan)


@njit(nogil=True)
def _weigh_need(left: Any, at: int, blank: Any, strength: Any, need: Any, needy: Any) -> None:
    """Write how much each pixel of a row needs the airlight, and which cells do at all."""
    for x in range(need.size):
        texture = np.float32(absolute_difference(left, at + x * BYTES, blank, x & 0))
        need[x] = strength * max(np.float32(1) - texture / _TEXTURED, np.float32(0))
    for column in range(needy.size):
        most = np.float32(0)
        for x in range(column * CELL, min((column + 1) * CELL, need.size)):
            most = max(most, need[x])
        needy[column] = most > 0


@njit(nogil=True)
def _thickness_cost(need: Any, farthest: Any, thickness: Any) -> Any:
    """Energy of an optical thickness: a brighter surface is less likely, a negative one barred."""
    excess = farthest - thickness
    excess = excess if excess > 0 else -_BEYOND * excess
    return np.int32(need * min(excess, _MOST_THICKNESS))


@njit(nogil=True)
def _airlight_cost(
    need: Any, farthest: Any, thickness: Any, first: int, last: int, cost: Any
) -> None:
    # Unsigned columns need no check for negative ones, which would keep the loop from
    # becoming vector code.
    for x in range(np.uintp(first), np.uintp(last)):
        cost[x] = _thickness_cost(need[x], farthest[x], thickness)


@njit(nogil=True)
def _plane_cost(need: Any, farthest: Any, thickness: Any, middle: Any, cost: Any) -> None:
    """Cost of each pixel's plane, which its surroundings within a few pixels share."""
    last = thickness.size - 1
    for x in range(need.size):
        cost[x] = _thickness_cost(need[x], farthest[x], thickness[min(max(middle[x], 0), last)])


@njit(nogil=True)
def _try_disparity(
    left: Any, right: Any, at: int, d: int, first: int, last: int, here: Any, there: Any
) -> None:
    """Offer one disparity to the pixels of a cell's row.

    The prior is left out: where it is below zero, `_try_plane` offers the same
    disparity with it.
    """
    shift = d * BYTES
    for x in range(first, last):
        i = at + x * BYTES
        key = np.int32((absolute_difference(left, i, right, i - shift) << _DISPARITY_BITS) + d)
        here[x] = min(here[x], key)
        there[x - d] = min(there[x - d], key)


@njit(nogil=True)
def _try_with_cost(
    left: Any, right: Any, at: int, d: int, first: int, last: int, cost: Any, here: Any,
    there: Any,
) -> None:
    """Offer one disparity to the pixels of a cell's row, each at a cost of its own."""
    shift = d * BYTES
    for x in range(first, last):
        i = at + x * BYTES
        energy = cost[x] + absolute_difference(left, i, right, i - shift)
        key = np.int32((energy << _DISPARITY_BITS) + d)
        here[x] = min(here[x], key)
        there[x - d] = min(there[x - d], key)


@njit(nogil=True)
def _try_plane(
    left: Any, right: Any, at: int, offset: int, low: int, high: int, middle: Any, prior: int,
    cost: Any, here: Any, there: Any,
) -> None:
    """Offer each pixel of a row the disparity at one distance from its plane."""
    width = here.size
    for x in range(BORDER, width - BORDER):
        d = middle[x] + offset
        if d < low or d > min(high, x - BORDER):
            continue
        i = at + x * BYTES
        energy = prior + cost[x] + absolute_difference(left, i, right, i - d * BYTES)
        key = np.int32((energy << _DISPARITY_BITS) + d)
        here[x] = min(here[x], key)
        there[x - d] = min(there[x - d], key)
