# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Edge-aware disparity filter: neighbours of similar tone vote.

Descriptors overlap depth edges, so that the nearer surface grows by a few pixels. Near an edge each
pixel is assigned to that of the two surfaces whose pixels are more similar to it: a weighted mode
filter (Min, Lu and Do, doi 10.1109/TIP.2011.2163164) of two modes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.stereo.contrast import ContrastNormalizer

# Distance of the voters, px, and their number to each side: five by five in all.
STRIDE = 3
_STEPS = 2
MARGIN = STRIDE * _STEPS
# Least range of the disparities around a pixel at an edge, px, and least change of a disparity
# that moves to the other side, px.
_EDGE = np.float32(2.0)
_CHANGE = np.float32(1.5)
# Difference of tone at which a vote counts half, 8-bit levels of normalised contrast.
_ALIKE = 17.0


def move_edges(
    disparity: DisparityMap, image: ContrastNormalizer, workers: Workers, *, drop: bool = False
) -> None:
    """Move the edges of a map ``(H, W)`` float32, px, to those of the image, in place.

    NaN stays NaN; with `drop`, pixels on the wrong side of an edge are set to NaN instead.
    """
    workers.rows(
        _vote, disparity.shape[0], image.grey, image.gain, disparity.copy(), not drop, disparity)


@njit(nogil=True, error_model="numpy")
def range_around(before: Any, y: int, low: Any, high: Any, far: Any, near: Any) -> None:
    """Write the least and the largest disparity of the voters around each pixel of a row.

    ``low`` and ``high`` extend `MARGIN` columns beyond the row, where they are inf and -inf.
    """
    height, width = before.shape
    inner = slice(MARGIN, MARGIN + width)
    a, b = before[max(y - MARGIN, 0)], before[max(y - STRIDE, 0)]
    c, d = before[y], before[min(y + STRIDE, height - 1)]
    e = before[min(y + MARGIN, height - 1)]
    _least(a, b, c, d, e, np.float32(np.inf), low[inner])
    _largest(a, b, c, d, e, np.float32(-np.inf), high[inner])
    i, j, k, m = STRIDE, 2 * STRIDE, 3 * STRIDE, 4 * STRIDE
    _least(low, low[i:], low[j:], low[k:], low[m:], np.float32(np.inf), far)
    _largest(high, high[i:], high[j:], high[k:], high[m:], np.float32(-np.inf), near)


@njit(nogil=True, error_model="numpy")
def _least(a: Any, b: Any, c: Any, d: Any, e: Any, most: Any, out: Any) -> None:
    """Write the least of five rows, without NaN; all rows in one loop, for vector code."""
    for x in range(out.size):
        m = a[x] if a[x] < most else most
        m = b[x] if b[x] < m else m
        m = c[x] if c[x] < m else m
        m = d[x] if d[x] < m else m
        out[x] = e[x] if e[x] < m else m


@njit(nogil=True, error_model="numpy")
def _largest(a: Any, b: Any, c: Any, d: Any, e: Any, least: Any, out: Any) -> None:
    for x in range(out.size):
        m = a[x] if a[x] > least else least
        m = b[x] if b[x] > m else m
        m = c[x] if c[x] > m else m
        m = d[x] if d[x] > m else m
        out[x] = e[x] if e[x] > m else m


@njit(nogil=True, error_model="numpy")
def _add_votes(
    first: int, last: int, shift: int, tone: Any, scale: Any, middle: Any, voter_tone: Any,
    voter: Any, closeness: Any, balance: Any
) -> None:
    """Add one voter of each pixel: the balance grows for the near side, falls for the far one."""
    zero = np.float32(0)
    for x in range(first, last):
        at, other = np.uint64(x), np.uint64(x + shift)
        weight = closeness * alike((tone[at] - voter_tone[other]) * scale[at])
        d = voter[other]
        vote = weight if d > middle[at] else -weight
        balance[at] += vote if d == d else zero


@njit(nogil=True, error_model="numpy", inline="always")
def alike(difference: Any) -> Any:
    square = difference * difference
    return np.float32(1) / (np.float32(1) + square * square)


@njit(nogil=True, error_model="numpy")
def _vote(
    start: int, stop: int, grey: Any, gain: Any, before: Any, replace: bool, after: Any
) -> None:
    height, width = before.shape
    low = np.full(width + 2 * MARGIN, np.inf, np.float32)
    high = np.full(width + 2 * MARGIN, -np.inf, np.float32)
    far, near = np.empty(width, np.float32), np.empty(width, np.float32)
    middle, scale = np.empty(width, np.float32), np.empty(width, np.float32)
    balance = np.empty(width, np.float32)
    other_side = np.empty(width, np.bool_)
    tones = np.empty((2 * _STEPS + 1, width), np.float32)
    for y in range(start, stop):
        range_around(before, y, low, high, far, near)
        _start_balance(far, near, gain[y], middle, scale, balance)
        for j in range(2 * _STEPS + 1):
            _as_float(grey[min(max(y + (j - _STEPS) * STRIDE, 0), height - 1)], tones[j])
        first, last = _span_of_edges(near, far)
        tone = tones[_STEPS]
        for j in range(-_STEPS, _STEPS + 1):
            voters = before[min(max(y + j * STRIDE, 0), height - 1)]
            voter_tones = tones[j + _STEPS]
            for i in range(-_STEPS, _STEPS + 1):
                # Every other voter is enough to drop a match.
                if not replace and (i + j) % 2 != 0:
                    continue
                shift = i * STRIDE
                a, b = max(first, -shift), min(last, width - shift)
                if a >= b:
                    continue
                _add_votes(
                    a, b, shift, tone, scale, middle, voter_tones, voters,
                    np.float32(_STEPS**2 / (_STEPS**2 + i * i + j * j)), balance,
                )
        _compare_sides(near, far, middle, balance, before[y], other_side)
        if not replace:
            _clear(other_side, after[y])
            continue
        for x in range(first, last):
            if other_side[x]:
                d = before[y, x]
                other = _mean_of_side(tones, scale[x], before, y, x, middle[x], balance[x] > 0)
                after[y, x] = other if abs(other - d) > _CHANGE else d


@njit(nogil=True, error_model="numpy")
def _start_balance(
    far: Any, near: Any, gain: Any, middle: Any, scale: Any, balance: Any
) -> None:
    for x in range(far.size):
        middle[x] = np.float32(0.5) * (far[x] + near[x])
        scale[x] = gain[x] * np.float32(1.0 / _ALIKE)
        balance[x] = 0


@njit(nogil=True, error_model="numpy")
def _as_float(source: Any, out: Any) -> None:
    for x in range(source.size):
        out[x] = np.float32(source[x])


@njit(nogil=True, error_model="numpy")
def _compare_sides(
    near: Any, far: Any, middle: Any, balance: Any, row: Any, other_side: Any
) -> None:
    """Mark the pixels of a row at edges that the votes assign to the other side."""
    for x in range(row.size):
        d = row[x]
        other = (balance[x] > 0) ^ (d > middle[x])
        other_side[x] = (near[x] - far[x] >= _EDGE) & (d == d) & other


@njit(nogil=True, error_model="numpy")
def _clear(unsure: Any, row: Any) -> None:
    for x in range(row.size):
        row[x] = np.float32(np.nan) if unsure[x] else row[x]


@njit(nogil=True, error_model="numpy")
def _span_of_edges(near: Any, far: Any) -> Any:
    """Return the column of a row's first edge and the one after its last; equal without any."""
    first = 0
    while first < near.size and not near[first] - far[first] >= _EDGE:
        first += 1
    last = near.size
    while last > first and not near[last - 1] - far[last - 1] >= _EDGE:
        last -= 1
    return first, last


@njit(nogil=True, error_model="numpy")
def _mean_of_side(
    tones: Any, scale: Any, before: Any, y: int, x: int, middle: Any, near: bool
) -> Any:
    """Weighted mean disparity of the voters of one side, of which there must be one."""
    height, width = before.shape
    total = weighted = np.float32(0)
    for j in range(-_STEPS, _STEPS + 1):
        v = min(max(y + j * STRIDE, 0), height - 1)
        for i in range(-_STEPS, _STEPS + 1):
            u = x + i * STRIDE
            if 0 <= u < width and before[v, u] == before[v, u]:
                d = before[v, u]
                if (d > middle) == near:
                    weight = alike((tones[_STEPS, x] - tones[j + _STEPS, u]) * scale)
                    weight *= np.float32(_STEPS**2 / (_STEPS**2 + i * i + j * j))
                    total += weight
                    weighted += weight * d
    return weighted / total
