# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Check whether an image and ranges show one scene, by its edges and their steps."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.ndimage import maximum_filter, uniform_filter

from uw_visibility.images.arrays import Array, Image, RangeMap

# Both are reduced to about as many columns, at which edges are a pixel or two wide.
COLUMNS = 160
# Pixels of the reduced image in which an edge stands out, or does not.
NEIGHBOURHOOD = 15
# Surfaces are two where ranges differ by a tenth; a larger step is no more of an edge.
STEP = 0.1
# Part of the pixels at such steps, across and down alike, below which there is too little to
# compare: a plane has none, a floor up to the horizon or a row of walls has one direction alone.
FEWEST_STEPS = 0.005
# Pixels by which edges of one scene may miss one another.
TOLERANCE = 1
# Shifts to compare with, px: beyond the width of edges, and not so far that the layout is another.
NEAR, FAR = 4, 25
# Part of the steps that stay in place with a shift that is none.
ALIKE = 0.5
# Points of the normal distribution beyond which are 4 %, and one in a million. A quarter of
# images with ranges of another scene has an estimate: of them 1 % are asked for at most.
BY_CHANCE, NEVER_BY_CHANCE = 1.75, 4.75


def show_one_scene(image: Image, ranges: RangeMap) -> bool:
    """Whether an image and ranges (m, NaN where unknown) show one scene; True if unknown.

    Edges of the image and steps of the ranges are correlated for many shifts of one over the other.
    Those of one scene coincide without a shift, and more than by chance, which is how others
    correlate. Pixels unlike their neighbours (noise) show no scene.
    """
    light: NDArray[Any] = np.atleast_3d(image).astype(np.float32)
    if not _neighbours_alike(light):
        return False
    factor = max(1, round(ranges.shape[1] / COLUMNS))
    logarithm = _log_ranges(ranges, factor)
    if min(np.mean(np.abs(np.diff(logarithm, axis=k)) >= STEP) for k in (0, 1)) < FEWEST_STEPS:
        return True
    steps = np.minimum(_gradient(logarithm) / STEP, 1.0)
    return _score(_outstanding(_edges(light, factor)), _outstanding(steps)) > BY_CHANCE


def _neighbours_alike(light: NDArray[Any]) -> bool:
    """Whether pixels correlate with those to their right; in pure noise they do not."""
    rest = light - light.mean(axis=(0, 1))
    power = np.mean(rest**2, axis=(0, 1))
    alike = np.mean(rest[:, 1:] * rest[:, :-1], axis=(0, 1))
    # Of an image of one code no pixel differs.
    noise = alike <= NEVER_BY_CHANCE * power / np.sqrt(rest[..., 0].size)
    return bool((power == 0.0).all() or not noise[power > 0.0].all())


def _edges(light: NDArray[Any], factor: int) -> Array:
    """Ranks of the steps of light, in the channel with the largest, 0 to 1."""
    height, width = (length // factor for length in light.shape[:2])
    whole = light[: height * factor, : width * factor]
    reduced = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    steps = np.max([_gradient(c) for c in np.moveaxis(np.atleast_3d(reduced), 2, 0)], axis=0)
    # Light falls with range: steps are compared with those around them.
    around = np.sqrt(uniform_filter(steps**2, NEIGHBOURHOOD))
    order = np.argsort(steps / np.maximum(around, 1e-9), axis=None, kind="stable")
    ranks = np.empty(order.size)
    ranks[order] = np.linspace(0.0, 1.0, order.size)
    return ranks.reshape(steps.shape)


def _log_ranges(ranges: RangeMap, factor: int) -> Array:
    """Logarithm of the median range of each block; NaN where none is known."""
    height, width = (length // factor for length in ranges.shape)
    whole: NDArray[Any] = ranges[: height * factor, : width * factor]
    blocks: NDArray[Any] = whole.reshape(height, factor, width, factor)
    # Of large blocks some pixels tell the median.
    stride = max(1, factor // 3)
    blocks = blocks[:, ::stride, :, ::stride].swapaxes(1, 2).reshape(height, width, -1)
    known = np.where(np.isfinite(blocks) & (blocks > 0.0), blocks, np.nan)
    count = np.count_nonzero(np.isfinite(known), axis=2)
    # NaN is sorted behind numbers.
    middle = np.maximum(count - 1, 0)[..., np.newaxis] // 2
    median = np.take_along_axis(np.sort(known, axis=2), middle, axis=2)[..., 0]
    return np.asarray(np.log(median))


def _gradient(values: Array) -> Array:
    return np.hypot(np.diff(values, axis=0)[:, :-1], np.diff(values, axis=1)[:-1])


def _outstanding(values: Array) -> Array:
    """Values minus their local mean; 0 where unknown."""
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    part = uniform_filter(known.astype(np.float64), NEIGHBOURHOOD)
    mean = uniform_filter(filled, NEIGHBOURHOOD) / np.maximum(part, 1e-9)
    return np.where(known, filled - mean, 0.0)


def _score(edges: Array, steps: Array) -> float:
    """Correlation without a shift, in standard deviations of that with shifts."""
    shape = (edges.shape[0], edges.shape[1])
    spectrum = rfft2(steps)
    correlation = irfft2(np.conj(spectrum) * rfft2(edges), s=shape)
    best = maximum_filter(correlation, 2 * TOLERANCE + 1, mode="wrap")
    # A shift along a wall's edge leaves the steps where they were.
    own = irfft2(np.abs(spectrum) ** 2, s=shape)
    down, across = (np.minimum(np.arange(n), n - np.arange(n)) for n in shape)
    shift = np.maximum(down[:, np.newaxis], across)
    shifted = best[(shift > NEAR) & (shift < FAR) & (own < ALIKE * own[0, 0])]
    if not shifted.size:
        return math.inf
    return float((best[0, 0] - shifted.mean()) / max(shifted.std(), 1e-9))
