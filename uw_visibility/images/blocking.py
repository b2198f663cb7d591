# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Blocking artefacts: whether pixels went through a JPEG that nobody told of."""

from __future__ import annotations

import numpy as np

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
    rows = plane[:: max(1, -(-height // ROWS))].astype(np.float32)
    rows *= np.float32(255.0 / np.iinfo(image.dtype).max)
    # How far the step from a pixel to the next departs from those beside it, summed over rows.
    step = np.diff(rows, axis=1)
    away = np.abs(np.float32(2) * step[:, 1:-1] - step[:, :-2] - step[:, 2:])
    course = np.minimum(away, np.float32(EDGE)).sum(axis=0)
    if course.sum() < LEAST:
        return 1.0
    means = np.array([course[(at - 2) % BLOCK :: BLOCK].mean() for at in range(BLOCK)])
    # The largest of the others: mosaics and resized images repeat every two or four pixels.
    return float(means[0] / max(means[1:].max(), 1e-9))
