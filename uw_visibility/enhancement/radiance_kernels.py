# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled inner loops of restoration, each over a band of rows.

A row is worked on plane by plane in small buffers, since the compiler makes
vector code of loops over contiguous floats without lookups, branches or calls.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Binomial weights, near a Gaussian of 1 px: what smoothing is blended from.
OUTER = np.float32(1 / 16)
INNER = np.float32(4 / 16)
MIDDLE = np.float32(6 / 16)
# Share of white noise's variance that the kernel keeps, and the kernel's centre.
KEPT = np.float32((70 / 256) ** 2)
CENTRE = np.float32((6 / 16) ** 2)


@njit(nogil=True, cache=True, error_model="numpy")
def polynomial(limit, sign):  # type: ignore[no-untyped-def]
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


@njit(nogil=True, cache=True, error_model="numpy")
def _thickness(distance, attenuation, limit, out):  # type: ignore[no-untyped-def]
    """Optical thickness of a row of ranges, from 0 to a limit, which unknown ranges get."""
    for x in range(out.size):
        u = distance[x] * attenuation
        # Written so that NaN and what is negative fail it.
        u = u if u >= np.float32(0) else limit
        out[x] = u if u < limit else limit


@njit(nogil=True, cache=True, error_model="numpy")
def _exponential(p, middle, row):  # type: ignore[no-untyped-def]
    """Replace each thickness in a row by its exponential."""
    p0, p1, p2, p3, p4, p5, p6 = p[0], p[1], p[2], p[3], p[4], p[5], p[6]
    for x in range(row.size):
        t = row[x] - middle
        e = p0 + t * (p1 + t * (p2 + t * (p3 + t * (p4 + t * (p5 + t * p6)))))
        e *= e
        e *= e
        row[x] = e * e


@njit(nogil=True, cache=True, error_model="numpy")
def restore(  # type: ignore[no-untyped-def]
    start, stop, image, distance, decode, encode, attenuation, ambient, limits, enhanced, limited
):
    """Restore a band of rows: ρ = 1 + (E / I∞ - 1) exp(βd), with βd and ρ limited."""
    width, count = image.shape[1], image.shape[2]
    light = np.empty((count, width), np.float32)
    row = np.empty(width, np.float32)
    top = np.float32(encode.size - 1)
    half = np.float32(0.5)
    one = np.float32(1)
    zero = np.float32(0)
    steepest = np.float32(0)
    limit = np.float32(0)
    for c in range(count):
        if limits[c] > 0:
            steepest = max(steepest, attenuation[c])
            limit = limits[c]
    p, middle = polynomial(np.float64(limit), 1.0)
    known = not limits.any()
    for y in range(start, stop):
        for x in range(width):
            for c in range(count):
                light[c, x] = decode[image[y, x, c]]
        for c in range(count):
            _thickness(distance[y], attenuation[c], limits[c], row)
            _exponential(p, middle, row)
            plane = light[c]
            inverse = one / ambient[c]
            for x in range(width):
                radiance = one + (plane[x] * inverse - one) * row[x]
                radiance = radiance if radiance > zero else zero
                radiance = radiance if radiance < one else one
                plane[x] = radiance * top + half
        for x in range(width):
            for c in range(count):
                enhanced[y, x, c] = encode[np.uint32(light[c, x])]
        for x in range(width):
            u = distance[y, x] * steepest
            limited[y, x] = not (known or (u >= zero and u <= limit))


@njit(nogil=True, cache=True, error_model="numpy")
def mix(  # type: ignore[no-untyped-def]
    start, stop, image, distance, decode, attenuation, ambient, limits, precision, grey, noise
):
    """Mix the restored channels with the least noise; grey and noise in grey levels."""
    width, count = image.shape[1], image.shape[2]
    light = np.empty((count, width), np.float32)
    row = np.empty(width, np.float32)
    signal = np.empty(width, np.float32)
    weight = np.empty(width, np.float32)
    white = np.float32(255)
    p, middle = polynomial(np.float64(limits.max()), -1.0)
    for y in range(start, stop):
        for x in range(width):
            for c in range(count):
                light[c, x] = decode[image[y, x, c]]
        signal[:] = 0
        weight[:] = 0
        for c in range(count):
            _thickness(distance[y], attenuation[c], limits[c], row)
            _exponential(p, middle, row)
            plane = light[c]
            airlight = ambient[c]
            scale = precision[c]
            for x in range(width):
                t = row[x] * airlight
                share = t * scale
                weight[x] += t * share
                signal[x] += share * (plane[x] - airlight)
        out = grey[y]
        deviation = noise[y]
        for x in range(width):
            out[x] = white + white * signal[x] / weight[x]
            deviation[x] = white / np.sqrt(weight[x])


@njit(nogil=True, cache=True, error_model="numpy")
def smooth(start, stop, grey, even, out, noise):  # type: ignore[no-untyped-def]
    """Blend each pixel with its smoothed value by the variance of its noise; round."""
    height, width = grey.shape
    padded = np.empty(width + 4, np.float32)
    columns = padded[2 : width + 2]
    smoothed = np.empty(width, np.float32)
    most_left, left, right, most_right = padded[0:], padded[1:], padded[3:], padded[4:]
    one = np.float32(1)
    two = np.float32(2)
    half = np.float32(0.5)
    zero = np.float32(0)
    white = np.float32(255)
    for y in range(start, stop):
        top = grey[max(y - 2, 0)]
        above = grey[max(y - 1, 0)]
        here = grey[y]
        below = grey[min(y + 1, height - 1)]
        bottom = grey[min(y + 2, height - 1)]
        deviation = noise[y]
        target = out[y]
        for x in range(width):
            columns[x] = (
                OUTER * (top[x] + bottom[x]) + INNER * (above[x] + below[x]) + MIDDLE * here[x]
            )
        padded[:2] = columns[0]
        padded[width + 2 :] = columns[width - 1]
        for x in range(width):
            smoothed[x] = (
                OUTER * (most_left[x] + most_right[x])
                + INNER * (left[x] + right[x])
                + MIDDLE * columns[x]
            )
        for x in range(width):
            variance = deviation[x] * deviation[x]
            k = variance / (variance + even)
            level = here[x] + k * (smoothed[x] - here[x])
            level = level if level > zero else zero
            smoothed[x] = level if level < white else white
            rest = one - k
            deviation[x] *= np.sqrt(rest * rest + two * k * rest * CENTRE + k * k * KEPT)
        for x in range(width):
            target[x] = np.int32(smoothed[x] + half)
