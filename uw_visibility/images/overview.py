# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Overview of a frame: before, after and range in colours, side by side, with a scale.

The lightness of Viridis rises, so that range is visible in grey prints and to the colour-blind.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import cv2
import numpy as np

from uw_visibility.images.arrays import DisparityMap, Image, Image8, RangeMap

# Colours cover disparities between these percentiles of the matched pixels, but none whose relative
# error exceeds `_MOST_ERROR`, since their range may be infinite.
DRAWN_SHARE = (1.0, 99.0)
_MOST_ERROR = 0.5
NOT_MATCHED = (0, 0, 0)

# Height of a line and width of a letter, px, and the picture's width from which both grow.
_LINE, _LETTER, _PLAIN_WIDTH = 16, 7, 480


def overview(
    image: Image, enhanced: Image, range_map: RangeMap, assumed: str, range_error: float
) -> Image8:
    """Put an image, the restored image, and the range (m, NaN is black) side by side.

    Titles are above; the text `assumed` and the scale of colours in metres are below. Colours are
    linear in inverse range, whose standard deviation is `range_error`, 1/m.
    """
    with np.errstate(divide="ignore"):
        inverse = np.asarray(1.0 / range_map, np.float32)
    known = np.isfinite(inverse)
    ends = colour_ends(inverse[known], range_error) if known.any() else None
    drawn = draw_disparity(inverse, *(ends or (0.0, 0.0)))
    return side_by_side(shown(image), shown(enhanced), drawn, ends, [assumed])


def colour_ends(values: DisparityMap, error: float) -> tuple[float, float]:
    """Return the values of the first and the last colour, for disparities or inverse ranges (N,).

    `error` is the values' standard deviation.
    """
    low, high = (float(end) for end in np.percentile(values, DRAWN_SHARE))
    low = max(low, error / _MOST_ERROR)
    return low, max(low, high)


def side_by_side(
    image: Image8, enhanced: Image8, drawn: Image8, ends: tuple[float, ...] | None,
    words: Sequence[str],
) -> Image8:
    """Put three pictures of a frame, (H, W, 3) RGB, in a row, with titles, text and a scale.

    ends: inverse ranges, 1/m, of the first and the last colour of `drawn`; None if nothing matched.
    words: lines of text below the first two pictures; long ones are wrapped.
    """
    width = image.shape[1]
    size = max(width / _PLAIN_WIDTH, 1.0)
    step = round(_LINE * size)
    letters = max(round(2 * width / (_LETTER * size)), 1)
    lines = [line for each in words for line in textwrap.wrap(each, letters)]
    above = np.zeros((step, 3 * width, 3), np.uint8)
    below = np.zeros((step * max(len(lines), 2), 3 * width, 3), np.uint8)
    restored = "not restored" if np.array_equal(image, enhanced) else "without the water"
    for column, title in enumerate(("as recorded", restored, "range; black: none")):
        _write(above, title, column * width, 0, size)
    for row, line in enumerate(lines):
        _write(below, line, 0, row, size)
    below[2:step - 2, 2 * width:] = viridis(np.linspace(0.0, 1.0, width)[np.newaxis])
    low, high = ends or (0.0, 0.0)
    free = 0.0
    for part in (0.0, 0.5, 1.0) if ends else ():
        far = 1.0 / max(low + part * (high - low), 1e-6)
        value = f"{np.format_float_positional(far, 2, fractional=False, trim='-')} m"
        value = value if part else f"over {value}"
        length = _LETTER * size * (len(value) + 1)
        start = part * max(width - length, 0.0)
        # A narrow picture has no room for all of them.
        if start >= free:
            _write(below, value, 2 * width + round(start), 1, size)
            free = start + length
    return np.concatenate((above, np.concatenate((image, enhanced, drawn), axis=1), below))


def _write(strip: Image8, text: str, x: int, row: int, size: float) -> None:
    cv2.putText(
        strip, text, (x + round(2 * size), round((_LINE * (row + 1) - 4) * size)),
        cv2.FONT_HERSHEY_SIMPLEX, 0.38 * size, (255, 255, 255), max(round(size), 1), cv2.LINE_AA)


def draw_disparity(disparity: DisparityMap, low: float, high: float) -> Image8:
    """Draw disparities, px, in colours from low to high; NaN is black."""
    known = np.isfinite(disparity)
    share = (np.where(known, disparity, low) - low) / max(high - low, 1e-6)
    drawn = viridis(np.clip(share, 0.0, 1.0))
    drawn[~known] = NOT_MATCHED
    return drawn


def viridis(share: Image) -> Image8:
    """Return colours, (H, W, 3) RGB, of values from 0 to 1, (H, W)."""
    coloured = cv2.applyColorMap((255.0 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return np.asarray(cv2.cvtColor(coloured, cv2.COLOR_BGR2RGB), np.uint8)


def shown(image: Image) -> Image8:
    """Convert an image to 8-bit RGB."""
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    return np.asarray(
        cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.ndim == 2 else image, np.uint8)
