# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense matching in noise: semi-global along rows and from above, near the mesh's plane.

Where noise hides texture one descriptor tells little, and a path of them more: semi-global
matching (Hirschmüller 2008, doi:10.1109/TPAMI.2007.1166) by three paths, which need no memory
but that of two rows. A cost is the difference of the descriptors, that of the tones, which
gradients do not hold, and the prior of the mesh's plane as in `dense`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.arrays import Points
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas.dense import BORDER, plane_prior
from uw_visibility.stereo.elas.descriptors import BYTES, absolute_difference
from uw_visibility.stereo.elas.postprocess import meeting_of_lines

# Rows that one thread takes from top to bottom, and rows above them that its path from above
# begins at: they are the same for any number of threads.
_STRIP, _BEFORE = 80, 8
# Cost of a level of even contrast that the tones differ, for each level of restored noise, and
# the most of it: where noise is low gradients tell more, and cameras differ. What a difference
# costs at most.
_TONE_PER_LEVEL, _MOST_PER_LEVEL = 0.5, 3.0
_MOST_TONE = np.float32(300.0)
# Part of the prior of dense matching: neighbours on a path tell too.
_PRIOR = 0.35
# Cost of what the right view does not show.
_OUTSIDE = np.int32(2000)
# Disparities that are tried beyond those of the support points.
_BEYOND = 3
# Of disparity zero nothing is tried on the other side. It is not infinitely far, px.
_LEAST = 0.06
# Whether costs of a path are added to those of others.
_FIRST, _ADDED = np.int16(0), np.int16(1)
# Costs of as many disparities are one vector.
_VECTOR = 16
# More than any cost.
_BARRED = 16000
# Penalties of a step of one pixel and of a larger one: without noise, for each level of restored
# noise, and the noise beyond which they are as they are.
_STEP, _STEP_PER_LEVEL = 40.0, 7.5
_JUMP, _JUMP_PER_LEVEL = 90.0, 12.0
_MOST_NOISE = 28.0
# Sums and disparities share one integer, as energies do in dense matching.
_BITS = 11
_MASK = (1 << _BITS) - 1
_NOTHING = np.int32((1 << 30) - 1)


class Tones(NamedTuple):
    """Grey images of a pair, for the difference of their tones.

    `offset` is how much brighter the left view is where the pair matches.
    """

    left: NDArray[np.uint16]
    right: NDArray[np.uint16]
    gain: NDArray[np.float32]
    offset: float


def compare_tones(left: ContrastNormalizer, right: ContrastNormalizer, points: Points) -> Tones:
    """Return the tones of a pair, and how they differ at its support points ``(N, 3)``."""
    x, y, d = np.rint(points).astype(np.int64).T
    there = np.maximum(x - d, 0)
    difference = left.grey[y, x].astype(np.float32) - right.grey[y, there]
    offset = float(np.median(difference)) if len(difference) else 0.0
    return Tones(left.grey, right.grey, left.gain, offset)


class SemiGlobalSearch:
    """Semi-global search, with memory for the rows at work alone."""

    def __init__(
        self, shape: tuple[int, int], disparities: tuple[int, int], config: StereoConfig,
        workers: Workers,
    ) -> None:
        self._shape = shape
        self._disparities = disparities
        self._config = config
        self._workers = workers

    def search(
        self,
        descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
        tones: Tones,
        points: Points,
        noise: float,
        plane: NDArray[np.float32],
        steep: NDArray[np.bool_],
        likelihood: float,
        best: NDArray[np.int16],
        refined: NDArray[np.float32],
    ) -> None:
        """Write the best disparities of both views, `best` (2, H, W), as `DenseSearch.best`.

        Disparities are tried that lie among those of the support points `points` of the rows
        around. `noise` is the restored noise of the median pixel, in 8-bit levels of even
        contrast. `refined` (H, W) gets the left view's disparities at sub-pixel resolution, px.
        """
        reward = np.round(_PRIOR * plane_prior(self._config, likelihood)).astype(np.int16)
        level = min(noise, _MOST_NOISE)
        ranges = self._ranges(points)
        self._workers.rows(
            _search_strips, len(ranges), *descriptors, tones.left, tones.right,
            tones.gain, np.float32(tones.offset),
            np.float32(min(_TONE_PER_LEVEL * noise, _MOST_PER_LEVEL)), plane, steep, reward, ranges,
            np.int16(round(_STEP + _STEP_PER_LEVEL * level)),
            np.int16(round(_JUMP + _JUMP_PER_LEVEL * level)), *best, refined,
        )

    def _ranges(self, points: Points) -> NDArray[np.int64]:
        """Smallest and largest disparity to try in each strip of rows."""
        low, high = self._disparities
        strips = -(-self._shape[0] // _STRIP)
        ranges = np.empty((strips, 2), np.int64)
        for strip in range(strips):
            middle = (strip + 0.5) * _STRIP
            near = points[np.abs(points[:, 1] - middle) < 1.5 * _STRIP, 2]
            if not len(near):
                near = points[:, 2]
            ranges[strip] = max(near.min() - _BEYOND, low), min(near.max() + _BEYOND + 1, high)
        return ranges


@njit(nogil=True, error_model="numpy")
def _search_strips(
    start: int, stop: int, left: Any, right: Any, tone_left: Any, tone_right: Any, gain: Any,
    offset: Any, weight: Any, plane: Any, steep: Any, reward: Any, ranges: Any, step: Any,
    jump: Any, best_left: Any, best_right: Any, refined: Any,
) -> None:
    height, width = plane.shape
    most = 0
    for strip in range(start, stop):
        most = max(most, _whole_vectors(ranges[strip, 1] - ranges[strip, 0] + 1))
    cost = np.empty(width * most, np.int16)
    total = np.empty(width * most, np.int16)
    # Costs of a path, with one before the first disparity and one after the last; of the path
    # from above at each column, in the row above and in this one.
    path = np.empty(2 * (most + 2), np.int16)
    above = np.empty(2 * width * (most + 2), np.int16)
    least = np.empty(width, np.int16)
    tone = np.empty(width, np.float32)
    keys = np.empty(width + most, np.int32)
    for strip in range(start, stop):
        first = strip * _STRIP
        low = ranges[strip, 0]
        tried = ranges[strip, 1] - low + 1
        count = _whole_vectors(tried)
        wide = count + 2
        path[:] = _BARRED
        above[:] = _BARRED
        begin = max(first - _BEFORE, 0)
        # Paths begin as they go on, from costs of zero.
        least[:] = 0
        for x in range(width):
            start_of_path = ((~begin & 1) * width + x) * wide + 1
            above[start_of_path : start_of_path + count] = 0
        for y in range(begin, min(first + _STRIP, height)):
            for x in range(width):
                # From right to left, so that a pixel's candidates are one after the other.
                tone[width - 1 - x] = np.float32(tone_right[y, x]) + offset
            for x in range(width):
                at = x * count
                _compare_descriptors(
                    left, right, (y * width + x) * BYTES, low, min(x - BORDER - low + 1, tried),
                    count, cost, at)
                scale = weight * gain[y, x]
                _compare_tones(
                    np.float32(tone_left[y, x]) * scale, tone, width - 1 - x + low,
                    min(x - low + 1, tried), scale, cost, at)
                _reward_plane(plane[y, x], steep[y, x], reward, low, count, cost, at)
            now, before = (y & 1) * width, (~y & 1) * width
            for x in range(width):
                least[x] = _extend(
                    above, (before + x) * wide + 1, least[x], cost, x * count, count, step,
                    jump, above, (now + x) * wide + 1, total, _FIRST)
            if y < first:
                continue
            _add_path(cost, count, width, 1, step, jump, path, total)
            _add_path(cost, count, width, -1, step, jump, path, total)
            _select(total, count, low, tried, keys, best_left[y], best_right[y], refined[y])


@njit(nogil=True, error_model="numpy", inline="always")
def _whole_vectors(count: int) -> int:
    """Round up to whole vectors: what is left over takes as long as all of them."""
    return -(-count // _VECTOR) * _VECTOR


@njit(nogil=True, error_model="numpy")
def _compare_descriptors(
    left: Any, right: Any, here: int, low: int, visible: int, count: int, cost: Any, at: int
) -> None:
    for k in range(visible):
        difference = absolute_difference(left, here, right, here - (low + k) * BYTES)
        cost[np.uint64(at + k)] = min(difference, _OUTSIDE)
    for k in range(max(visible, 0), count):
        cost[np.uint64(at + k)] = _OUTSIDE


@njit(nogil=True, error_model="numpy")
def _compare_tones(
    here: Any, there: Any, first: int, visible: int, scale: Any, cost: Any, at: int
) -> None:
    for k in range(visible):
        difference = abs(here - scale * there[np.uint64(first + k)])
        cost[np.uint64(at + k)] += np.int16(min(difference, _MOST_TONE))


@njit(nogil=True, error_model="numpy")
def _reward_plane(
    mean: Any, steep: Any, reward: Any, low: int, count: int, cost: Any, at: int
) -> None:
    if steep or mean != mean:
        return
    radius = len(reward) - 1
    middle = index_of(mean + np.float32(0.5), -1 << 20, 1 << 20) - low
    for k in range(max(middle - radius, 0), min(middle + radius + 1, count)):
        cost[at + k] += reward[abs(k - middle)]


@njit(nogil=True, error_model="numpy")
def _extend(
    source: Any, start: int, least: Any, cost: Any, at: int, count: int, step: Any, jump: Any,
    target: Any, to: int, total: Any, keep: Any,
) -> Any:
    """Extend a path by a pixel (equation 13); return the least of its costs.

    They are added to the total, which is kept (1) or begun (0).
    """
    most = np.int16(least + jump)
    fresh = np.int16(_BARRED)
    for k in range(count):
        before = source[np.uint64(start + k - 1)]
        after = source[np.uint64(start + k + 1)]
        beside = np.int16(min(before, after) + step)
        path = min(min(source[np.uint64(start + k)], beside), most)
        i = np.uint64(at + k)
        here = np.int16(cost[i] + np.int16(path - least))
        target[np.uint64(to + k)] = here
        total[i] = np.int16(np.int16(keep * total[i]) + here)
        fresh = min(fresh, here)
    return fresh


@njit(nogil=True, error_model="numpy")
def _add_path(
    cost: Any, count: int, width: int, direction: int, step: Any, jump: Any, path: Any, total: Any
) -> None:
    """Add the costs of a path along a row, from the left (1) or from the right (-1)."""
    wide = count + 2
    path[wide + 1 : wide + 1 + count] = 0
    least = np.int16(0)
    for turn in range(width):
        x = turn if direction > 0 else width - 1 - turn
        now, before = (turn & 1) * wide + 1, (~turn & 1) * wide + 1
        least = _extend(
            path, before, least, cost, x * count, count, step, jump, path, now, total, _ADDED)


@njit(nogil=True, error_model="numpy")
def _select(
    total: Any, count: int, low: int, tried: int, keys: Any, best_left: Any, best_right: Any,
    refined: Any,
) -> None:
    """Write the best of each pixel of a row of either view."""
    width = best_left.size
    keys[:] = _NOTHING
    for x in range(width):
        visible = min(x - BORDER - low + 1, tried)
        if visible <= 0:
            best_left[x], refined[x] = -1, np.nan
            continue
        at = x * count
        k = _offer(total, at, visible, keys, width - 1 - x) & _MASK
        best_left[x] = low + k
        offset = 0.0
        if 0 < k < tried - 1:
            offset = meeting_of_lines(total[at + k - 1], total[at + k], total[at + k + 1])
        refined[x] = max(low + k + offset, _LEAST)
    for x in range(width):
        key = keys[max(width - 1 - x - low, 0)] if x + low < width else _NOTHING
        best_right[x] = np.int16(-1) if key == _NOTHING else np.int16(low + (key & _MASK))


@njit(nogil=True, error_model="numpy")
def _offer(total: Any, at: int, visible: int, keys: Any, to: int) -> Any:
    """Offer a pixel's disparities to those of the right view; return its own best."""
    best = np.int32(_NOTHING)
    for k in range(visible):
        key = np.int32((np.int32(total[np.uint64(at + k)]) << _BITS) + k)
        best = min(best, key)
        there = np.uint64(to + k)
        keys[there] = min(keys[there], key)
    return best
