# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Test whether an image and ranges show one scene, by edges of the image and steps of ranges."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.ndimage import maximum_filter, uniform_filter

from uw_visibility.images.arrays import Array, Image, RangeMap
from uw_visibility.images.cells import means

# Image and ranges are reduced to about this width, px, at which edges are a pixel or two wide.
COLUMNS = 160
# Side of the window with whose mean edges and steps are compared, px of the reduced image.
NEIGHBOURHOOD = 15
# Difference of ln range between two surfaces; larger steps count the same.
STEP = 0.1
# Least part of the pixels at such steps, both across and down, for a comparison: a plane has none,
# a floor up to the horizon or a row of walls has them in one direction only.
FEWEST_STEPS = 0.005
# Largest offset between edges and steps of one scene, px of the image: matched ranges reach beyond
# edges by half the width of what is compared.
TOLERANCE = 4
# Shifts to compare with, px of the reduced image: larger than the width of edges beside the offset,
# but within the same layout.
NEAR, FAR = 3, 25
# Shifts do not count if the steps' autocorrelation exceeds this part of its maximum.
ALIKE = 0.5
# Quantiles of the normal distribution with 4 %, and one in a million, beyond. A quarter of images
# with ranges of another scene have an estimate, so that at most 1 % of these images keep one.
BY_CHANCE, NEVER_BY_CHANCE = 1.75, 4.75


def show_one_scene(image: Image, ranges: RangeMap) -> bool:
    """Return whether an image and ranges (m, NaN where unknown) show one scene; True if unknown.

    Edges of the image and steps of the ranges are correlated for many shifts. If they show one
    scene, the correlation without a shift is larger than by chance, which the other shifts show.
    An image of white noise shows no scene.
    """
    light: NDArray[Any] = np.atleast_3d(image).astype(np.float32)
    if not _neighbours_alike(light):
        return False
    factor = max(1, round(ranges.shape[1] / COLUMNS))
    logarithm = _log_ranges(ranges, factor)
    if min(np.mean(np.abs(np.diff(logarithm, axis=k)) >= STEP) for k in (0, 1)) < FEWEST_STEPS:
        return True
    steps = np.minimum(_gradient(logarithm) / STEP, 1.0)
    offset = -(-TOLERANCE // factor)
    return _score(_centred(_edges(light, factor)), _centred(steps), offset) > BY_CHANCE


def _neighbours_alike(light: NDArray[Any]) -> bool:
    """Whether pixels correlate with those to their right; in pure noise they do not."""
    rest = light - light.mean(axis=(0, 1))
    power = np.mean(rest**2, axis=(0, 1))
    alike = np.mean(rest[:, 1:] * rest[:, :-1], axis=(0, 1))
    # An image of constant value has no power, and is not noise.
    noise = alike <= NEVER_BY_CHANCE * power / np.sqrt(rest[..., 0].size)
    return bool((power == 0.0).all() or not noise[power > 0.0].all())


def _edges(light: NDArray[Any], factor: int) -> Array:
    """Ranks of the image's gradients, 0 to 1, in the channel where they are largest."""
    reduced = np.atleast_3d(means(light, factor))
    steps = np.max([_gradient(channel) for channel in np.moveaxis(reduced, 2, 0)], axis=0)
    # Contrast falls with range, so gradients are divided by their local RMS.
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
    # A part of the pixels suffices for the median of large blocks.
    stride = max(1, factor // 3)
    blocks = blocks[:, ::stride, :, ::stride].swapaxes(1, 2).reshape(height, width, -1)
    known = np.where(np.isfinite(blocks) & (blocks > 0.0), blocks, np.nan)
    count = np.count_nonzero(np.isfinite(known), axis=2)
    # Sorting puts NaN last.
    middle = np.maximum(count - 1, 0)[..., np.newaxis] // 2
    median = np.take_along_axis(np.sort(known, axis=2), middle, axis=2)[..., 0]
    return np.asarray(np.log(median))


def _gradient(values: Array) -> Array:
    return np.hypot(np.diff(values, axis=0)[:, :-1], np.diff(values, axis=1)[:-1])


def _centred(values: Array) -> Array:
    """Values minus their local mean; 0 where unknown."""
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    part = uniform_filter(known.astype(np.float64), NEIGHBOURHOOD)
    mean = uniform_filter(filled, NEIGHBOURHOOD) / np.maximum(part, 1e-9)
    return np.where(known, filled - mean, 0.0)


def _score(edges: Array, steps: Array, offset: int) -> float:
    """Correlation without a shift minus the mean with shifts, in standard deviations of these.

    Each is the largest within an offset, px.
    """
    shape = (edges.shape[0], edges.shape[1])
    spectrum = rfft2(steps)
    correlation = irfft2(np.conj(spectrum) * rfft2(edges), s=shape)
    best = maximum_filter(correlation, 2 * offset + 1, mode="wrap")
    # A shift along a wall's edge hardly changes the steps, and does not count.
    own = irfft2(np.abs(spectrum) ** 2, s=shape)
    down, across = (np.minimum(np.arange(n), n - np.arange(n)) for n in shape)
    shift = np.maximum(down[:, np.newaxis], across)
    shifted = best[(shift > NEAR + offset) & (shift < FAR) & (own < ALIKE * own[0, 0])]
    if not shifted.size:
        return math.inf
    return float((best[0, 0] - shifted.mean()) / max(shifted.std(), 1e-9))
