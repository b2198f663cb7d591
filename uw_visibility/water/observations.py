# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Dark and bright envelopes of an image over range (eq. 4-5)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from uw_visibility.compute.jit import njit
from uw_visibility.images.pair import read_only
from uw_visibility.images.view import ColourSamples
from uw_visibility.water.histogram import CELL_BITS, CELLS, accumulate, take_quantiles
from uw_visibility.water.levels import LEVELS_16_BIT, LEVELS_OF_MEANS, levels

# Noise beyond the first of these, in 8-bit code values, would make up the dark
# envelope: the image is then filtered by a median, which also takes the flakes of
# marine snow. The quantiles move inwards, to the values below at the second.
NOISY = (0.6, 1.5)
MEDIAN_SIZE = 3
MEDIAN_NOISE_GAIN = 0.42
NOISY_DARK_QUANTILE = 0.004
NOISY_BRIGHT_FACTOR = 3.0
# The quantile that shows how steep the dark end of a bin is, over that of the envelope.
STEEPNESS_FACTOR = 10.0
STEEPNESS_FACTOR_OF_FEWEST = 4.0
# Calibration and fixed pattern that no filter takes, in 8-bit code values.
FIXED_PATTERN = 0.5
# How well the noise's part in the dark envelope is known.
SHIFT_UNCERTAINTY = 0.5

# Ranges beyond these quantiles are mostly wrong matches; they get no bin.
RANGE_QUANTILES = (0.005, 0.995)
RANGE_SAMPLES = 4096
# Beyond these, m, a range is an error of computation.
MIN_RANGE, MAX_RANGE = 1e-3, 1e5
# How far from a pixel edges matter, px: as far as the camera, and the median,
# blur; with measured ranges, as far as a matcher's window takes a surface's
# range beyond its edge.
MARGINS_EXACT = (1, 2)
MARGINS_FILTERED = (2, 4)
MARGINS_MEASURED = (3, 6)


@dataclass(frozen=True)
class Envelopes:
    """Dark and bright envelope of each channel over range.

    Attributes
    ----------
    range : (N,) float64 ndarray
        Mean range of the pixels in each bin, m, rising.
    count : (N,) int64 ndarray
        Pixels in each bin.
    dark, bright : (3, N) float64 ndarray
        Irradiance of the dark and of the bright envelope; NaN where too few
        pixels of the bin are unsaturated in that channel.
    dark_range : (3, N) float64 ndarray
        Mean range of the pixels that make up the dark envelope, m.
    step : (3, N) float64 ndarray
        Irradiance that one code value of the camera's spans at the dark envelope.
    deviation : (3, N) float64 ndarray
        Standard deviation of the dark envelope by rounding and noise.
    noise : (3,) float64 ndarray
        Standard deviation of the image's noise, in code values.
    pixels : int
        Pixels read that have a range inside the bins, away from edges.
    saturated, zero : (3,) float64 ndarray
        Fraction of those pixels in the highest level, and in the lowest.
    grey : bool
        Whether no pixel has any colour.
    limits : tuple of float
        Where the bins begin and end, m; twice 0 without ranges.
    range_error : float
        Standard deviation of range over its square, 1/m; 0 for exact ranges.
    """

    range: NDArray[np.float64]
    count: NDArray[np.int64]
    dark: NDArray[np.float64]
    dark_range: NDArray[np.float64]
    bright: NDArray[np.float64]
    step: NDArray[np.float64]
    deviation: NDArray[np.float64]
    noise: NDArray[np.float64]
    pixels: int
    saturated: NDArray[np.float64]
    zero: NDArray[np.float64]
    grey: bool
    limits: tuple[float, float] = (0.0, 0.0)
    range_error: float = 0.0


def quantile_of_known(values: NDArray[np.float64], quantile: float) -> NDArray[np.float64]:
    """Quantile over the bins that are known, (C, N) to (C,); NaN where none is."""
    result = np.full(len(values), np.nan)
    _quantiles_of_known(np.ascontiguousarray(values), quantile, result)
    return result


@njit(nogil=True)
def _quantiles_of_known(values: Any, quantile: float, result: Any) -> None:
    for c in range(len(values)):
        known = np.sort(values[c][np.isfinite(values[c])])
        if len(known) > 0:
            place = quantile * (len(known) - 1)
            below = int(place)
            above = min(below + 1, len(known) - 1)
            result[c] = known[below] + (place - below) * (known[above] - known[below])


def observe(
    samples: ColourSamples,
    range_map: NDArray[np.float32],
    valid: NDArray[np.bool_] | None,
    *,
    bins: int,
    min_pixels: int,
    edge_tolerance: float,
    dark_quantile: float,
    fewest_dark: float,
    bright_quantile: float,
    range_error: float = 0.0,
    plain: bool = False,
) -> Envelopes:
    """Bin pixels by range and take the quantiles of each bin and channel (eq. 4-5).

    Parameters
    ----------
    samples : ColourSamples
        The pixels, their transfer and noise.
    range_map : (H, W) float32 ndarray
        Range, m; NaN (or anything not above 0) where unknown.
    valid : (H, W) bool ndarray or None
        Pixels that may count; None for all.
    bins : int
        Range bins, of equal ratio.
    min_pixels : int
        Pixels that a bin needs.
    edge_tolerance : float
        Pixels are left out where the range beside them departs from a plane by
        more than this fraction, or is not known; see `accumulate`.
    dark_quantile, bright_quantile : float
        Quantiles of the envelopes, 0..1.
    fewest_dark : float
        Pixels below the dark envelope at least.
    range_error : float
        Standard deviation of range over its square, 1/m; 0 for exact ranges.
    plain : bool
        Whether to do as the paper does: equally wide bins of all pixels,
        without regard to edges and noise.

    Returns
    -------
    Envelopes
        Perhaps without any bin. Padded pixels (0 in all channels) do not
        count, nor do saturated channels.
    """
    image, noise, means = samples.pixels, samples.noise, samples.scale > 1
    table = levels(samples.transfer, image.dtype, LEVELS_OF_MEANS if means else LEVELS_16_BIT)
    code_8_bit = len(table.of_code) // 256
    left = np.zeros((3, 1)) if plain else noise[:, np.newaxis]
    worst = noise.max() / code_8_bit
    filtered = not plain and worst > NOISY[0]
    if filtered:
        # Read-only as all images are, or the kernel would be compiled once more, in flight.
        image = read_only(cv2.medianBlur(image, MEDIAN_SIZE))
        left = MEDIAN_NOISE_GAIN * left
        dark_quantile = max(
            dark_quantile, float(np.interp(worst, NOISY, (dark_quantile, NOISY_DARK_QUANTILE))))
        bright_quantile = 1.0 - (1.0 - bright_quantile) * float(np.interp(
            worst, NOISY, (1.0, NOISY_BRIGHT_FACTOR)))
    mask = np.ones((1, 1), np.bool_) if valid is None else valid
    low, high = _range_limits(range_map, mask, valid is not None)
    histogram = np.zeros((bins, 3, len(table.step)), np.int64)
    metres_per_cell = (high - low) / CELLS
    coloured = metres_per_cell > 0 and accumulate(
        image, range_map, _inverse(range_map), mask, valid is not None, table.of_code,
        np.float32(low), np.float32(1 / metres_per_cell), _bins_of_cells(low, high, bins, plain),
        np.float32(np.inf if plain else edge_tolerance), np.float32(range_error),
        (0, 0) if plain else _margins(range_error, filtered, samples), histogram,
    )
    counts = histogram >> CELL_BITS
    count = counts[:, 0].sum(axis=1)
    pixels = int(count.sum())
    share = 1.0 / max(pixels, 1)
    quantiles = _quantiles(counts, dark_quantile, fewest_dark)
    dark, dark_cell, steep, bright, step = np.empty((5, 3, bins))
    take_quantiles(
        histogram, table.edges, table.step, min_pixels,
        quantiles * np.maximum(counts[:, :, :-1].sum(axis=2).T, 1), bright_quantile,
        dark, dark_cell, steep, bright, step,
    )
    shift = _noise_shift(left * step, steep - dark, quantiles)
    deviation = np.sqrt(
        step**2 * (1 / 12 + (FIXED_PATTERN * code_8_bit) ** 2 + left**2)
        + (SHIFT_UNCERTAINTY * shift) ** 2)
    full = count >= min_pixels
    cells = (histogram[full, 0] & ((1 << CELL_BITS) - 1)).sum(axis=1) / count[full]
    mean_range = low + (cells + 0.5) * metres_per_cell
    return Envelopes(
        range=mean_range,
        count=count[full],
        dark=(dark + shift)[:, full],
        dark_range=np.tile(mean_range, (3, 1)) if plain
        else low + (dark_cell[:, full] + 0.5) * metres_per_cell,
        bright=(bright - ndtri(bright_quantile) * left * step)[:, full],
        step=step[:, full] * (code_8_bit if means else 1),
        deviation=deviation[:, full],
        noise=noise,
        pixels=pixels,
        saturated=counts[:, :, -1].sum(axis=0) * share,
        zero=counts[:, :, 0].sum(axis=0) * share,
        grey=pixels > 0 and not coloured,
        limits=(low, high),
        range_error=range_error,
    )


def _quantiles(
    counts: NDArray[np.int64], dark_quantile: float, fewest: float
) -> NDArray[np.float64]:
    """(2, 3, bins): quantile of the dark envelope and of its steepness's second point."""
    total = np.maximum(counts[:, :, :-1].sum(axis=2).T, 1)
    dark = np.minimum(np.maximum(dark_quantile, fewest / total), 0.5)
    steep = np.minimum(
        np.maximum(STEEPNESS_FACTOR * dark_quantile, STEEPNESS_FACTOR_OF_FEWEST * fewest / total),
        0.5)
    return np.stack((dark, np.maximum(steep, dark)))


def _noise_shift(
    noise: NDArray[np.float64], rise: NDArray[np.float64], quantiles: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Bias of the dark envelope by noise: how far it lies below the darkest light.

    Where the dark end is as steep as noise alone makes it, the envelope lies
    at the noise's own quantile; where the scene itself makes a long tail, the
    noise moves it by less, in proportion to the steepness.
    """
    outer, inner = -ndtri(quantiles)
    steepness = np.minimum((outer - inner) * noise / np.maximum(rise, 1e-9), 1.0)
    return np.asarray(outer * noise * steepness)


def _margins(range_error: float, filtered: bool, samples: ColourSamples) -> tuple[int, int]:
    margins = MARGINS_FILTERED if filtered else MARGINS_EXACT
    near, far = MARGINS_MEASURED if range_error > 0 else margins
    return samples.margin(near), samples.margin(far)


def _inverse(range_map: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        return np.asarray(np.float32(1) / range_map)


def _bins_of_cells(low: float, high: float, bins: int, plain: bool) -> NDArray[np.int32]:
    """Bin of each cell of range: of equal width, or of equal ratio."""
    place = (np.arange(CELLS) + 0.5) / CELLS
    if not plain:
        place = np.log1p(place * (high / low - 1)) / math.log(high / low)
    return (np.minimum(place, 1 - 1e-9) * bins).astype(np.int32)


def _range_limits(
    range_map: NDArray[np.float32], mask: NDArray[np.bool_], masked: bool
) -> tuple[float, float]:
    """Return where the bins begin and end, m; twice 0 without ranges."""
    stride = max(1, math.isqrt(range_map.size // RANGE_SAMPLES))
    ranges = range_map[::stride, ::stride]
    known = (ranges > MIN_RANGE) & (ranges < MAX_RANGE)
    if masked:
        known &= mask[::stride, ::stride]
    if not known.any():
        return 0.0, 0.0
    sorted_ranges = np.sort(ranges[known])
    last = len(sorted_ranges) - 1
    low, high = (float(sorted_ranges[round(q * last)]) for q in RANGE_QUANTILES)
    # A range equal to the upper limit belongs to the last bin.
    return low, high * (1 + 1e-6)
