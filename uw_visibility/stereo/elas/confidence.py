# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence of matches: the probability that a disparity is within 1 px of the truth.

A logistic regression on what is at hand where a match is made: how much its descriptors
differ over their texture, the range of disparities around it (a depth edge), how much of its
neighbourhood is unmatched, and how much of it, and of the whole image, the right view denies,
which is more the more noise there is. Fitted to four Middlebury scenes and four rendered ones
in water, with 0 to 4 codes of noise; `lab/studies/stereo-noise.md` has its reliability on
scenes that a fit left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.indexing import index_of
from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.images.arrays import DisparityMap
from uw_visibility.stereo.elas.descriptors import BYTES, MIDDLE, absolute_difference
from uw_visibility.stereo.elas.edges import MARGIN, STRIDE, VOTERS, range_around
from uw_visibility.stereo.elas.postprocess import columns_in_right

# Log odds of a wrong match: without anything against it; for difference over texture; for
# each pixel of the range of disparities; for the unmatched share of the pixels around; for the
# logarithm of 1 + 25 times the share of the matched ones among them that the right view denies;
# for that share of the whole image. Where that is large an edge tells less.
_BASE = -6.186
_DIFFERENCE = np.float32(0.459)
_RANGE, _RANGE_WHERE_DENIED = 0.802, -2.179
_UNMATCHED = 3.169
_DENIED = 0.895
_DENIED_OF_ALL = 10.907
# Up to these they count.
_MOST_DIFFERENCE = np.float32(2.0)
_MOST_RANGE = np.float32(3.0)
# The right view denies a match whose pixel it matches by more than so many px otherwise.
_AGREES = np.float32(1.0)
# Marks are summed over the voters: these bits count the matched ones, those above the denied.
_MATCHED_BITS = 5
_NO_MARK, _MATCHED, _DENIED_TOO = np.uint16(0), np.uint16(1), np.uint16(1 << _MATCHED_BITS)
# Added to the texture, so that noise on a blank wall is no small difference.
_LEAST_TEXTURE = np.float32(20.0)
# Log odds that a table of confidence holds, and its entries for a unit of them.
_LEAST_ODDS, _MOST_ODDS = -8, 8
_PER_UNIT = 16


def confidence_table(per_unit: int) -> NDArray[np.float32]:
    """Confidence by the log odds of a wrong match, so many entries a unit; see `look_up`."""
    odds = np.arange(_LEAST_ODDS, _MOST_ODDS + 0.5 / per_unit, 1 / per_unit)
    return (1 / (1 + np.exp(odds))).astype(np.float32)


def _odds_of_votes() -> NDArray[np.float32]:
    denied, matched = np.divmod(np.arange((VOTERS + 1) << _MATCHED_BITS), 1 << _MATCHED_BITS)
    share = denied / np.maximum(matched, 1)
    votes = _BASE + _UNMATCHED * (1 - matched / VOTERS) + _DENIED * np.log1p(VOTERS * share)
    return votes.astype(np.float32)


_ODDS_OF_VOTES = _odds_of_votes()
_CONFIDENCE = confidence_table(_PER_UNIT)


def rate(
    disparity: DisparityMap,
    best_right: NDArray[np.int16],
    descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    workers: Workers,
) -> NDArray[np.float32]:
    """Confidence of each disparity of a matched pair.

    disparity: (H, W) float32, left-referenced, px; NaN where unmatched.
    best_right: (H, W) int16, what the search found in the right view, px; -1 for nothing.
    descriptors: tuple of (H * W * 16,) uint8, of the left and of the right view.
    Returns (H, W) float32, probability that the disparity is within 1 px of the truth; 0 where
    unmatched.
    """
    confidence = np.empty(disparity.shape, np.float32)
    marks, share = mark(disparity, best_right, workers)
    odds_of_votes = _ODDS_OF_VOTES + np.float32(_DENIED_OF_ALL * share)
    odds_of_range = np.float32(max(_RANGE + _RANGE_WHERE_DENIED * share, 0.0))
    workers.rows(
        _rate, disparity.shape[0], disparity, marks, descriptors[0], descriptors[1],
        odds_of_votes, odds_of_range, _CONFIDENCE, confidence,
    )
    return confidence


def mark(
    disparity: DisparityMap, best_right: NDArray[np.int16], workers: Workers
) -> tuple[NDArray[np.uint16], float]:
    """Marks (H, W) of what is matched and what the right view denies; the share that it denies."""
    marks = np.empty(disparity.shape, np.uint16)
    workers.rows(_mark, disparity.shape[0], disparity, best_right, marks)
    matched = int(np.count_nonzero(marks))
    return marks, int(np.count_nonzero(marks > _MATCHED)) / max(matched, 1)


@njit(nogil=True, error_model="numpy", inline="always")
def is_denied(marked: Any) -> bool:
    """Whether a mark says that the right view denies the match."""
    return marked >> _MATCHED_BITS != 0


@njit(nogil=True, error_model="numpy")
def difference_over_texture(left: Any, right: Any, blank: Any, row: int, x: Any, d: Any) -> Any:
    """Difference of a match's descriptors over their texture; `row` is the row's first pixel."""
    at = (row + x) * BYTES
    other = (row + x - index_of(d + np.float32(0.5), 0, x)) * BYTES
    difference = np.float32(absolute_difference(left, at, right, other))
    texture = np.float32(absolute_difference(left, at, blank, x & 0)) + _LEAST_TEXTURE
    return min(difference / texture, _MOST_DIFFERENCE)


@njit(nogil=True, error_model="numpy", inline="always")
def look_up(table: Any, per_unit: int, odds: Any) -> Any:
    """Confidence for log odds of a wrong match, from a `confidence_table`."""
    entry = (odds - np.float32(_LEAST_ODDS)) * np.float32(per_unit) + np.float32(0.5)
    return table[index_of(entry, 0, table.size - 1)]


@njit(nogil=True, error_model="numpy")
def _mark(start: int, stop: int, disparity: Any, best_right: Any, marks: Any) -> None:
    width = disparity.shape[1]
    column = np.empty(width, np.int32)
    there = np.empty(width, np.int16)
    for y in range(start, stop):
        columns_in_right(disparity[y], column)
        _gather(best_right[y], column, there)
        _mark_row(disparity[y], there, marks[y])


@njit(nogil=True, error_model="numpy")
def _gather(source: Any, column: Any, out: Any) -> None:
    for x in range(column.size):
        out[x] = source[np.uint32(max(column[x], 0))]


@njit(nogil=True, error_model="numpy")
def _mark_row(row: Any, there: Any, marks: Any) -> None:
    for x in range(row.size):
        d, other = row[x], np.float32(there[x])
        matched = _MATCHED if d == d else _NO_MARK
        # Where the right view tried nothing it denies nothing.
        apart = _DENIED_TOO if abs(d - other) > _AGREES else _NO_MARK
        marks[x] = matched | (apart if other >= 0 else _NO_MARK)


@njit(nogil=True, error_model="numpy")
def _rate(
    start: int, stop: int, disparity: Any, marks: Any, left: Any, right: Any,
    odds_of_votes: Any, odds_of_range: Any, table: Any, confidence: Any,
) -> None:
    width = disparity.shape[1]
    low = np.full(width + 2 * MARGIN, np.inf, np.float32)
    high = np.full(width + 2 * MARGIN, -np.inf, np.float32)
    far, near = np.empty(width, np.float32), np.empty(width, np.float32)
    column = np.zeros(width + 2 * MARGIN, np.uint16)
    votes = np.empty(width, np.uint16)
    blank = np.full(BYTES, MIDDLE, np.uint8)
    for y in range(start, stop):
        range_around(disparity, y, low, high, far, near)
        _add_up(marks, y, column, votes)
        for x in range(width):
            d = disparity[y, x]
            if d != d:
                confidence[y, x] = 0
                continue
            odds = odds_of_votes[votes[x]] + odds_of_range * min(near[x] - far[x], _MOST_RANGE)
            odds += _DIFFERENCE * difference_over_texture(left, right, blank, y * width, x, d)
            confidence[y, x] = look_up(table, _PER_UNIT, odds)


@njit(nogil=True, error_model="numpy")
def _add_up(marks: Any, y: int, column: Any, votes: Any) -> None:
    """Write the sum of the voters' marks around each pixel of a row."""
    height, width = marks.shape
    inner = column[MARGIN : MARGIN + width]
    inner[:] = 0
    for j in range(-MARGIN, MARGIN + 1, STRIDE):
        _add(marks[min(max(y + j, 0), height - 1)], inner)
    i, j, k, m = STRIDE, 2 * STRIDE, 3 * STRIDE, 4 * STRIDE
    _add_five(column, column[i:], column[j:], column[k:], column[m:], votes)


@njit(nogil=True, error_model="numpy")
def _add(row: Any, column: Any) -> None:
    for x in range(column.size):
        column[x] = np.uint16(column[x] + row[x])


@njit(nogil=True, error_model="numpy")
def _add_five(a: Any, b: Any, c: Any, d: Any, e: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = np.uint16(a[x] + b[x] + c[x] + d[x] + e[x])
