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
from uw_visibility.enhancement.grain import spread_row


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
    start: int, stop: int, image: Any, distance: Any, known: Any, decode: Any, encode: Any,
    attenuation: Any, veil: Any, light: Any, exposure: Any, noise: Any, veil_error: Any, limit: Any,
    smooth: Any, grain: Any, enhanced: Any, limited: Any,
) -> None:
    """Restore a band of rows: E/X + k (ρ - E/X), ρ = B/W + (E/W - B/W) exp(βd) within 0..1.

    X is `exposure`, and k is Wiener's part of the gain: what is known of the range over
    1 + N exp(2βd) + V (exp(βd) - 1)², with `noise` N and `veil_error` V; with infinite N a
    channel stays as it is.
    What the best channel has more, a channel takes from the mean of all, each counting by its k:
    else the channel that water takes first would turn all that is far into its colour.
    What is changed is the image without its grain, `smooth` and `grain` of `grain.Grain`; the
    grain is handed on as it is.
    """
    width, count = image.shape[1], image.shape[2]
    seen = np.empty((count, width), np.float32)
    restored = np.empty((count, width), np.float32)
    part = np.empty((count, width), np.float32)
    gain = np.empty(width, np.float32)
    total = np.empty(width, np.float32)
    mean = np.empty(width, np.float32)
    best = np.empty(width, np.float32)
    trust = np.empty(width, np.float32)
    noisy = np.empty((count, width), np.float32)
    level = np.empty(width, np.float32)
    cells = np.empty(smooth.shape[2], np.float32)
    top = np.float32(encode.size - 1)
    half = np.float32(0.5)
    one = np.float32(1)
    zero = np.float32(0)
    p, middle = polynomial(np.float64(limit), 1.0)
    for y in range(start, stop):
        for x in range(width):
            for c in range(count):
                seen[c, x] = decode[image[y, x, c]]
                noisy[c, x] = image[y, x, c]
        for x in range(width):
            # Written so that NaN and infinity fail it.
            ranged = (distance[y, x] >= zero) & (distance[y, x] < np.float32(np.inf))
            trust[x] = known[y, x] if ranged else zero
            limited[y, x] = False
        total[:] = np.float32(1e-6)
        mean[:] = 0
        best[:] = 0
        for c in range(count):
            if not noise[c] < np.inf:
                continue
            spread_row(smooth[c], y, cells, level)
            spread_row(grain[c], y, cells, gain)
            for x in range(width):
                noisy[c, x] = (noisy[c, x] - level[x]) * gain[x]
                seen[c, x] -= noisy[c, x]
            _thickness(distance[y], attenuation[c], limit, gain)
            exponential(p, middle, gain)
            inverse = one / light[c]
            water = veil[c] / light[c]
            for x in range(width):
                e = gain[x]
                radiance = water + (seen[c, x] * inverse - water) * e
                radiance = radiance if radiance > zero else zero
                radiance = radiance if radiance < one else one
                k = trust[x] / (one + noise[c] * e * e + veil_error[c] * (e - one) * (e - one))
                restored[c, x] = radiance
                part[c, x] = k
                total[x] += k
                mean[x] += k * radiance
                best[x] = best[x] if best[x] > k else k
        for x in range(width):
            mean[x] /= total[x]
        for c in range(count):
            plane = seen[c]
            if noise[c] < np.inf:
                inverse = one / exposure[c]
                for x in range(width):
                    k = part[c, x]
                    plane[x] *= inverse
                    limited[y, x] |= k < half
                    plane[x] += (
                        k * (restored[c, x] - plane[x]) + (best[x] - k) * (mean[x] - plane[x]))
                    plane[x] += noisy[c, x] * inverse
            for x in range(width):
                plane[x] = plane[x] * top + half
        for x in range(width):
            for c in range(count):
                enhanced[y, x, c] = encode[np.uint32(index_of(seen[c, x], zero, top))]
