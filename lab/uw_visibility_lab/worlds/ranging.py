# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Measured ranges: noise, scale, wrong patches, unmatched pixels, meshes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Map, Mask
from uw_visibility_lab.worlds.beliefs import draw, happens

REFERENCE_WIDTH = 320.0
"""Width of the image to which beliefs in px refer."""

# Lower limit of noisy disparities, px.
_LEAST_DISPARITY = 0.05
WINDOW = 7
"""Side of the window in which a matcher looks for texture, px."""


def measure_ranges(
    streams: Callable[[str], np.random.Generator], truth: Map, image: NDArray[Any],
    effects: tuple[str, ...],
) -> tuple[Map, float]:
    """Simulate a view's ranges as measured by a stereo matcher or a mesh.

    streams: random generator by purpose.
    truth: (H, W), true ranges, m; inf in open water.
    image: (H, W, 3), as recorded: pixels without texture are not matched.
    effects: active ones of ``draw.EFFECTS``; only those of ranges are used.
    Returns ranges, (H, W), m, NaN where unknown, and the declared standard deviation of range over
        range², 1/m; 0 for exact ranges.
    """
    width = truth.shape[1]
    known = np.isfinite(truth)
    ranges = np.where(known, truth, np.float32(np.nan))
    median = float(np.median(truth[known]))
    disparity_at_median = draw(streams("disparity"), "range.disparity") * width / REFERENCE_WIDTH
    product = disparity_at_median * median  # focal length times baseline, px m
    error = 0.0
    matched = known.copy()
    if "mesh" in effects:
        rng = streams("mesh")
        ranges = _mesh(rng, ranges, spans=happens(rng, "range.mesh_spans"))
        matched = np.isfinite(ranges)
    elif "unmatched" in effects and not known.all() and happens(
        rng := streams("open matched"), "range.open_matched"
    ):
        # Wrong matches in open water are in specks.
        specks = _blobs(rng, truth.shape, draw(rng, "range.wrong_size"), 0.1) & ~known
        ranges[specks] = median * np.float32(draw(rng, "range.wrong_factor"))
        matched |= specks
    if "disparity noise" in effects:
        rng = streams("disparity noise")
        sigma = draw(rng, "range.disparity_noise")
        noise = _correlated(rng, truth.shape, draw(rng, "range.disparity_noise_cell"))
        disparity = np.float32(product) / ranges + np.float32(sigma) * noise
        matched &= disparity > max(draw(rng, "range.least_disparity"), _LEAST_DISPARITY)
        ranges = np.float32(product) / np.maximum(disparity, np.float32(_LEAST_DISPARITY))
        error = sigma / product * draw(rng, "range.told_error")
    if "wrong patches" in effects:
        rng = streams("wrong patches")
        wrong = _blobs(
            rng, truth.shape, draw(rng, "range.wrong_size"), draw(rng, "range.wrong"))
        factor = np.float32(1.0 / draw(rng, "range.wrong_factor"))
        ranges[wrong] *= factor
    if "occlusion" in effects:
        matched &= ~occluded(truth, product)
    if "unmatched" in effects:
        rng = streams("unmatched")
        matched &= _textured(rng, image)
        matched &= ~_blobs(rng, truth.shape, WINDOW, draw(rng, "range.random_loss"))
    if "range scale" in effects:
        factor = np.float32(1.0 + draw(streams("range scale"), "range.scale"))
        ranges = ranges * factor
        error = error / float(factor)
    ranges[~matched] = np.nan
    return ranges.astype(np.float32, copy=False), float(error)


def occluded(truth: Map, product: float) -> Mask:
    """Mark the pixels of the left view that the right camera does not see.

    They are hidden by nearer ones, or beyond the right image's left edge.

    truth: ranges, m; inf in open water. product: focal length times baseline, px m.
    """
    place = np.arange(truth.shape[1], dtype=np.float32) - np.float32(product) / truth
    nearest = np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(truth.shape, bool)
    # Tolerance of half a pixel: slanted surfaces compress their pixels without hiding any.
    hidden[:, :-1] = nearest[:, 1:] < place[:, :-1] - 0.5
    return np.asarray(hidden | (place < 0.0))


def _mesh(rng: np.random.Generator, ranges: Map, *, spans: bool) -> Map:
    """Interpolate inverse range between random points; with `spans` over open water, too."""
    height, width = ranges.shape
    step = draw(rng, "range.mesh") * width / REFERENCE_WIDTH
    rows, columns = (max(round(n / step), 4) for n in (height, width))
    y = ((np.arange(rows)[:, np.newaxis] + rng.random((rows, columns))) * height / rows)
    x = ((np.arange(columns) + rng.random((rows, columns))) * width / columns)
    points = ranges[y.astype(int).clip(0, height - 1), x.astype(int).clip(0, width - 1)]
    seen = np.isfinite(points)
    inverse = np.where(seen, 1.0 / np.where(seen, points, 1.0), 0.0).astype(np.float32)
    weight = seen.astype(np.float32)
    # Unknown points get the mean of their known neighbours, step by step.
    for _ in range(max(rows, columns)):
        if seen.all() or not seen.any():
            break
        total, count = cv2.blur(inverse * weight, (3, 3)), cv2.blur(weight, (3, 3))
        new = ~seen & (count > 1e-4)
        inverse[new] = total[new] / count[new]
        weight[new] = 1.0
        seen = seen | new
    dense = cv2.resize(inverse, (width, height), interpolation=cv2.INTER_LINEAR)
    mesh = np.float32(1.0) / np.maximum(dense, np.float32(1e-6))
    if not spans:
        mesh[~np.isfinite(ranges)] = np.nan
    return np.asarray(mesh, np.float32)


def _textured(rng: np.random.Generator, image: NDArray[Any]) -> Mask:
    """Draw which pixels are matched: those whose local contrast exceeds the noise."""
    top = np.float32(1.0 / np.iinfo(image.dtype).max)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) * top
    steps = np.abs(grey[:, 2:] - np.float32(2.0) * grey[:, 1:-1] + grey[:, :-2])
    # Noise of second differences, from the least textured tenth of pixels, and rounding.
    least = float(np.quantile(steps[::3, ::3], 0.1)) * 1.5 + 0.5 / 255.0
    contrast = cv2.blur(np.abs(cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=0.25)), (WINDOW, WINDOW))
    level = np.float32(draw(rng, "range.texture") * least * 0.5)
    luck = np.exp(np.float32(0.4) * _correlated(rng, grey.shape, WINDOW))
    return np.asarray(contrast * luck > level)


def _correlated(
    rng: np.random.Generator, shape: tuple[int, ...], cell: float
) -> NDArray[np.float32]:
    """Draw Gaussian noise of standard deviation 1, interpolated between points `cell` px apart."""
    height, width = shape[:2]
    rows, columns = (max(int(n / cell), 2) for n in (height, width))
    small = rng.standard_normal((rows, columns), dtype=np.float32)
    if (rows, columns) == (height, width):
        return small
    smooth = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(smooth / smooth.std(), np.float32)


def _blobs(
    rng: np.random.Generator, shape: tuple[int, ...], size: float, share: float
) -> Mask:
    """Draw patches of some size in px that cover a share of the pixels."""
    noise = _correlated(rng, shape, size)
    level = np.quantile(noise[::3, ::3], min(max(share, 0.0), 1.0))
    return np.asarray(noise < level)
