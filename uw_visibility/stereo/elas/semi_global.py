# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dense matching in noise: semi-global, along three paths, with the mesh's plane as a prior.

Where noise hides texture, single descriptors are ambiguous, and costs are summed along paths:
semi-global matching (Hirschmüller 2008, doi:10.1109/TPAMI.2007.1166) to the right, to the left and
downwards, which needs memory for a few rows only. A cost is the difference of the descriptors, plus
that of the tones, which gradients do not contain, plus the prior of `dense`, weakened. Costs have 8
bits, so that a vector register holds many, and sums that neighbouring descriptors share are reused.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.numba_import import intrinsic, ir, types
from uw_visibility.compute.threads import Workers
from uw_visibility.compute.vectors import LANES, Vectors
from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.arrays import Points
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas import dense
from uw_visibility.stereo.elas.dense import BORDER, disparity_of, meeting_of_lines, plane_prior
from uw_visibility.stereo.elas.descriptors import MARGIN, Descriptors

# Rows of a strip, which one thread matches, and number of rows above it at which its downward path
# begins. Strips do not depend on the number of threads, so that disparities do not either.
_STRIP, _BEFORE = 80, 8
# Rows of a descriptor's window.
_ROWS = 2 * MARGIN + 1
# Unit of a difference of responses, in levels of the responses, and the largest difference, in
# units, which limits the cost of an edge that only one view shows.
_RESPONSE_UNIT, _MOST_RESPONSE = 4, 15
# Unit of cost, in levels of the difference of descriptors (16 responses).
_UNIT = 16
_RESPONSES = _UNIT // _RESPONSE_UNIT
# Largest cost of a path: the sum of three, plus up to 2 for the prior's rounding, is below 255, the
# sum that stands for disparities outside of the right view.
_MOST_PATH = 252 // 3
_UNSEEN = np.uint8(255)
# Cost of a difference of tone by one level of normalised contrast: per level of restored noise, and
# the largest. In low noise gradients are more reliable, since the tones of two cameras differ.
# Largest cost of a difference of tone, in units of the responses.
_TONE_PER_LEVEL, _MOST_PER_LEVEL = 0.5, 3.0
_MOST_TONE = 300 // _RESPONSE_UNIT
# Factor on the prior of `dense`, lower since paths also use the neighbours, and the largest prior,
# in units of cost, so that most of a cost comes from the images.
_PRIOR = 0.35
_MOST_PRIOR = 20
# Disparities that are tried beyond the range of the support points, px.
_BEYOND = 3
# Least refined disparity, px: disparity 0 has no lower neighbour for the refinement, but it is not
# infinitely far.
_LEAST = 0.06
# Masks on the sum of the paths: the first path overwrites it, further paths are added.
_FIRST, _ADDED = np.uint8(0), np.uint8(255)
# Cost outside of the disparities: larger than any of a path, and within 8 bits with a step added.
_BARRED = np.uint8(200)
# Penalties of a disparity step of one pixel (P1) and of a larger one (P2): without noise, and per
# level of restored noise; the most levels that count.
_STEP, _STEP_PER_LEVEL = 40.0, 7.5
_JUMP, _JUMP_PER_LEVEL = 90.0, 12.0
_MOST_NOISE = 28.0
# Keys hold a sum and a disparity: those of `dense` for all disparities, of 16 bits for a part of
# `_PART` disparities.
_PART, _NO_KEY = 256, np.uint16(65535)


def search(
    config: StereoConfig, disparities: tuple[int, int], left: ContrastNormalizer,
    right: ContrastNormalizer, descriptors: tuple[Descriptors, Descriptors], points: Points,
    plane: NDArray[np.float32], steep: NDArray[np.bool_], best: NDArray[np.int16],
    refined: NDArray[np.float32], workers: Workers,
) -> None:
    """Write the best disparities of both views to `best` (2, H, W); see `DenseSearch.best`.

    The search covers the disparities of the support points `points` in the rows around, within the
    limits `disparities`, px. `refined` (H, W) gets the left view's disparities at sub-pixel
    resolution, px.
    """
    prior = np.minimum(-_PRIOR / _UNIT * plane_prior(config), _MOST_PRIOR)
    # The prior is rounded in the sum of three paths: each path has it rounded up, and what is too
    # much is taken back in the sum.
    in_sum = np.round(3 * prior).astype(np.int16)
    reward = -(-in_sum // 3)
    level = min(left.noise, _MOST_NOISE)
    ranges = _ranges(points, disparities, len(plane))
    of_left, of_right = descriptors
    workers.rows(
        _search_strips, len(ranges), of_left.horizontal, of_left.vertical, of_right.horizontal,
        of_right.vertical, left.grey, right.grey, left.gain, _tone_offset(left, right, points),
        np.float32(min(_TONE_PER_LEVEL * left.noise, _MOST_PER_LEVEL)), plane, steep, -reward,
        3 * reward - in_sum, ranges, np.uint8(round((_STEP + _STEP_PER_LEVEL * level) / _UNIT)),
        np.uint8(round((_JUMP + _JUMP_PER_LEVEL * level) / _UNIT)), *best, refined,
    )


def _tone_offset(left: ContrastNormalizer, right: ContrastNormalizer, points: Points) -> np.float32:
    """Median of left minus right tone at the support points ``(N, 3)``; 0 without any."""
    x, y, d = np.rint(points).astype(np.int64).T
    there = np.maximum(x - d, 0)
    difference = left.grey[y, x].astype(np.float32) - right.grey[y, there]
    return np.float32(np.median(difference)) if len(difference) else np.float32(0)


def _ranges(points: Points, disparities: tuple[int, int], height: int) -> NDArray[np.int64]:
    """Smallest and largest disparity to try in each strip of rows."""
    low, high = disparities
    ranges = np.empty((-(-height // _STRIP), 2), np.int64)
    for strip in range(len(ranges)):
        middle = (strip + 0.5) * _STRIP
        near = points[np.abs(points[:, 1] - middle) < 1.5 * _STRIP, 2]
        if not len(near):
            near = points[:, 2]
        ranges[strip] = max(near.min() - _BEYOND, low), min(near.max() + _BEYOND + 1, high)
    return ranges


@njit(nogil=True, error_model="numpy")
def _search_strips(
    start: int, stop: int, left_across: Any, left_down: Any, right_across: Any, right_down: Any,
    tone_left: Any, tone_right: Any, gain: Any, offset: Any, weight: Any, plane: Any, steep: Any,
    in_path: Any, in_sum: Any, ranges: Any, step: Any, jump: Any, best_left: Any, best_right: Any,
    refined: Any,
) -> None:
    height, width = plane.shape
    wide = width + 2 * MARGIN
    least = np.empty(width, np.uint8)
    # The least cost is the largest reward by the plane; the largest leaves room for a jump.
    fewest = np.uint8(-in_path[0])
    most = np.uint16(_MOST_PATH - jump - fewest)
    outside = np.uint8(most + fewest)
    for strip in range(start, stop):
        first = strip * _STRIP
        low = ranges[strip, 0]
        tried = ranges[strip, 1] - low + 1
        count = _whole_vectors(tried)
        # Differences of the responses in five rows, by column and disparity.
        across = np.empty((_ROWS, wide * count), np.uint8)
        down = np.empty((_ROWS, wide * count), np.uint8)
        inner, middle = np.empty(wide * count, np.uint8), np.empty(wide * count, np.uint8)
        cost = np.empty(width * count, np.uint8)
        total = np.empty(width * count, np.uint8)
        # The right view from right to left, so that a pixel's candidates are contiguous.
        mirrored = np.zeros(wide + low + count, np.uint8)
        tone = np.zeros(width + low + count, np.uint16)
        # Costs of a path at the pixel before and at this one, each with an entry before the first
        # disparity and one after the last; the downward path has them for each column.
        to_right = np.full(2 * (count + 2), _BARRED, np.uint8)
        to_left = np.full(2 * (count + 2), _BARRED, np.uint8)
        above = np.full(2 * width * (count + 2), _BARRED, np.uint8)
        best = np.empty((2, width), np.int32)
        keys = np.empty(width + min(count, _PART), np.uint16)
        begin = max(first - _BEFORE, 0)
        # Paths begin with costs of zero.
        least[:] = 0
        for x in range(width):
            start_of_path = ((~begin & 1) * width + x) * (count + 2) + 1
            above[start_of_path : start_of_path + count] = 0
        for row in range(begin, min(first + _STRIP, height) + 2 * MARGIN):
            at = row % _ROWS
            _compare_rows(left_across[row], right_across[row], low, count, mirrored, across[at])
            _compare_rows(left_down[row], right_down[row], low, count, mirrored, down[at])
            # The responses begin two rows above the image, and descriptors reach two rows down.
            y = row - 2 * MARGIN
            if y < begin:
                continue
            _add_rows(across, down, y, inner, middle)
            outer = across[(y + 2) % _ROWS]
            _add_five(
                outer, inner[count:], middle[2 * count :], inner[3 * count :], outer[4 * count :],
                cost)
            for x in range(width):
                brightness = np.float32(tone_right[y, x]) + offset
                tone[width - 1 - x] = index_of(brightness, 0, 65535)
            for x in range(width):
                # In 1/65536 of a unit of the responses.
                scale = index_of(
                    weight * gain[y, x] * np.float32(65536 / _RESPONSE_UNIT), 0, 65535)
                at = x * count
                _add_tones(
                    tone_left[y, x], tone, width - 1 - x + low, count, np.uint16(scale),
                    most, fewest, cost, at)
                visible = _visible(x, width, low, tried)
                for k in range(at + visible, at + count):
                    cost[np.uint64(k)] = outside
                _add_near_plane(plane[y, x], steep[y, x], in_path, low, count, cost, at)
            now, before = (y & 1) * width, (~y & 1) * width
            for x in range(width):
                least[x] = _extend(
                    above, (before + x) * (count + 2) + 1, least[x], cost, x * count, count, step,
                    jump, above, (now + x) * (count + 2) + 1, total, _FIRST)
            if y < first:
                continue
            _add_paths(cost, count, width, step, jump, to_right, to_left, total)
            for x in range(width):
                _add_near_plane(plane[y, x], steep[y, x], in_sum, low, count, total, x * count)
            _select(
                total, count, low, tried, best, keys, best_left[y], best_right[y], refined[y])


@njit(nogil=True, error_model="numpy", inline="always")
def _visible(x: int, width: int, low: int, tried: int) -> int:
    """Number of disparities at a column whose pixels are within the border of both views."""
    return min(max(x - BORDER - low + 1, 0), tried) if x < width - BORDER else 0


@njit(nogil=True, error_model="numpy", inline="always")
def _whole_vectors(count: int) -> int:
    """Round up to whole vectors: a scalar remainder would take as long as all of them."""
    return -(-count // LANES) * LANES


@njit(nogil=True, error_model="numpy")
def _compare_rows(
    left: Any, right: Any, low: int, count: int, mirrored: Any, difference: Any
) -> None:
    """Compare each response of a row with those of the right view at each disparity."""
    width = left.size
    for x in range(width):
        mirrored[width - 1 - x] = (right[x] + _RESPONSE_UNIT // 2) // _RESPONSE_UNIT
    for x in range(width):
        here = np.uint8((left[x] + _RESPONSE_UNIT // 2) // _RESPONSE_UNIT)
        _compare_responses(here, mirrored, width - 1 - x + low, count, difference, x * count)


@intrinsic
def _compare_responses(
    typingctx: Any, here: Any, there: Any, first: Any, count: Any, difference: Any, at: Any
) -> Any:
    """Compare a response with those of the right view at each disparity; arrays are 1-D uint8."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> None:
        v = Vectors(context, builder)
        here, there, first, count, difference, at = v.operands(signature, arguments)
        here, most = v.filled(here), v.constant(_MOST_RESPONSE, 8)
        with v.loop(count) as k:
            apart = v.apart(here, v.load(there, builder.add(first, k)))
            v.store(v.smaller(apart, most), difference, builder.add(at, k))

    i = types.intp
    return types.void(types.uint8, there, i, i, difference, i), codegen


@njit(nogil=True, error_model="numpy")
def _add_rows(across: Any, down: Any, y: int, inner: Any, middle: Any) -> None:
    """Sum differences down the second or fourth column of a descriptor, and down its third.

    The responses are those that `descriptors` gathers: eleven horizontal, five vertical.
    """
    first, second, third, fourth, fifth = (
        y % _ROWS, (y + 1) % _ROWS, (y + 2) % _ROWS, (y + 3) % _ROWS, (y + 4) % _ROWS)
    _add_three(across[second], across[third], down[third], inner)
    _add_six(
        inner, across[first], across[fourth], across[fifth], down[second], down[fourth], middle)


@njit(nogil=True, error_model="numpy")
def _add_three(a: Any, b: Any, c: Any, total: Any) -> None:
    for i in range(total.size):
        total[i] = np.uint8(a[i] + b[i] + c[i])


@njit(nogil=True, error_model="numpy")
def _add_six(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, total: Any) -> None:
    for i in range(total.size):
        total[i] = np.uint8(a[i] + b[i] + c[i] + d[i] + e[i] + f[i])


@njit(nogil=True, error_model="numpy")
def _add_five(a: Any, b: Any, c: Any, d: Any, e: Any, total: Any) -> None:
    for i in range(total.size):
        total[i] = np.uint8(a[i] + b[i] + c[i] + d[i] + e[i])


@intrinsic
def _add_tones(
    typingctx: Any, here: Any, there: Any, first: Any, count: Any, scale: Any, most: Any,
    least: Any, cost: Any, at: Any,
) -> Any:
    """Add differences of tone to those of the responses, and turn the sums into costs.

    The costs (1-D uint8) are from `least` to `least + most`. Tones are uint16, those of the right
    view 1-D; `scale` is in 1/65536.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> None:
        v = Vectors(context, builder)
        here, there, first, count, scale, most, least, cost, at = v.operands(signature, arguments)
        here, most, least = v.filled(here), v.filled(most), v.filled(least)
        scale = v.with_bits(v.filled(scale), 32)
        with v.loop(count) as k:
            apart = v.apart(here, v.load(there, builder.add(first, k)))
            scaled = builder.mul(v.with_bits(apart, 32), scale)
            tone = v.with_bits(builder.lshr(scaled, v.constant(16, 32)), 16)
            i = builder.add(at, k)
            responses = builder.add(
                v.with_bits(v.load(cost, i), 16), v.smaller(tone, v.constant(_MOST_TONE, 16)))
            responses = builder.udiv(
                builder.add(responses, v.constant(_RESPONSES // 2, 16)),
                v.constant(_RESPONSES, 16))
            v.store(
                builder.add(v.with_bits(v.smaller(responses, most), 8), least), cost, i)

    short, byte, i = types.uint16, types.uint8, types.intp
    return types.void(short, there, i, i, short, short, byte, cost, i), codegen


@njit(nogil=True, error_model="numpy")
def _add_near_plane(
    mean: Any, steep: Any, prior: Any, low: int, count: int, cost: Any, at: int
) -> None:
    """Add the prior of the mesh's plane."""
    if steep or mean != mean:
        return
    radius = len(prior) - 1
    middle = index_of(mean + np.float32(0.5), -1 << 20, 1 << 20) - low
    for k in range(max(middle - radius, 0), min(middle + radius + 1, count)):
        i = np.uint64(at + k)
        cost[i] = np.uint8(cost[i] + prior[np.uint64(abs(k - middle))])


@intrinsic
def _extend(
    typingctx: Any, source: Any, start: Any, least: Any, cost: Any, at: Any, count: Any, step: Any,
    jump: Any, target: Any, to: Any, total: Any, keep: Any,
) -> Any:
    """Extend a path by a pixel (Hirschmüller 2008, equation 13); return the least of its costs.

    They are added to `total & keep`. Arrays are 1-D uint8, and `count` is whole vectors.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        v = Vectors(context, builder)
        source, start, least, cost, at, count, step, jump, target, to, total, keep = v.operands(
            signature, arguments)
        one = ir.Constant(start.type, 1)
        most = v.filled(builder.add(least, jump))
        step, least, keep = v.filled(step), v.filled(least), v.filled(keep)
        fresh = v.variable(v.constant(255, 8))
        with v.loop(count) as k:
            from_k, i = builder.add(start, k), builder.add(at, k)
            beside = v.smaller(
                v.load(source, builder.sub(from_k, one)), v.load(source, builder.add(from_k, one)))
            path = v.smaller(v.load(source, from_k), builder.add(beside, step))
            path = v.smaller(path, most)
            here = builder.add(v.load(cost, i), builder.sub(path, least))
            v.store(here, target, builder.add(to, k))
            kept = builder.and_(v.load(total, i), keep)
            v.store(builder.add(kept, here), total, i)
            builder.store(v.smaller(builder.load(fresh), here), fresh)
        return v.smallest(builder.load(fresh))

    value, i = types.uint8, types.intp
    return value(source, i, value, cost, i, i, value, value, target, i, total, value), codegen


@njit(nogil=True, error_model="numpy")
def _add_paths(
    cost: Any, count: int, width: int, step: Any, jump: Any, right: Any, left: Any, total: Any
) -> None:
    """Add the costs of the paths along a row, to the right and to the left.

    The two alternate, so that the processor need not wait for the result of either.
    """
    wide = count + 2
    for path in (right, left):
        path[wide + 1 : wide + 1 + count] = 0
    least_right = least_left = np.uint8(0)
    for x in range(width):
        now, before = (x & 1) * wide + 1, (~x & 1) * wide + 1
        least_right = _extend(
            right, before, least_right, cost, x * count, count, step, jump, right, now, total,
            _ADDED)
        least_left = _extend(
            left, before, least_left, cost, (width - 1 - x) * count, count, step, jump, left, now,
            total, _ADDED)


@njit(nogil=True, error_model="numpy")
def _select(
    total: Any, count: int, low: int, tried: int, best: Any, keys: Any, best_left: Any,
    best_right: Any, refined: Any,
) -> None:
    """Write the best disparity of each pixel of a row, for both views.

    A key holds sum and disparity, so that the best disparity is found by one minimum; of equal sums
    the smaller disparity is kept.
    """
    width = best_left.size
    for x in range(width):
        visible = _visible(x, width, low, tried)
        for k in range(x * count + visible, (x + 1) * count):
            total[np.uint64(k)] = _UNSEEN
    best[:] = dense.NOTHING
    for first in range(0, count, _PART):
        keys[:] = _NO_KEY
        for x in range(width):
            key = _offer(
                total, x * count + first, min(count - first, _PART), keys, width - 1 - x)
            best[0, x] = min(best[0, x], _whole_key(key, first))
        for x in range(width - low - first):
            key = keys[width - 1 - x - low - first]
            best[1, x] = min(best[1, x], _whole_key(key, first))
    for x in range(width):
        best_left[x] = disparity_of(best[0, x], low)
        best_right[x] = disparity_of(best[1, x], low)
        k = best[0, x] & dense.DISPARITY_MASK
        offset = 0.0
        # The first and the last disparity of a column have one neighbour only.
        if best_left[x] >= 0 and 0 < k < _visible(x, width, low, tried) - 1:
            at = x * count + k
            offset = meeting_of_lines(
                np.int32(total[at - 1]), np.int32(total[at]), np.int32(total[at + 1]))
        refined[x] = max(best_left[x] + offset, _LEAST) if best_left[x] >= 0 else np.nan


@intrinsic
def _offer(typingctx: Any, total: Any, at: Any, count: Any, keys: Any, to: Any) -> Any:
    """Update the best keys of the right view with a pixel's; return the pixel's own best key.

    `total` is 1-D uint8, `keys` 1-D uint16.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        v = Vectors(context, builder)
        total, at, count, keys, to = v.operands(signature, arguments)
        best = v.variable(v.constant(int(_NO_KEY), 16))
        numbers = v.constant(list(range(LANES)), 16)
        with v.loop(count) as k:
            sums = v.with_bits(v.load(total, builder.add(at, k)), 16)
            first = v.filled(builder.trunc(k, ir.IntType(16)))
            key = builder.add(
                builder.shl(sums, v.constant(8, 16)), builder.add(first, numbers))
            there = builder.add(to, k)
            v.store(v.smaller(v.load(keys, there), key), keys, there)
            builder.store(v.smaller(builder.load(best), key), best)
        return v.smallest(builder.load(best))

    i = types.intp
    return types.uint16(total, i, i, keys, i), codegen


@njit(nogil=True, error_model="numpy", inline="always")
def _whole_key(key: Any, first: int) -> Any:
    """Key of 32 bits from one of 16 bits, whose disparities count from `first`."""
    if key >> 8 == _UNSEEN:
        return dense.NOTHING
    return np.int32(((key >> 8) << dense.DISPARITY_BITS) + (key & 255) + first)
