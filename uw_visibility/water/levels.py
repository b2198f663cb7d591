# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Quantisation levels of irradiance for histograms of code values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.optics.transfer import linear_table

# 16-bit codes are counted in groups of 16: a group spans a sixteenth of an
# 8-bit step, and the histogram still fits into the cache.
LEVELS_16_BIT = 4096
# Means of 8-bit codes: theirs tell no finer.
LEVELS_OF_MEANS = 1024


@dataclass(frozen=True)
class Levels:
    """Quantisation levels: groups of code values that the histogram counts.

    Attributes
    ----------
    of_code : (256,) or (65536,) uint16 ndarray
        Level of each code value.
    edges : (L + 1,) float64 ndarray
        Irradiance at the levels' edges, half a code beyond their codes.
    step : (L,) float64 ndarray
        Irradiance that one code value spans.
    """

    of_code: NDArray[np.uint16]
    edges: NDArray[np.float64]
    step: NDArray[np.float64]


@lru_cache(maxsize=8)
def levels(transfer: str, dtype: Any, number: int = LEVELS_16_BIT) -> Levels:
    """Return the levels, at most `number`, of images of a type and transfer; see `Levels`."""
    irradiance = linear_table(transfer, dtype).astype(np.float64)
    group = len(irradiance) // min(len(irradiance), number)
    of_code = (np.arange(len(irradiance)) // group).astype(np.uint16)
    middles = 0.5 * (irradiance[1:] + irradiance[:-1])
    # The first and the last code span as much on their outer side.
    ends = 2 * irradiance[[0, -1]] - middles[[0, -1]]
    code_edges = np.concatenate((ends[:1], middles, ends[1:]))
    edges = code_edges[::group].copy()
    return Levels(of_code, edges, np.diff(edges) / group)
