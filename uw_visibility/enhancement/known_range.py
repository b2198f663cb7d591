# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Range of every pixel and its reliability, both smoothed without blurring image edges.

Ranges in filled gaps and in areas without texture, such as open water, are uncertain, and full
restoration by them would show false outlines. Restoration fades out with the reliability.
Uses a guided filter on cells (He and Sun, arXiv 1505.00996).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from uw_visibility.enhancement.guided import Plane, guided
from uw_visibility.images.arrays import Array, Image, Mask, RangeMap
from uw_visibility.images.noise import ROUNDING_VARIANCE

# Side of a cell, px; radius of the guided filter's windows, in cells, for ranges, for those in gaps
# alone, and for their reliability.
_CELL = 8
_RANGE_WINDOW, _GAP_WINDOW, _KNOWN_WINDOW = 3, 1, 4
# Variance of the image, scaled to 0..1, below which it counts as flat.
_FLAT = 1e-4
# Matches in a second window, larger by this factor, count with this weight for gaps.
_FARTHER, _FARTHER_COUNTS = 4, 0.1
# Weight of the prior for gaps, as a share of matches in a window.
_NO_MATCH = 0.01
# Weights of red, green and blue in OpenCV's grey (ITU-R BT.601).
_GREY = np.array([0.299, 0.587, 0.114])
# Kernel of second differences, and their variance for white noise of variance 1.
_SECOND_DIFFERENCES = np.array([[-1.0, 2.0, -1.0]], np.float32)
_OF_NOISE = 6.0
# Smallest inverse range, which stands for infinity, and largest one, 1/m.
_INFINITY, _NEAREST = 1e-4, 1e3


class KnownRange(NamedTuple):
    """Range without holes, (H, W) float32, m, and its reliability, (H, W) float32, 0..1."""

    range_map: RangeMap
    known: Plane


def known_range(
    image: Image, range_map: RangeMap, matched: Mask, noise: Array, attenuation: Array,
    range_error: float, max_gap: int,
) -> KnownRange:
    """Range of every pixel, and its reliability: the factor by which restoration is reduced.

    If the optical thickness βd has the standard deviation σ, the least-squares gain is
    E[e^(-βd)] / E[e^(-2βd)] = e^(βd) e^(-3σ²/2); the second factor is the reliability. The variance
    of inverse range is the matcher's times (1 + noise variance over texture variance). Surrounding
    matches tell the range of a matched pixel, too. In gaps their variance is added: what has no
    texture there may be open water.

    image: (H, W, 3) or (H, W) of uint8 or uint16, pixel values.
    range_map: (H, W) float32, range, m, with gaps filled; NaN counts as infinity.
    matched: (H, W) bool, pixels whose range was measured.
    noise: (C,) float64, standard deviation of the image's noise, in code values.
    attenuation: (C,) float64, β, 1/m; NaN where not assessable. The smallest is used; if all are
        NaN, the reliability is 0.
    range_error: standard deviation of a matched inverse range, 1/m.
    max_gap: radius of the window in which gaps use matches, px.
    """
    height, width = matched.shape
    half = ((width + 1) // 2, (height + 1) // 2)
    cells = (max(width // _CELL, 1), max(height // _CELL, 1))
    full = np.float32(1.0 / np.iinfo(image.dtype).max)
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    grey = grey.astype(np.float32)
    guide = _resize(grey, half) * full
    small = _resize(guide, cells)
    every = grey[::2, ::2].copy()
    fine = np.maximum(_resize(every * every, cells) - _resize(every, cells) ** 2, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        # `fmax` replaces NaN by 0.
        inverse = np.minimum(np.fmax(np.float32(1.0) / range_map[::2, ::2], 0.0), _NEAREST)
    measured = matched[::2, ::2]
    share = _resize(measured.astype(np.float32), cells)
    value = _resize(inverse, cells)

    weights = _GREY**2 if noise.size == 3 else np.ones(1)
    of_pixels = float(weights @ (noise**2 + ROUNDING_VARIANCE)) / _CELL**2
    differences = cv2.filter2D(small, -1, _SECOND_DIFFERENCES, borderType=cv2.BORDER_REFLECT)
    square = _blur(differences * differences, 1)
    relative = 1.0 + _noise_over_texture(square, np.float32(of_pixels * full**2))
    # Channels are rounded, and their mixture again.
    alike = _blur((float(weights.sum()) + 1.0) * _alike(np.sqrt(fine)), 1)
    in_gaps = 1.0 + _noise_over_texture(square, (of_pixels + alike) * full**2)
    weight = share / relative
    spread = _spread(weight, value, range_error, max(max_gap // _CELL, 1))
    along = guided(
        value, weight + _NO_MATCH * range_error**2 / spread, small, _RANGE_WINDOW, _FLAT)
    smooth = np.maximum(along[0] * small + along[1], _INFINITY)
    thickness = float(np.fmin.reduce(attenuation, initial=np.inf)) / smooth
    own = range_error**2 * relative
    variance = share * own * spread / (own + spread) + (1.0 - share) * (
        range_error**2 * in_gaps + spread)
    known = np.exp(-1.5 * variance * (thickness / smooth) ** 2)
    # Cells at the border of reliable range are mixed. Reliable range is not smoothed.
    known = cv2.erode(known, np.ones((3, 3), np.uint8))
    # Gaps are filled row by row, with steps between rows. Matches beside them keep depth edges.
    gaps = 1.0 - (1.0 - _NO_MATCH) * share
    inside = _resize(np.where(measured, np.float32(_NO_MATCH) * inverse, inverse), cells) / gaps
    filled = guided(inside, gaps, small, _GAP_WINDOW, _FLAT)
    trust = guided(known, np.ones_like(known), small, _KNOWN_WINDOW, _FLAT)
    slope, offset, gap_slope, gap_offset, known_slope, known_offset, sharp = (
        cv2.resize(plane, half, interpolation=cv2.INTER_LINEAR)
        for plane in (*along, *filled, *trust, known**4))
    smooth = slope * guide + offset
    smooth += sharp * (np.where(measured, inverse, gap_slope * guide + gap_offset) - smooth)
    known = np.clip(known_slope * guide + known_offset, 0.0, 1.0)
    return KnownRange(*(
        cv2.resize(plane, (width, height), interpolation=cv2.INTER_LINEAR)
        for plane in (1.0 / np.maximum(smooth, _INFINITY), known)))


def _resize(plane: Plane, size: tuple[int, int]) -> Plane:
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)


def _blur(plane: Plane, radius: int) -> Plane:
    side = 2 * radius + 1
    return np.asarray(
        cv2.blur(plane, (side, side), borderType=cv2.BORDER_REFLECT), np.float32)


def _noise_over_texture(square: Plane, noise: Any) -> Plane:
    """Variance of noise over that of texture along rows, on which matching depends.

    Texture is the variance of second differences, `square`, beyond twice that of noise. A linear
    change of light, as in open water, does not count, since it matches anywhere. `noise` is the
    variance of a cell's mean.
    """
    variance = np.asarray(_OF_NOISE * noise, np.float32)
    texture = square - 2.0 * variance
    return np.asarray(variance / np.maximum(texture, 1e-6 * variance), np.float32)


def _alike(deviation: Plane) -> Plane:
    """Variance of rounding that a cell's pixels share, so that their mean has it, in codes.

    Pixels that differ by half a code or more are rounded independently (dither: Widrow, Kollár and
    Liu 1996, doi:10.1109/19.492748); an even light has steps of a code. For one channel and the
    deviation before rounding, the series has exp(-4 π²k²σ²). Here the deviation is that of the grey
    of rounded channels, which is smaller than theirs: in simulated RGB cells the factor 2 gives the
    variance within 20 %, in grey ones up to twice as much.
    """
    order = np.float32(np.pi) * np.arange(1, 9, dtype=np.float32)
    return np.exp(-2.0 * np.multiply.outer(deviation, order) ** 2) @ (np.float32(0.5) / order**2)


def _spread(weight: Plane, value: Plane, error: float, reach: int) -> Plane:
    """Variance of inverse range in gaps, 1/m², from surrounding matches and the filled value."""
    near, mean, square = (
        _blur(plane, reach) + _FARTHER_COUNTS * _blur(plane, _FARTHER * reach)
        for plane in (weight, weight * value, weight * value * value))
    near_or_none = np.maximum(near, 1e-9)
    mean /= near_or_none
    spread = np.maximum(square / near_or_none - mean * mean, 0.0) + (value - mean) ** 2
    return np.asarray(
        spread + error**2 + mean * mean * (_NO_MATCH / (_NO_MATCH + near)), np.float32)
