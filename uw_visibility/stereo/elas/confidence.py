# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence of matches: the probability that a disparity is within 1 px of the truth.

A logistic regression on what is at hand where a match is made: how much its descriptors
differ over their texture, the range of disparities around it (a depth edge), how much of its
neighbourhood is unmatched, how far it is from what the right view matches best (a filled
occlusion), and the noise of the restored pair. Fitted to four Middlebury scenes and two
rendered ones in water, with 0 to 4 codes of noise; `docs/stereo-noise.md` has its reliability
on scenes that a fit left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.compute.threads import Workers
from uw_visibility.stereo.elas.absolute_difference import BYTES, absolute_difference
from uw_visibility.stereo.elas.descriptors import MIDDLE
from uw_visibility.stereo.elas.edges import MARGIN, STRIDE, VOTERS, range_around

# Log odds of a wrong match: without anything against it; for difference over texture; for
# the logarithm of the range of disparities, px; for each pixel that the right view differs;
# for the unmatched share; for each 8-bit level of restored noise.
_BASE = -4.24
_DIFFERENCE = np.float32(0.89)
_RANGE = 1.01
_APART = np.float32(0.245)
_UNMATCHED = np.float32(3.76)
_NOISE = 0.07
# Up to these they count.
_MOST_DIFFERENCE = np.float32(2.0)
_MOST_RANGE = 20
_MOST_APART = np.float32(3.0)
_MOST_NOISE = 30.0
# Added to the texture, so that noise on a blank wall is no small difference.
_LEAST_TEXTURE = np.float32(20.0)
# Entries of tables for a unit of range and of log odds, and the least log odds in them.
_PER_UNIT = 16
_LEAST_ODDS = -8
_MOST_ODDS = 8


def _tables() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    ranges = np.arange(_MOST_RANGE * _PER_UNIT + 1) / _PER_UNIT
    odds = np.arange(_LEAST_ODDS, _MOST_ODDS + 0.5 / _PER_UNIT, 1 / _PER_UNIT)
    return (
        (_BASE + _RANGE * np.log1p(ranges)).astype(np.float32),
        (1 / (1 + np.exp(odds))).astype(np.float32),
    )


_ODDS_OF_RANGE, _CONFIDENCE = _tables()


def rate(
    disparity: NDArray[np.float32],
    best_right: NDArray[np.int16],
    descriptors: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    noise: float,
    workers: Workers,
) -> NDArray[np.float32]:
    """Confidence of each disparity of a matched pair.

    Parameters
    ----------
    disparity : ndarray
        ``(H, W)`` float32, left-referenced, px; NaN where unmatched.
    best_right : ndarray
        ``(H, W)`` int16, what the search found in the right view, -1 for nothing.
    descriptors : tuple of ndarray
        Of the left and of the right view, ``(H * W * 16,)`` uint8.
    noise : float
        Restored noise of the median pixel, in 8-bit levels of even contrast.
    workers : Workers
        Threads.

    Returns
    -------
    ndarray
        ``(H, W)`` float32, probability that the disparity is within 1 px of the
        truth; 0 where unmatched.
    """
    confidence = np.empty(disparity.shape, np.float32)
    odds_of_range = _ODDS_OF_RANGE + np.float32(_NOISE * min(noise, _MOST_NOISE))
    workers.rows(
        _rate, disparity.shape[0], disparity, best_right, descriptors[0], descriptors[1],
        odds_of_range, _CONFIDENCE, confidence,
    )
    return confidence


@njit(nogil=True, error_model="numpy")
def _rate(
    start: int, stop: int, disparity: Any, best_right: Any, left: Any, right: Any,
    odds_of_range: Any, table: Any, confidence: Any,
) -> None:
    width = disparity.shape[1]
    low = np.full(width + 2 * MARGIN, np.inf, np.float32)
    high = np.full(width + 2 * MARGIN, -np.inf, np.float32)
    far, near = np.empty(width, np.float32), np.empty(width, np.float32)
    column = np.zeros(width + 2 * MARGIN, np.float32)
    matched = np.empty(width, np.float32)
    blank = np.full(BYTES, MIDDLE, np.uint8)
    last = np.float32(odds_of_range.size - 1)
    most = np.float32(table.size - 1)
    per_unit = np.float32(_PER_UNIT)
    least = np.float32(_LEAST_ODDS)
    for y in range(start, stop):
        range_around(disparity, y, low, high, far, near)
        _count_matched(disparity, y, column, matched)
        for x in range(width):
            d = disparity[y, x]
            if d != d:
                confidence[y, x] = 0
                continue
            odds = odds_of_range[np.int32(min((near[x] - far[x]) * per_unit, last))]
            odds += _UNMATCHED * (np.float32(1) - matched[x])
            column_right = max(x - np.int32(d + np.float32(0.5)), 0)
            there = best_right[y, column_right]
            if there >= 0:
                odds += _APART * min(abs(d - np.float32(there)), _MOST_APART)
            at = (y * width + x) * BYTES
            other = (y * width + column_right) * BYTES
            difference = np.float32(absolute_difference(left, at, right, other))
            texture = np.float32(absolute_difference(left, at, blank, x & 0)) + _LEAST_TEXTURE
            odds += _DIFFERENCE * min(difference / texture, _MOST_DIFFERENCE)
            entry = (odds - least) * per_unit + np.float32(0.5)
            confidence[y, x] = table[np.int32(min(max(entry, np.float32(0)), most))]


@njit(nogil=True, error_model="numpy")
def _count_matched(disparity: Any, y: int, column: Any, matched: Any) -> None:
    """Write the matched share of the pixels around each one of a row."""
    height, width = disparity.shape
    column[:] = 0
    for j in range(-MARGIN, MARGIN + 1, STRIDE):
        row = disparity[min(max(y + j, 0), height - 1)]
        _add_matched(row, column[MARGIN : MARGIN + width])
    i, j, k, m = STRIDE, 2 * STRIDE, 3 * STRIDE, 4 * STRIDE
    _add_five(column, column[i:], column[j:], column[k:], column[m:], matched)


@njit(nogil=True, error_model="numpy")
def _add_matched(row: Any, column: Any) -> None:
    for x in range(column.size):
        column[x] += np.float32(1) if row[x] == row[x] else np.float32(0)


@njit(nogil=True, error_model="numpy")
def _add_five(a: Any, b: Any, c: Any, d: Any, e: Any, out: Any) -> None:
    share = np.float32(1.0 / VOTERS)
    for x in range(out.size):
        out[x] = share * (a[x] + b[x] + c[x] + d[x] + e[x])
