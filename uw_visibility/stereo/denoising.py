# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Gaussian smoothing at a scale that follows the noise of the restored image.

Restoration amplifies gradients and noise, most where the water has reduced contrast most. So each
pixel is smoothed according to its own restored noise before gradients are taken: near texture stays
fine, and far texture, whose fine part is lost in noise, is matched by its coarse part.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import Array

# Largest noise that is rounding alone, 8-bit codes.
ROUNDING = 0.35
# Restored noise, in 8-bit levels of normalised contrast, up to which an image is not smoothed.
LEAST_NOISE = 1.0
# Standard deviation of the Gaussian, px, for a restored noise of 1 level, and its exponent of the
# noise. Chosen on three scenes at 1, 2 and 4 codes of noise.
_SCALE, _POWER = 0.25, 0.7
# Computed scales, px: the first, the ratio of neighbours, and their number; the image is
# interpolated between them.
_FIRST, _RATIO, _LEVELS = 0.6, math.sqrt(2.0), 6
LARGEST = _FIRST * _RATIO ** (_LEVELS - 1)
# Reach of a Gaussian, standard deviations.
_DEVIATIONS = 4.0
# Entries of the table of scales over gain.
_TABLE = 1024


def smooth(
    grey: NDArray[np.uint16], gain: NDArray[np.float32], noise: float, workers: Workers
) -> float:
    """Smooth a grey image in place; return its restored noise before smoothing.

    `gain` is 8-bit levels of normalised contrast per unit of `grey`, `noise` the standard
    deviation of the image's noise in units of `grey`. The restored noise is that at the
    median gain, in levels; up to `LEAST_NOISE` the image is not changed.
    """
    restored = noise * float(np.median(gain[::8, ::8]))
    if restored <= LEAST_NOISE:
        return restored
    largest = gain.max(axis=1)
    low, high = float(gain.min()), float(largest.max())
    if high <= low * (1.0 + 1e-6):
        cv2.GaussianBlur(grey, (0, 0), _scale_of(restored), dst=grey)
        return restored
    gains = np.linspace(low, high, _TABLE)
    # Position among the computed scales, between two of them.
    position = np.interp(
        _scale_of(noise * gains), [_sigma(level) for level in range(_LEVELS + 1)],
        np.arange(_LEVELS + 1)).astype(np.float32)
    per_gain = np.float32((_TABLE - 1) / (high - low))
    coarsest = position[((largest - np.float32(low)) * per_gain + np.float32(0.5)).astype(int)]
    # At least two neighbouring scales, also if all pixels need the coarsest one or more.
    finest = min(int(position.min()), _LEVELS - 1)
    scales = _blurred(grey, finest, np.minimum(coarsest.astype(int) + 1, _LEVELS))
    workers.rows(
        _interpolate, grey.shape[0], scales, gain, np.float32(low), per_gain, position, grey)
    return restored


def _blurred(
    grey: NDArray[np.uint16], finest: int, coarsest: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Images at the scales from the finest to the coarsest that each row needs.

    Each is blurred from the one before, as floats, which takes OpenCV half the time of 16-bit
    integers, and only in the rows that need it: few rows need coarse scales.
    """
    scales = np.empty((_LEVELS + 1, *grey.shape), np.float32)
    scales[0] = grey
    steps = []
    start, stop = len(grey), 0
    # Rows of each scale, from the coarsest to the finest: the next coarser scale reads all of them.
    for level in range(int(coarsest.max()), max(finest, 1) - 1, -1):
        before = level - 1 if level > max(finest, 1) else 0
        sigma = math.sqrt(_sigma(level) ** 2 - _sigma(before) ** 2)
        reach = math.ceil(_DEVIATIONS * sigma) + 1
        needing = np.flatnonzero(coarsest >= level)
        start = max(min(start, int(needing[0])) - reach, 0)
        stop = min(max(stop, int(needing[-1]) + 1) + reach, len(grey))
        steps.append((before, level, sigma, slice(start, stop)))
    for before, level, sigma, rows in reversed(steps):
        cv2.GaussianBlur(scales[before, rows], (0, 0), sigma, dst=scales[level, rows])
    return scales


def _sigma(level: int) -> float:
    """Standard deviation of the Gaussian of a scale, px; scale 0 is the image itself."""
    return _FIRST * _RATIO ** (level - 1) if level > 0 else 0.0


def noise_gradient(noise: NDArray[np.floating]) -> Array:
    """Standard deviation of Sobel responses to restored noise after smoothing, 8-bit levels."""
    scales, responses = _responses()
    return np.asarray(noise * np.interp(_scale_of(noise), scales, responses))


@lru_cache(maxsize=1)
def _responses() -> tuple[Array, Array]:
    """Scales of the Gaussian, px, and standard deviations of Sobel responses to unit noise."""
    scales = np.linspace(0.0, LARGEST, 24)
    impulse = np.zeros((41, 41))
    impulse[20, 20] = 1.0
    images = [impulse] + [cv2.GaussianBlur(impulse, (0, 0), scale) for scale in scales[1:]]
    responses = [math.sqrt(float((cv2.Sobel(i, cv2.CV_64F, 1, 0) ** 2).sum())) for i in images]
    return scales, np.array(responses)


def _scale_of(noise: Any) -> Any:
    """Standard deviation of the Gaussian, px, for a restored noise."""
    return np.minimum(_SCALE * np.power(noise, _POWER), LARGEST)


@njit(nogil=True, error_model="numpy")
def _interpolate(
    start: int, stop: int, scales: Any, gain: Any, low: Any, per_gain: Any, position: Any, grey: Any
) -> None:
    most, last = np.int32(scales.shape[0] - 2), position.size - 1
    place = np.empty(grey.shape[1], np.int32)
    share, value = np.empty((2, grey.shape[1]), np.float32)
    for y in range(start, stop):
        # Short loops, so that those without lookups become vector code.
        for x in range(place.size):
            place[x] = index_of((gain[y, x] - low) * per_gain + np.float32(0.5), 0, last)
        for x in range(place.size):
            # Unsigned, since numba checks whether signed indices are negative.
            share[x] = position[np.uint32(place[x])]
        for x in range(place.size):
            place[x] = index_of(share[x], 0, most)
            share[x] -= np.float32(place[x])
        for x in range(place.size):
            here = np.uint32(place[x])
            fine, coarse = scales[here, y, x], scales[here + np.uint32(1), y, x]
            value[x] = fine + share[x] * (coarse - fine) + np.float32(0.5)
        for x in range(place.size):
            grey[y, x] = np.uint16(value[x])
