# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Synthetic pair with which every stage has work, to compile kernels before the first frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uw_visibility.optics.light_model import attenuate


def warm_up_pair(
    shape: tuple[int, int], dtype: np.dtype[Any], *, grey: bool = False
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return a pair of three planes under water, which every stage has work with."""
    height, width = shape
    texture = np.random.default_rng(0).random((height, width, 3))
    left, right = np.empty((2, height, width, 3))
    for part, disparity in enumerate((12, 8, 5)):
        rows = slice(part * height // 3, (part + 1) * height // 3)
        ranges = np.full(texture[rows].shape[:2], 16 / disparity)
        left[rows] = attenuate(texture[rows], ranges, (0.5, 0.3, 0.2), (1.0, 1.0, 1.0))
        right[rows] = np.roll(left[rows], -disparity, axis=1)
    scale = 0.8 * np.iinfo(dtype).max
    first, second = ((scale * image).astype(dtype) for image in (left, right))
    return (first[..., 1], second[..., 1]) if grey else (first, second)
