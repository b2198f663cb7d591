# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Metrics of colours, disparities and confidence against the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, DisparityMap, Map
from uw_visibility.optics.transfer import to_linear

BINS = 10
"""Number of bins of confidence, from 0 to 1."""


def lab(image: NDArray[np.generic]) -> Map:
    """Convert RGB, (H, W, 3), to CIE 1976 L*a*b*; sRGB's primaries, white is D65 and has L* = 100.

    Code values are taken as sRGB, as is usual for colour differences of pictures; float32 is
    linear, 0..1.
    """
    return np.asarray(cv2.cvtColor(to_linear(image, "srgb"), cv2.COLOR_LRGB2LAB))


def colour_difference(first: NDArray[np.generic], second: NDArray[np.generic]) -> Map:
    """CIE 1976 colour difference ΔE*ab of each pixel, see `lab`; 2.3 is just noticeable."""
    return np.asarray(np.linalg.norm(lab(first) - lab(second), axis=-1))


def at_best_exposure(images: Sequence[Map], truth: Sequence[Map]) -> list[Map]:
    """Multiply all images by one gain, the least-squares fit to the truth."""
    product = sum(float(np.nansum(i * t)) for i, t in zip(images, truth, strict=True))
    square = sum(float(np.nansum(np.square(i))) for i in images)
    gain = np.float32(product / square if square > 0.0 else 1.0)
    return [gain * image for image in images]


def matched_fraction(disparity: DisparityMap) -> float:
    """Share of all pixels that have a disparity; the others are unmatched."""
    return float(np.isfinite(disparity).mean())


def correct_fraction(disparity: DisparityMap, truth: DisparityMap, tolerance: float = 1.0) -> float:
    """Share of correct disparities (px; unmatched is not correct), of pixels with known truth."""
    known = np.isfinite(truth)
    if not known.any():
        return float("nan")
    return float((np.abs(disparity[known] - truth[known]) <= tolerance).mean())


def bad_fraction(disparity: DisparityMap, truth: DisparityMap, tolerance: float = 1.0) -> float:
    """Share of wrong disparities, of the matched pixels whose truth is known; NaN if none is."""
    both = np.isfinite(truth) & np.isfinite(disparity)
    if not both.any():
        return float("nan")
    return float((np.abs(disparity[both] - truth[both]) > tolerance).mean())


def reliability(
    disparity: DisparityMap, confidence: Map, truth: DisparityMap, tolerance: float
) -> Array:
    """Count the pixels with matched and true disparity, px, by confidence (0 .. 1).

    Returns (3, BINS): their number, the sum of their confidence, and the number of right ones.
    Counts of several pairs can be added; see `reliability_rows`.
    """
    counted = np.isfinite(disparity) & np.isfinite(truth)
    rated = confidence[counted].astype(np.float64)
    right = np.abs(disparity[counted] - truth[counted]) <= tolerance
    place = np.clip((rated * BINS).astype(np.int64), 0, BINS - 1)
    return np.array([np.bincount(place, weight, BINS) for weight in (None, rated, right)], float)


def reliability_rows(counts: Array) -> list[dict[str, float]]:
    """Return a row for each bin with pixels: mean confidence, share of right ones, part of all.

    Confidence is calibrated if it equals the share of right disparities in every bin (Murphy and
    Winkler, 1977, doi:10.2307/2346866).
    """
    return [
        {"confidence": rated / pixels, "right": right / pixels, "part": pixels / counts[0].sum()}
        for pixels, rated, right in counts.T[counts[0] > 0].tolist()
    ]


def expected_error(rows: Sequence[Mapping[str, float]]) -> float:
    """Mean absolute difference of confidence and right share over pixels; NaN without any."""
    differences = [row["part"] * abs(row["confidence"] - row["right"]) for row in rows]
    return sum(differences) if rows else np.nan
