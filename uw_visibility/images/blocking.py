# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Blocking artefacts: whether pixels went through a JPEG that nobody told of."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK = 8
# Rows that are looked at.
ROWS = 128
# Differences beyond so many 8-bit code values are edges of things, not of blocks.
EDGE = 20.0
# Sum of differences that is needed, in 8-bit code values: blank images show no blocks.
LEAST = 200.0

BLOCKS = 1.08
"""Blockiness from which on pixels went through a JPEG: without one it is 1.02 at most."""


def blocking(image: NDArray[Any]) -> float:
    """Blockiness: third differences across the edges of JPEG's blocks over the largest within.

    Parameters
    ----------
    image : (H, W, 3) or (H, W) uint8 or uint16 ndarray
        RGB or grey code values; blocks begin at its first column.

    Returns
    -------
    float
        About 1 without blocks; 1.1 and more after a JPEG of quality 90. An image that was resized
        or rectified since shows none.
    """
    height, width = image.shape[:2]
    if width < 4 * BLOCK:
        return 1.0
    green = image if image.ndim == 2 else image[..., 1]
    green = green[:: max(1, -(-height // ROWS))].astype(np.float32)
    green *= np.float32(255.0 / np.iinfo(image.dtype).max)
    step = np.diff(green, axis=1)
    # Between a pixel and the next: how far the step departs from those beside it.
    away = np.minimum(np.abs(2.0 * step[:, 1:-1] - step[:, :-2] - step[:, 2:]), EDGE)
    course = away.sum(axis=0)
    phase = (np.arange(len(course)) + 2) % BLOCK
    if course.sum() < LEAST:
        return 1.0
    means = np.array([course[phase == at].mean() for at in range(BLOCK)])
    # The largest of the others: mosaics and resized images repeat every two or four pixels.
    return float(means[0] / max(means[1:].max(), 1e-9))
