# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""An image and its ranges, reduced to blocks of pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.images.arrays import Array, Mask
from uw_visibility.images.view import ColourSamples
from uw_visibility.optics.transfer import linear_table

# Largest number of blocks of an image: that of the networks' training views, so that patches of an
# image have the same size in blocks.
BLOCKS = 20_000
# Blocks of a frame that are kept for a survey.
BLOCKS_KEPT = 1500
# Least number of blocks with a range for an estimate, and of a bin of range.
FEWEST_BLOCKS = 600
FEWEST_OF_BIN = 24
# Largest relative difference of ranges in a block; beyond, it shows two surfaces.
MOST_RANGE_STEP = 0.1
# Largest ratio of a range to the median, or inverse: ranges beyond are wrong, or few.
WIDEST = 12.0
# Beyond these, m, a range is an error of computation.
MIN_RANGE, MAX_RANGE = 1e-3, 1e5
# Largest codes of cameras of fewer bits in images of 16 bits, in their low or in their high bits.
FULL_CODES = [2**bits - 1 for bits in (8, 10, 12, 14)] + [
    65536 - 2**(16 - bits) for bits in (8, 10, 12, 14)]
# Count of a black pixel where a clipped one counts 1, so that one sum holds both numbers.
MARK_OF_BLACK = 1 << 32


class Blocks(NamedTuple):
    """An image reduced to blocks."""

    # (h, w, 3), mean irradiance; NaN where a block holds pixels that do not count
    light: NDArray[np.float32]
    range: NDArray[np.float32]  # (h, w), mean range, m; NaN where unknown, or where surfaces meet
    known: float  # part of the counted blocks whose range is known, surfaces that meet among them
    clipped: Array  # (3,), part of the pixels that are saturated
    black: Array  # (3,), part of the pixels at the smallest code value
    noise: Array  # (3,), standard deviation of a sample's noise, irradiance at middle grey
    encoded: bool  # whether codes are sRGB
    deep: bool  # whether codes are of 16 bit
    side: int = 1  # side of a block, in pixels of the camera
    size: int = 1  # the same in samples, which are larger where colour is subsampled
    step: float = 1.0 / 255.0  # step of the camera's codes, as a part of full scale


def reduce_to_blocks(
    samples: ColourSamples, range_map: NDArray[np.floating], valid: Mask | None
) -> Blocks:
    """Average irradiance and range over blocks of pixels.

    `range_map` (H, W) is the range along the line of sight, m, of each sample, NaN where unknown;
    `valid` (H, W) are the samples that count, None for all.
    """
    return with_ranges(without_ranges(samples, valid), range_map)


def without_ranges(samples: ColourSamples, valid: Mask | None) -> Blocks:
    """Average irradiance over blocks of pixels, whose range is not known yet."""
    image = samples.pixels
    size = max(1, math.ceil(math.sqrt(image.shape[0] * image.shape[1] / BLOCKS)))
    light = np.empty((image.shape[0] // size, image.shape[1] // size, 3), np.float32)
    extreme = np.zeros((2, 3))
    table = linear_table(samples.transfer, image.dtype)
    marks = np.zeros(len(table), np.int64)
    marks[_saturated_from(samples):], marks[0] = 1, MARK_OF_BLACK
    mask = np.ones((1, 1), np.bool_) if valid is None else np.ascontiguousarray(valid)
    counted = _sum_up_light(image, mask, valid is not None, table, marks, size, light, extreme)
    share = 1.0 / max(counted * size * size, 1)
    middle = len(table) // 2
    return Blocks(
        light, np.full(light.shape[:2], np.nan, np.float32), 0.0, extreme[0] * share,
        extreme[1] * share, samples.noise * float(table[middle] - table[middle - 1]),
        samples.transfer == "srgb", len(table) > 256, size * samples.scale,
        size, 1.0 / (255 if samples.scale > 1 else len(table) - 1))


def _saturated_from(samples: ColourSamples) -> int:
    """Smallest code of a saturated sample."""
    top = np.iinfo(samples.pixels.dtype).max
    if top > 255 and (largest := int(samples.pixels.max())) in FULL_CODES:
        return largest
    # A codec blurs what was saturated: codes are within its noise of the largest.
    return int(top - samples.noise.max()) if samples.codec_known else top


def with_ranges(blocks: Blocks, range_map: NDArray[np.floating]) -> Blocks:
    """Blocks with the mean of their ranges; see `reduce_to_blocks`."""
    ranges = np.full_like(blocks.range, np.nan)
    counted, known = _average_ranges(
        np.ascontiguousarray(range_map, np.float32), blocks.light, blocks.size, ranges)
    return blocks._replace(range=ranges, known=known / max(counted, 1))


def away_from_edges(blocks: Blocks) -> Blocks:
    """Blocks without ranges next to a step of range, or to unknown range.

    Matched ranges reach beyond the edges of surfaces. All blocks are kept if few would be left.
    """
    ranges = blocks.range
    known = np.isfinite(ranges)
    beside = np.ones((3, 3))
    far = cv2.dilate(np.where(known, ranges, np.float32(np.inf)), beside)
    near = cv2.erode(np.where(known, ranges, np.float32(0.0)), beside)
    smooth = far - near <= np.float32(MOST_RANGE_STEP) * near
    left = known & smooth & np.isfinite(blocks.light[..., 0])
    if left.sum() < FEWEST_BLOCKS:
        return blocks
    return blocks._replace(range=np.where(left, ranges, np.float32(np.nan)))


def known_ranges(blocks: Blocks) -> tuple[Mask, NDArray[np.float32]]:
    """Blocks that count and have a range, (h, w) bool, and their ranges in rising order, m."""
    near = np.isfinite(blocks.range) & np.isfinite(blocks.light[..., 0])
    return near, np.sort(blocks.range[near])


def place_by_range(
    ranges: NDArray[np.float32], near: Mask, order: NDArray[np.float32], number: int
) -> tuple[NDArray[np.int8], Array, Array, tuple[float, float]]:
    """Bin of each block (−1 for none), mean range and count of each bin, and where bins end, m.

    Bins have equal shares in the mean of two measures: number of blocks, and logarithm of range. So
    neither many blocks at one range nor a few far blocks take all bins. `near` are the blocks that
    count, and `order` their ranges, see `known_ranges`; there is at least one.
    """
    last = len(order) - 1
    low, middle, high = (
        float(order[at]) for at in (int(0.005 * len(order)), len(order) // 2, int(0.995 * last)))
    low, high = max(low, middle / WIDEST), min(high, middle * WIDEST)
    grid = np.geomspace(low, max(high, low * 1.001), 128)
    measure = 0.5 * np.searchsorted(order, grid) / len(order) + 0.5 * np.linspace(0, 1, 128)
    measure = (measure - measure[0]) / (measure[-1] - measure[0])
    edges = np.interp(np.linspace(0, 1, number + 1), measure, grid)
    inside = near & (ranges >= np.float32(low)) & (ranges <= np.float32(high))
    placed = np.clip(np.searchsorted(edges, ranges[inside], "right") - 1, 0, number - 1)
    place = np.full(ranges.shape, -1, np.int8)
    place[inside] = placed
    count = np.bincount(placed, minlength=number).astype(np.float64)
    total = np.bincount(placed, ranges[inside], number)
    centres = np.sqrt(edges[1:] * edges[:-1])
    mean = np.where(count > 0, total / np.maximum(count, 1), centres)
    return place, mean, count, (float(low), float(high))


def thinned(blocks: Blocks, number: int) -> Blocks:
    """Blocks of evenly spaced rows, about `number` of them."""
    step = max(1, round(blocks.range.size / number))
    rows = slice(step // 2, None, step)
    return blocks._replace(light=blocks.light[rows].copy(), range=blocks.range[rows].copy())


def stacked(frames: Sequence[tuple[Blocks, Array]]) -> Blocks:
    """Blocks of frames of one size as those of one image, each with a gain of its channels.

    Rows of the frames alternate, so that upper blocks stay above lower ones.
    """
    parts = [blocks for blocks, _ in frames]
    light = np.stack([blocks.light * gain.astype(np.float32) for blocks, gain in frames], axis=1)
    together = np.stack([blocks.range for blocks in parts], axis=1)
    width = together.shape[2]
    return parts[-1]._replace(
        light=light.reshape(-1, width, 3), range=together.reshape(-1, width),
        known=float(np.mean([blocks.known for blocks in parts])),
        clipped=np.mean([blocks.clipped for blocks in parts], axis=0),
        black=np.mean([blocks.black for blocks in parts], axis=0),
        noise=np.mean([blocks.noise * gain for blocks, gain in frames], axis=0))


@njit(nogil=True)
def _sum_up_light(
    image: Any, mask: Any, masked: bool, table: Any, marks: Any, size: int, light: Any,
    extreme: Any,
) -> int:
    """Fill `light`; count clipped and black pixels, and blocks."""
    counted = 0
    for y in range(light.shape[0]):
        for x in range(light.shape[1]):
            rows, columns = slice(y * size, (y + 1) * size), slice(x * size, (x + 1) * size)
            # Scalars, since sums in an array take twice the time.
            red, green, blue, of_red, of_green, of_blue = 0.0, 0.0, 0.0, 0, 0, 0
            for row in image[rows, columns]:
                for u in range(size):
                    r, g, b = row[u]
                    red, of_red = red + table[r], of_red + marks[r]
                    green, of_green = green + table[g], of_green + marks[g]
                    blue, of_blue = blue + table[b], of_blue + marks[b]
            light[y, x] = np.nan
            if red + green + blue == 0.0 or (masked and not mask[rows, columns].all()):
                continue
            counted += 1
            for c, (total, marked) in enumerate(
                    ((red, of_red), (green, of_green), (blue, of_blue))):
                light[y, x, c] = total / (size * size)
                extreme[0, c] += marked % MARK_OF_BLACK
                extreme[1, c] += marked // MARK_OF_BLACK
    return counted


@njit(nogil=True)
def _average_ranges(range_map: Any, light: Any, size: int, ranges: Any) -> tuple[int, int]:
    """Fill `ranges` where they are known and alike; count blocks, and those with range."""
    counted, known = 0, 0
    for y in range(ranges.shape[0]):
        for x in range(ranges.shape[1]):
            if np.isnan(light[y, x, 0]):
                continue
            counted += 1
            near, far, total, number = np.inf, 0.0, 0.0, 0
            for v in range(y * size, (y + 1) * size):
                for u in range(x * size, (x + 1) * size):
                    distance = range_map[v, u]
                    if distance > MIN_RANGE and distance < MAX_RANGE:
                        near, far = min(near, distance), max(far, distance)
                        total += distance
                        number += 1
            if 2 * number > size * size:
                known += 1
                if far - near <= MOST_RANGE_STEP * near:
                    ranges[y, x] = total / number
    return counted, known
