# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence of matches: the probability that a disparity is within 1 px of the truth.

A logistic regression on the difference of a match's descriptors over their texture, the level of
noise, and the matches of look-alikes: neighbours of similar tone. Where noise hides a surface's
texture, descriptors see only the nearest strong edge, and pixels beside it take its disparity in
both views: the left/right check passes, even for pixels that the right view does not show. But most
of their look-alikes are unmatched, matched farther away, or denied by the right view. So neighbours
vote on each match, weighted by similarity, as in a weighted mode filter (Min, Lu and Do,
doi:10.1109/TIP.2011.2163164).

Fitted to four Middlebury scenes and rendered ones in water with 1 to 4 codes of noise, some
through JPEG, at full size and at coarser scales; `lab/studies/stereo-noise.md` has its
reliability on scenes that were left out of the fit, and without noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.elas.descriptors import BYTES, MIDDLE, absolute_difference
from uw_visibility.stereo.elas.edges import alike
from uw_visibility.stereo.elas.postprocess import (
    columns_in_right,
    fill_small_gaps,
    remove_occluded,
)

# Distance of the voters, px, and their number to each side: five by five in all.
_STRIDE, _STEPS = 6, 2
# Difference of tone at which a voter counts half, 8-bit levels of normalised contrast; the
# difference includes noise.
_ALIKE = 40.0
# Largest difference of a voter's disparity on the same surface, px.
_STEP = np.float32(1.5)
# Added to the sum of weights: without look-alikes the vote is near 0.
_LEAST_WEIGHT = np.float32(0.05)
# Width of doubtful gaps between sure pixels that are bridged, px, and the largest difference of
# the sure ones, px; see `fill_small_gaps`.
_BETWEEN_SURE, _ONE_SURFACE = 2, 1.0
# Log odds of a wrong match: constant; per difference over texture; per share of look-alikes that
# are not matched to the same surface, and the same per share that the right view denies; per level
# of restored noise, and the most levels that count.
_BASE, _DIFFERENCE, _AGAINST = -4.091, np.float32(0.322), np.float32(4.255)
_PER_LEVEL, _MOST_NOISE = 0.0537, 30.0
# Largest difference over texture that counts, and a constant added to the texture, which may be
# near 0.
_MOST_DIFFERENCE, _LEAST_TEXTURE = np.float32(2.0), np.float32(20.0)
# The right view denies a match if its own disparity there differs by more than this, px.
_AGREES = np.float32(1.0)
# Limits of the log odds in the table of confidence, and its entries per unit.
_LEAST_ODDS, _MOST_ODDS, _PER_UNIT = -8, 8, 256
_ODDS = np.arange(_LEAST_ODDS, _MOST_ODDS + 0.5 / _PER_UNIT, 1 / _PER_UNIT)
_CONFIDENCE = (1 / (1 + np.exp(_ODDS))).astype(np.float32)


def rate(
    disparity: DisparityMap,
    best_right: NDArray[np.int16],
    descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    image: ContrastNormalizer,
    workers: Workers,
) -> NDArray[np.float32]:
    """Confidence of each disparity of a matched pair.

    disparity: (H, W) float32, left-referenced, px; NaN where unmatched.
    best_right: (H, W) int16, disparities found in the right view, px; -1 for none.
    descriptors: tuple of (H * W * 16,) uint8, of the left and of the right view.
    image: the left view that was described.
    Returns (H, W) float32, probability that the disparity is within 1 px of the truth; 0 where
    unmatched.
    """
    height = disparity.shape[0]
    confidence = np.empty(disparity.shape, np.float32)
    denied = np.empty(disparity.shape, np.bool_)
    workers.rows(_deny, height, disparity, best_right, denied)
    base = np.float32(_BASE + _PER_LEVEL * min(image.noise, _MOST_NOISE))
    workers.rows(ask_look_alikes, height, disparity, denied, image.grey, image.gain, confidence)
    workers.rows(_rate, height, disparity, *descriptors, base, _CONFIDENCE, confidence)
    return confidence


def drop_doubtful(
    disparity: DisparityMap, confidence: NDArray[np.float32], least: float, workers: Workers
) -> None:
    """Set matches of less than the least confidence to NaN, in place.

    Small gaps that this makes between sure matches are bridged again; see `fill_small_gaps`.
    """
    unmatched = np.isnan(disparity)
    disparity[confidence < least] = np.nan
    fill_small_gaps(disparity, _BETWEEN_SURE, _ONE_SURFACE, workers)
    disparity[unmatched] = np.nan
    remove_occluded(disparity, workers)


@njit(nogil=True, error_model="numpy")
def _deny(start: int, stop: int, disparity: Any, best_right: Any, denied: Any) -> None:
    """Mark the matches that the right view denies."""
    width = disparity.shape[1]
    column = np.empty(width, np.int32)
    there = np.empty(width, np.int16)
    for y in range(start, stop):
        columns_in_right(disparity[y], column)
        for x in range(width):
            there[x] = best_right[y, np.uint32(max(column[x], 0))]
        _compare_row(disparity[y], there, denied[y])


@njit(nogil=True, error_model="numpy")
def _compare_row(row: Any, there: Any, denied: Any) -> None:
    """Compare a row; in a function of its own, so that it becomes vector code."""
    for x in range(row.size):
        # Without a right disparity, -1, nothing is denied, nor where the left one is NaN.
        denied[x] = (abs(row[x] - np.float32(there[x])) > _AGREES) & (there[x] >= 0)


@njit(nogil=True, error_model="numpy")
def ask_look_alikes(
    start: int, stop: int, disparity: Any, denied: Any, grey: Any, gain: Any, against: Any
) -> None:
    """Write the weighted share of voters on other surfaces, plus that of denied ones, 0 to 2."""
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
                    disparity[v], denied[v], grey[v],
                    np.float32(_STEPS**2 / (_STEPS**2 + i * i + j * j)), total, against[y],
                )
        for x in range(width):
            against[y, x] /= total[x]


@njit(nogil=True, error_model="numpy")
def _ask(
    first: int, last: int, shift: int, row: Any, tone: Any, scale: Any, voters: Any,
    voter_denied: Any, voter_tone: Any, closeness: Any, total: Any, against: Any,
) -> None:
    """Add one voter of each pixel of a row; in a function of its own, for vector code."""
    zero, one = np.float32(0), np.float32(1)
    for x in range(first, last):
        at, other = np.uint64(x), np.uint64(x + shift)
        weight = closeness * alike((tone[at] - np.float32(voter_tone[other])) * scale[at])
        # An unmatched voter, NaN, is against the match, too.
        vote = zero if abs(voters[other] - row[at]) <= _STEP else one
        vote += one if voter_denied[other] else zero
        total[at] += weight
        against[at] += weight * vote


@njit(nogil=True, error_model="numpy")
def _rate(
    start: int, stop: int, disparity: Any, left: Any, right: Any, base: Any, table: Any,
    confidence: Any,
) -> None:
    """Replace the look-alikes' votes in `confidence` by the confidence."""
    width = disparity.shape[1]
    blank = np.full(BYTES, MIDDLE, np.uint8)
    for y in range(start, stop):
        for x in range(width):
            d = disparity[y, x]
            if d != d:
                confidence[y, x] = 0
                continue
            at = (y * width + x) * BYTES
            other = (y * width + x - index_of(d + np.float32(0.5), 0, x)) * BYTES
            difference = np.float32(absolute_difference(left, at, right, other))
            texture = np.float32(absolute_difference(left, at, blank, x & 0)) + _LEAST_TEXTURE
            odds = base + _AGAINST * confidence[y, x]
            odds += _DIFFERENCE * min(difference / texture, _MOST_DIFFERENCE)
            entry = (odds - np.float32(_LEAST_ODDS)) * np.float32(_PER_UNIT) + np.float32(0.5)
            confidence[y, x] = table[index_of(entry, 0, table.size - 1)]
