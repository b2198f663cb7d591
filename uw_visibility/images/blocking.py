# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Blocking artefacts: whether pixels went through a JPEG that nobody told of."""

from __future__ import annotations

from typing import Any

import numpy as np

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Image

BLOCK = 8
# Rows that are looked at.
ROWS = 128
# Differences beyond so many 8-bit code values are edges of things, not of blocks.
EDGE = 20.0
# Sum of differences that is needed, in 8-bit code values: blank images show no blocks.
LEAST = 200.0

JPEG_BLOCKINESS = 1.08
"""Blockiness from which on pixels went through a JPEG: without one it is 1.02 at most."""


def blocking(image: Image) -> float:
    """Blockiness: third differences across the edges of JPEG's blocks over the largest within.

    About 1 without blocks; 1.1 and more after a JPEG of quality 90. Blocks begin at the image's
    first column: one that was resized or rectified since shows none.
    """
    height, width = image.shape[:2]
    if width < 4 * BLOCK:
        return 1.0
    plane = image if image.ndim == 2 else image[..., 1]
    # In floating point, so that there is one kernel for all kinds of pixels.
    rows = plane[:: max(1, -(-height // ROWS))].astype(np.float32)
    rows *= np.float32(255.0 / np.iinfo(image.dtype).max)
    course = np.zeros(width - 3, np.float32)
    _add_departures(rows, course)
    if course.sum() < LEAST:
        return 1.0
    means = np.array([course[(at - 2) % BLOCK :: BLOCK].mean() for at in range(BLOCK)])
    # The largest of the others: mosaics and resized images repeat every two or four pixels.
    return float(means[0] / max(means[1:].max(), 1e-9))


@njit(nogil=True)
def _add_departures(rows: Any, course: Any) -> None:
    """Add up over rows how far the step from a pixel to the next departs from those beside it."""
    edge, two = np.float32(EDGE), np.float32(2)
    for y in range(rows.shape[0]):
        row = rows[y]
        for x in range(course.size):
            before, step = row[x + 1] - row[x], row[x + 2] - row[x + 1]
            away = abs(two * step - before - (row[x + 3] - row[x + 2]))
            course[x] += away if away < edge else edge
