# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence of matches in noise: a logistic regression on what look-alikes were matched to.

Where noise hides a surface's texture, the nearest strong edge is all that descriptors see, and
what is beside it takes the disparity of the edge in both views: the left/right check passes,
and pixels that the right view does not even show are matched. Their tone tells: of the pixels
around that look like them, most are unmatched, matched farther away, or denied by the right
view. So each pixel asks those around it, weighted by how much they look alike, as in a weighted
mode filter (Min, Lu and Do, doi:10.1109/TIP.2011.2163164).

Fitted to four Middlebury scenes and rendered ones in water with 1 to 4 codes of noise, some
through JPEG, at full size and at coarser scales; `lab/studies/stereo-noise.md` has its
reliability on scenes that a fit left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas.confidence import (
    confidence_table,
    difference_over_texture,
    is_denied,
    look_up,
    mark,
)
from uw_visibility.stereo.elas.descriptors import BYTES, MIDDLE
from uw_visibility.stereo.elas.edges import alike
from uw_visibility.stereo.elas.postprocess import fill_small_gaps, remove_occluded

# Pixels that are asked: five by five of them, this far apart.
_STRIDE, _STEPS = 6, 2
# Difference of even contrast, 8-bit levels, at which a voter counts half: noise is in it.
_ALIKE = 40.0
# Voters whose disparity differs by more, px, are of another surface.
_STEP = np.float32(1.5)
# Added to the sum of weights: who looks like nobody learns little from the others.
_LEAST_WEIGHT = np.float32(0.05)
# Doubtful pixels in a row that stand between sure ones, which are within so many px.
_BETWEEN_SURE, _ONE_SURFACE = 2, 1.0
# Log odds of a wrong match: without anything against it; for difference over texture; for the
# share of the look-alikes that were not matched to the same surface, and as much for that of
# those that the right view denies; for a level of restored noise, and the most levels that count.
_BASE, _DIFFERENCE, _AGAINST = -4.091, np.float32(0.322), np.float32(4.255)
_PER_LEVEL, _MOST_NOISE = 0.0537, 30.0
# Entries of the table of confidence for a unit of log odds: most matches are much alike.
_PER_UNIT = 256
_CONFIDENCE = confidence_table(_PER_UNIT)


def rate_in_noise(
    disparity: DisparityMap,
    best_right: NDArray[np.int16],
    descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    image: ContrastNormalizer,
    workers: Workers,
) -> NDArray[np.float32]:
    """Confidence of each disparity of a noisy pair, from the left `image` too; see `rate`."""
    height = disparity.shape[0]
    confidence = np.empty(disparity.shape, np.float32)
    marks, _ = mark(disparity, best_right, workers)
    base = np.float32(_BASE + _PER_LEVEL * min(image.noise, _MOST_NOISE))
    workers.rows(ask_look_alikes, height, disparity, marks, image.grey, image.gain, confidence)
    workers.rows(_rate, height, disparity, *descriptors, base, _CONFIDENCE, confidence)
    return confidence


def drop_doubtful(
    disparity: DisparityMap, confidence: NDArray[np.float32], least: float, workers: Workers
) -> None:
    """Set matches of less than the least confidence to NaN, in place.

    One or two doubtful pixels in a row between sure ones on one surface stay.
    """
    unmatched = np.isnan(disparity)
    disparity[confidence < least] = np.nan
    # Between two sure ones on one surface doubt is of the pixel, not of the surface.
    fill_small_gaps(disparity, _BETWEEN_SURE, _ONE_SURFACE, workers)
    disparity[unmatched] = np.nan
    remove_occluded(disparity, workers)


@njit(nogil=True, error_model="numpy")
def ask_look_alikes(
    start: int, stop: int, disparity: Any, marks: Any, grey: Any, gain: Any, against: Any
) -> None:
    """Write the weighted share of the voters that speak against each match."""
    height, width = disparity.shape
    tone, scale = np.empty(width, np.float32), np.empty(width, np.float32)
    total = np.empty(width, np.float32)
    for y in range(start, stop):
        for x in range(width):
            tone[x] = np.float32(grey[y, x])
            scale[x] = gain[y, x] * np.float32(1.0 / _ALIKE)
            total[x] = _LEAST_WEIGHT
            against[y, x] = 0
        for j in range(-_STEPS, _STEPS + 1):
            v = min(max(y + j * _STRIDE, 0), height - 1)
            for i in range(-_STEPS, _STEPS + 1):
                if i == 0 and j == 0:
                    continue
                shift = i * _STRIDE
                _ask(
                    max(0, -shift), min(width, width - shift), shift, disparity[y], tone, scale,
                    disparity[v], marks[v], grey[v],
                    np.float32(_STEPS**2 / (_STEPS**2 + i * i + j * j)), total, against[y],
                )
        for x in range(width):
            against[y, x] /= total[x]


@njit(nogil=True, error_model="numpy")
def _ask(
    first: int, last: int, shift: int, row: Any, tone: Any, scale: Any, voters: Any,
    voter_marks: Any, voter_tone: Any, closeness: Any, total: Any, against: Any,
) -> None:
    """Add one voter of each pixel of a row; apart from the rest, which makes vector code."""
    zero, one = np.float32(0), np.float32(1)
    for x in range(first, last):
        at, other = np.uint64(x), np.uint64(x + shift)
        weight = closeness * alike((tone[at] - np.float32(voter_tone[other])) * scale[at])
        # Also where the voter is unmatched.
        says = zero if abs(voters[other] - row[at]) <= _STEP else one
        says += one if is_denied(voter_marks[other]) else zero
        total[at] += weight
        against[at] += weight * says


@njit(nogil=True, error_model="numpy")
def _rate(
    start: int, stop: int, disparity: Any, left: Any, right: Any, base: Any, table: Any,
    confidence: Any,
) -> None:
    """Make confidence of what the look-alikes say, which stands there."""
    width = disparity.shape[1]
    blank = np.full(BYTES, MIDDLE, np.uint8)
    for y in range(start, stop):
        for x in range(width):
            d = disparity[y, x]
            if d != d:
                confidence[y, x] = 0
                continue
            odds = base + _AGAINST * confidence[y, x]
            odds += _DIFFERENCE * difference_over_texture(left, right, blank, y * width, x, d)
            confidence[y, x] = look_up(table, _PER_UNIT, odds)
