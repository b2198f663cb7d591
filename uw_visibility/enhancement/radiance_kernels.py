# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled inner loops of restoration, each over a band of rows.

A row is worked on plane by plane in small buffers, since the compiler makes
vector code of loops over contiguous floats without lookups, branches or calls.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit


@njit(nogil=True, error_model="numpy")
def polynomial(limit: Any, sign: float) -> tuple[Any, Any]:
    """Taylor polynomial of exp(sign t / 8) about the middle of 0 <= t <= limit.

    Its eighth power is exp(sign t), to a relative error of 4e-6 up to a limit
    of 7, where exp is 1000, and below 1e-7 up to 3.4, where it is 30.
    """
    middle = limit / 2
    out = np.empty(7, np.float32)
    term = np.exp(sign * middle / 8)
    for k in range(7):
        out[k] = term
        term *= sign / (8 * (k + 1))
    return out, np.float32(middle)


@njit(nogil=True, error_model="numpy")
def _thickness(distance: Any, attenuation: Any, limit: Any, out: Any) -> None:
    """Optical thickness of a row of ranges, from 0 to a limit, which unknown ranges get."""
    for x in range(out.size):
        u = distance[x] * attenuation
        # Written so that NaN and what is negative fail it.
        u = u if u >= np.float32(0) else limit
        out[x] = u if u < limit else limit


@njit(nogil=True, error_model="numpy")
def _kept(distance: Any, attenuation: Any, limit: Any, out: Any) -> None:
    """Write the part of a deviation that the limit of the thickness leaves, near exp(-excess)."""
    one = np.float32(1)
    for x in range(out.size):
        excess = distance[x] * attenuation - limit
        # Unknown range has no excess.
        excess = excess if excess > np.float32(0) else np.float32(0)
        excess = excess if excess < np.float32(1e3) else np.float32(1e3)
        out[x] = one / (one + excess + np.float32(0.5) * excess * excess)


@njit(nogil=True, error_model="numpy")
def exponential(p: Any, middle: Any, row: Any) -> None:
    """Replace each thickness in a row by its exponential."""
    p0, p1, p2, p3, p4, p5, p6 = p[0], p[1], p[2], p[3], p[4], p[5], p[6]
    for x in range(row.size):
        t = row[x] - middle
        e = p0 + t * (p1 + t * (p2 + t * (p3 + t * (p4 + t * (p5 + t * p6)))))
        e *= e
        e *= e
        row[x] = e * e


@njit(nogil=True, error_model="numpy")
def restore(
    start: int, stop: int, image: Any, distance: Any, decode: Any, encode: Any, attenuation: Any,
    veil: Any, light: Any, limits: Any, farthest: Any, enhanced: Any, limited: Any,
) -> None:
    """Restore a band of rows: ρ = B/W + (E/W - B/W) exp(βd), with βd and ρ limited.

    A channel whose gain is limited keeps only a part of its deviation from
    open water's B/W. What the least limited channel has more is taken from the mean
    deviation, each channel counting as far as its own gain goes: else the
    channel that water takes first would turn all that is far into its colour.
    """
    width, count = image.shape[1], image.shape[2]
    deviation = np.empty((count, width), np.float32)
    kept = np.empty((count, width), np.float32)
    row = np.empty(width, np.float32)
    total = np.empty(width, np.float32)
    mean = np.empty(width, np.float32)
    best = np.empty(width, np.float32)
    top = np.float32(encode.size - 1)
    half = np.float32(0.5)
    one = np.float32(1)
    zero = np.float32(0)
    p, middle = polynomial(np.float64(limits.max()), 1.0)
    for y in range(start, stop):
        for x in range(width):
            for c in range(count):
                deviation[c, x] = decode[image[y, x, c]]
        total[:] = np.float32(1e-6)
        mean[:] = 0
        for c in range(count):
            _thickness(distance[y], attenuation[c], limits[c], row)
            exponential(p, middle, row)
            _kept(distance[y], attenuation[c], limits[c], kept[c])
            plane = deviation[c]
            inverse = one / light[c]
            water = veil[c] / light[c]
            counts = one if limits[c] > 0 else zero
            for x in range(width):
                plane[x] = (plane[x] * inverse - water) * row[x]
                total[x] += counts * kept[c, x]
                mean[x] += counts * kept[c, x] * plane[x]
        best[:] = 0
        for c in range(count):
            if limits[c] > 0:
                for x in range(width):
                    best[x] = best[x] if best[x] > kept[c, x] else kept[c, x]
        for x in range(width):
            mean[x] /= total[x]
        for c in range(count):
            plane = deviation[c]
            water = veil[c] / light[c]
            for x in range(width):
                lost = best[x] - kept[c, x]
                lost = lost if lost > zero else zero
                radiance = water + plane[x] + lost * mean[x]
                radiance = radiance if radiance > zero else zero
                radiance = radiance if radiance < one else one
                plane[x] = radiance * top + half
        for x in range(width):
            for c in range(count):
                enhanced[y, x, c] = encode[np.uint32(index_of(deviation[c, x], zero, top))]
        for x in range(width):
            limited[y, x] = not (distance[y, x] >= zero and distance[y, x] <= farthest)
