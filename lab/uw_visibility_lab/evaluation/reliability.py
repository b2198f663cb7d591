# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Reliability of confidence: how many disparities are right, by how sure the matcher was.

Where the two agree in every bin, confidence is calibrated (Murphy and Winkler, 1977,
doi:10.2307/2346866).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, DisparityMap, Map

BINS = 10


@dataclass(frozen=True)
class Reliability:
    """Matched pixels with known truth in bins of confidence."""

    pixels: NDArray[np.int64]  # (BINS,); their number
    confidence: Array  # (BINS,); sum of their confidence
    right: NDArray[np.int64]  # (BINS,); those whose disparity is right

    @classmethod
    def of(
        cls, disparity: DisparityMap, confidence: Map,
        truth: DisparityMap, tolerance: float,
    ) -> Reliability:
        """Count the pixels with matched and true disparity, px, by confidence (0 .. 1)."""
        counted = np.isfinite(disparity) & np.isfinite(truth)
        rated = confidence[counted].astype(np.float64)
        right = np.abs(disparity[counted] - truth[counted]) <= tolerance
        place = np.clip((rated * BINS).astype(np.int64), 0, BINS - 1)
        return cls(
            np.bincount(place, minlength=BINS),
            np.asarray(np.bincount(place, rated, BINS), np.float64),
            np.bincount(place[right], minlength=BINS),
        )

    @classmethod
    def total(cls, parts: Iterable[Reliability]) -> Reliability:
        """Return the sum of several."""
        sums = cls(np.zeros(BINS, np.int64), np.zeros(BINS), np.zeros(BINS, np.int64))
        for part in parts:
            sums = cls(
                sums.pixels + part.pixels, sums.confidence + part.confidence,
                sums.right + part.right)
        return sums

    @property
    def expected_error(self) -> float:
        """Mean difference of confidence and right share over the pixels; NaN without any."""
        pixels = self.pixels.sum()
        return float(np.abs(self.confidence - self.right).sum() / pixels) if pixels else np.nan

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each bin with pixels: mean confidence, right share, part of all."""
        return [
            {
                "confidence": self.confidence[k] / self.pixels[k],
                "right": self.right[k] / self.pixels[k],
                "part": self.pixels[k] / self.pixels.sum(),
            }
            for k in np.flatnonzero(self.pixels)
        ]
