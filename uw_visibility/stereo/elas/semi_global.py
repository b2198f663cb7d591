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
# Cost outside of the disparities: larger than any of a path, and within 8 bits with a step added.
_BARRED = 200
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
        np.float32(min(_TONE_PER_LEVEL * left.noise, _MOST_PER_LEVEL)), plane, steep,
        _around_plane(-reward), _around_plane(3 * reward - in_sum), ranges,
        np.uint8(round((_STEP + _STEP_PER_LEVEL * level) / _UNIT)),
        np.uint8(round((_JUMP + _JUMP_PER_LEVEL * level) / _UNIT)), *best, refined,
    )


def _around_plane(prior: NDArray[np.int16]) -> NDArray[np.uint8]:
    """Prior by distance from the plane, px, from that below it to that above, modulo 256."""
    return np.concatenate((prior[:0:-1], prior)).astype(np.uint8)


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
        # A plane of support points may be beyond the limits.
        ranges[strip] = (
            min(max(near.min() - _BEYOND, low), high), min(near.max() + _BEYOND + 1, high))
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
    radius = in_path.size // 2
    # The least cost is the largest reward by the plane; the largest leaves room for a jump.
    fewest = np.uint8(-in_path[radius])
    most = np.uint8(_MOST_PATH - jump - fewest)
    scales = np.empty(width, np.uint16)
    # Of a row: number of disparities that are outside of the right view, and place of the prior.
    hidden, place = np.empty(width, np.int64), np.empty(width, np.int64)
    for strip in range(start, stop):
        first = strip * _STRIP
        low = ranges[strip, 0]
        tried = ranges[strip, 1] - low + 1
        count = _whole_vectors(tried)
        begin, end = max(first - _BEFORE, 0), min(first + _STRIP, height)
        # Responses in coarse units. Those of the right view are from right to left, so that the
        # candidates of a pixel are contiguous.
        across = _coarse(left_across[begin : end + 2 * MARGIN], 0)
        down = _coarse(left_down[begin : end + 2 * MARGIN], 0)
        across_there = _coarse(right_across[begin : end + 2 * MARGIN, ::-1], low + count)
        down_there = _coarse(right_down[begin : end + 2 * MARGIN, ::-1], low + count)
        wide_there = wide + low + count
        cost = np.empty(width * count, np.uint8)
        total = np.empty(width * count, np.uint8)
        tone = np.zeros(width + low + count, np.uint16)
        # Costs of the paths at the last pixel, of the downward path at that of each column.
        to_right, to_left = np.empty(count, np.uint8), np.empty(count, np.uint8)
        above = np.empty(width * count, np.uint8)
        # Read from a place that depends on the pixel: disparities outside of the right view, and
        # the prior in the costs and in the sums.
        outside = np.zeros(2 * count, np.uint8)
        outside[count:] = _UNSEEN
        near_in_path = np.zeros(2 * (count + radius) + 1, np.uint8)
        near_in_sum = np.zeros(near_in_path.size, np.uint8)
        near_in_path[count : count + in_path.size] = in_path
        near_in_sum[count : count + in_path.size] = in_sum
        best = np.empty((2, width), np.int32)
        keys = np.empty(width + min(count, _PART), np.uint16)
        # Paths begin with costs of zero.
        least[:] = 0
        above[:] = 0
        for x in range(width):
            hidden[x] = count - _visible(x, width, low, tried)
        for y in range(begin, end):
            for x in range(width):
                brightness = np.float32(tone_right[y, x]) + offset
                tone[width - 1 - x] = index_of(brightness, 0, 65535)
            for x in range(width):
                # In 1/65536 of a unit of the responses.
                scales[x] = index_of(
                    weight * gain[y, x] * np.float32(65536 / _RESPONSE_UNIT), 0, 65535)
                # NaN and steep triangles have no prior.
                nowhere = low - radius - 1
                mean = nowhere if steep[y, x] else index_of(
                    plane[y, x] + np.float32(0.5), nowhere, low + count + radius)
                place[x] = count + radius + low - mean
            _compare(
                across, down, (y - begin) * wide, wide, across_there, down_there,
                (y - begin) * wide_there + wide - 1 + low, wide_there, tone_left[y], tone,
                width - 1 + low, scales, most, fewest, outside, hidden, near_in_path, place, cost,
                count)
            for x in range(width):
                least[x] = _extend(
                    above, x * count, least[x], cost, x * count, count, step, jump, near_in_sum,
                    place[x], total)
            if y < first:
                continue
            _add_paths(cost, count, width, step, jump, to_right, to_left, total)
            _select(
                total, count, low, outside, hidden, best, keys, best_left[y], best_right[y],
                refined[y])


@njit(nogil=True, error_model="numpy", inline="always")
def _visible(x: int, width: int, low: int, tried: int) -> int:
    """Number of disparities at a column whose pixels are within the border of both views."""
    return min(max(x - BORDER - low + 1, 0), tried) if x < width - BORDER else 0


@njit(nogil=True, error_model="numpy", inline="always")
def _whole_vectors(count: int) -> int:
    """Round up to whole vectors: a scalar remainder would take as long as all of them."""
    return -(-count // LANES) * LANES


@njit(nogil=True, error_model="numpy")
def _coarse(responses: Any, more: int) -> Any:
    """Responses in units of `_RESPONSE_UNIT` (H, W + more), as one row."""
    height, width = responses.shape
    coarse = np.zeros((height, width + more), np.uint8)
    for y in range(height):
        for x in range(width):
            coarse[y, x] = (responses[y, x] + _RESPONSE_UNIT // 2) // _RESPONSE_UNIT
    return coarse.reshape(-1)


@intrinsic
def _compare(
    typingctx: Any, across: Any, down: Any, at: Any, wide: Any, across_there: Any,
    down_there: Any, at_there: Any, wide_there: Any, tone: Any, tone_there: Any,
    first_tone_there: Any, scale: Any, most: Any, least: Any, outside: Any, hidden: Any,
    near: Any, place: Any, cost: Any, count: Any,
) -> Any:
    """Write the costs of a row's pixels at each disparity: differences of responses and of tones.

    The responses are those that `descriptors` gathers, in `_ROWS` rows from `at` on: eleven
    horizontal ones, `across`, and five vertical ones, `down`; sums down a descriptor's columns are
    reused. `scale` of differences of tone is in 1/65536. The costs are from `least` to
    `least + most`, which is that of disparities `outside` of the right view, and have the prior
    added, which is `near` from the index `place` on. Arrays are 1-D, of uint8; of uint16 the tones
    and their scale.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> None:
        v = Vectors(context, builder)
        (across, down, at, wide, across_there, down_there, at_there, wide_there, tone, tone_there,
         first_tone_there, scale, most, least, outside, hidden, near, place, cost, count) = (
            v.operands(signature, arguments))
        add, index = builder.add, wide.type
        most, least = v.filled(most), v.filled(least)
        margin = ir.Constant(index, 2 * MARGIN)

        def of(array: Any, i: Any) -> Any:
            return builder.load(builder.gep(array, [i]))

        with v.loop(count) as k:
            # Sums of the last four descriptors, without their columns to come.
            parts = [v.variable(v.constant(0, 8)) for _ in range(2 * MARGIN)]

            def complete(column: Any, k: Any = k, parts: Any = parts) -> Any:
                """Add a column to all descriptors that contain it, and return the completed."""

                def difference(here: Any, there: Any, row: int) -> Any:
                    i = add(add(at, column), builder.mul(wide, ir.Constant(index, row)))
                    j = builder.sub(at_there, column)
                    j = add(add(j, k), builder.mul(wide_there, ir.Constant(index, row)))
                    apart = v.apart(v.filled(of(here, i)), v.load(there, j))
                    return v.smaller(apart, v.constant(_MOST_RESPONSE, 8))

                a = [difference(across, across_there, row) for row in range(_ROWS)]
                d = [difference(down, down_there, row) for row in (1, 2, 3)]
                # Sums down the first or last, second or fourth, and third column of a descriptor.
                outer = a[2]
                inner = add(add(outer, a[1]), d[1])
                middle = add(add(add(inner, a[0]), add(a[3], a[4])), add(d[0], d[2]))
                before = [builder.load(part) for part in parts]
                after = (outer, add(before[0], inner), add(before[1], middle),
                         add(before[2], inner))
                for part, value in zip(parts, after, strict=True):
                    builder.store(value, part)
                return add(before[3], outer)

            with v.loop(margin, 1) as column:
                complete(column)
            with v.loop(builder.sub(wide, margin), 1) as x:
                responses = complete(add(x, margin))
                i = add(builder.sub(first_tone_there, x), k)
                apart = v.apart(v.filled(of(tone, x)), v.load(tone_there, i))
                factor = v.with_bits(v.filled(of(scale, x)), 32)
                scaled = builder.lshr(
                    builder.mul(v.with_bits(apart, 32), factor), v.constant(16, 32))
                tones = v.smaller(v.with_bits(scaled, 16), v.constant(_MOST_TONE, 16))
                total = add(v.with_bits(responses, 16), tones)
                total = builder.udiv(
                    add(total, v.constant(_RESPONSES // 2, 16)), v.constant(_RESPONSES, 16))
                unseen = v.load(outside, add(of(hidden, x), k))
                limited = v.smaller(builder.or_(v.with_bits(total, 8), unseen), most)
                prior = v.load(near, add(of(place, x), k))
                v.store(add(add(limited, least), prior), cost, add(builder.mul(x, count), k))

    byte, i = types.uint8, types.intp
    return types.void(
        across, down, i, i, across_there, down_there, i, i, tone, tone_there, i, scale, byte, byte,
        outside, hidden, near, place, cost, i), codegen


@intrinsic
def _extend(
    typingctx: Any, path: Any, start: Any, least: Any, cost: Any, at: Any, count: Any, step: Any,
    jump: Any, added: Any, place: Any, total: Any,
) -> Any:
    """Extend a path by a pixel (Hirschmüller 2008, equation 13); return the least of its costs.

    `total` becomes the sum of `added` and the costs. Arrays are 1-D uint8, and `count` is whole
    vectors, one at least.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        v = Vectors(context, builder)
        path, start, least, cost, at, count, step, jump, added, place, total = v.operands(
            signature, arguments)
        lanes = ir.Constant(start.type, LANES)
        most = v.filled(builder.add(least, jump))
        step, least = v.filled(step), v.filled(least)
        barred = v.constant(_BARRED, 8)
        fresh, before = v.variable(v.constant(255, 8)), v.variable(barred)
        middle = v.variable(v.load(path, start))

        def extend(k: Any, after: Any) -> None:
            own = builder.load(middle)
            beside = v.smaller(
                v.shifted(builder.load(before), own, LANES - 1), v.shifted(own, after, 1))
            lowest = v.smaller(v.smaller(own, builder.add(beside, step)), most)
            i = builder.add(at, k)
            here = builder.add(v.load(cost, i), builder.sub(lowest, least))
            v.store(here, path, builder.add(start, k))
            v.store(builder.add(v.load(added, builder.add(place, k)), here), total, i)
            builder.store(v.smaller(builder.load(fresh), here), fresh)
            builder.store(own, before)
            builder.store(after, middle)

        last = builder.sub(count, lanes)
        with v.loop(last) as k:
            extend(k, v.load(path, builder.add(builder.add(start, k), lanes)))
        extend(last, barred)
        return v.smallest(builder.load(fresh))

    value, i = types.uint8, types.intp
    return value(path, i, value, cost, i, i, value, value, added, i, total), codegen


@njit(nogil=True, error_model="numpy")
def _add_paths(
    cost: Any, count: int, width: int, step: Any, jump: Any, right: Any, left: Any, total: Any
) -> None:
    """Add the costs of the paths along a row, to the right and to the left.

    The two alternate, so that the processor need not wait for the result of either.
    """
    right[:] = 0
    left[:] = 0
    least_right = least_left = np.uint8(0)
    for x in range(width):
        at, other = x * count, (width - 1 - x) * count
        least_right = _extend(
            right, 0, least_right, cost, at, count, step, jump, total, at, total)
        least_left = _extend(
            left, 0, least_left, cost, other, count, step, jump, total, other, total)


@njit(nogil=True, error_model="numpy")
def _select(
    total: Any, count: int, low: int, outside: Any, hidden: Any, best: Any, keys: Any,
    best_left: Any, best_right: Any, refined: Any,
) -> None:
    """Write the best disparity of each pixel of a row, for both views.

    A key holds sum and disparity, so that the best disparity is found by one minimum; of equal sums
    the smaller disparity is kept.
    """
    width = best_left.size
    best[:] = dense.NOTHING
    for first in range(0, count, _PART):
        keys[:] = _NO_KEY
        for x in range(width):
            key = _offer(
                total, x * count + first, outside, hidden[x] + first,
                min(count - first, _PART), keys, width - 1 - x)
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
        if best_left[x] >= 0 and 0 < k < count - hidden[x] - 1:
            at = x * count + k
            offset = meeting_of_lines(
                np.int32(total[at - 1]), np.int32(total[at]), np.int32(total[at + 1]))
        refined[x] = max(best_left[x] + offset, _LEAST) if best_left[x] >= 0 else np.nan


@intrinsic
def _offer(
    typingctx: Any, total: Any, at: Any, outside: Any, hidden: Any, count: Any, keys: Any, to: Any
) -> Any:
    """Update the best keys of the right view with a pixel's; return the pixel's own best key.

    `total` is 1-D uint8, `keys` 1-D uint16.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        v = Vectors(context, builder)
        total, at, outside, hidden, count, keys, to = v.operands(signature, arguments)
        best = v.variable(v.constant(int(_NO_KEY), 16))
        numbers = v.constant(list(range(LANES)), 16)
        with v.loop(count) as k:
            unseen = v.load(outside, builder.add(hidden, k))
            sums = v.with_bits(builder.or_(v.load(total, builder.add(at, k)), unseen), 16)
            first = v.filled(builder.trunc(k, ir.IntType(16)))
            key = builder.add(
                builder.shl(sums, v.constant(8, 16)), builder.add(first, numbers))
            there = builder.add(to, k)
            v.store(v.smaller(v.load(keys, there), key), keys, there)
            builder.store(v.smaller(builder.load(best), key), best)
        return v.smallest(builder.load(best))

    i = types.intp
    return types.uint16(total, i, outside, i, i, keys, i), codegen


@njit(nogil=True, error_model="numpy", inline="always")
def _whole_key(key: Any, first: int) -> Any:
    """Key of 32 bits from one of 16 bits, whose disparities count from `first`."""
    if key >> 8 == _UNSEEN:
        return dense.NOTHING
    return np.int32(((key >> 8) << dense.DISPARITY_BITS) + (key & 255) + first)
