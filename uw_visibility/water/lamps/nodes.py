# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Frames under lamps reduced to nodes: patches of one surface each, with their light and slope."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.optics.lamps import ATTENUATIONS, RANGES, LampTables
from uw_visibility.water.blocks import Blocks

Indices = NDArray[np.int64]
Row = tuple[Indices, Array, int]

# Nodes of a frame, and of all frames of a survey. Of 200, 350 and 700 per frame, 350 were best in
# two renderers: smaller patches differ by objects, not by the water.
NODES, MOST_NODES = 350, 1400
# Largest relative differences of range: of a node's blocks from their median, and of nodes that are
# fitted by one plane.
ONE_SURFACE, ONE_PLANE = 0.08, 0.15
# Least part of a node's blocks that show its surface.
ENOUGH = 0.5
# Light of fewer code steps, or noise deviations, is biased by clipping at black, and brighter light
# by clipping at white. Deviation of ln irradiance for such nodes.
FAINT, BRIGHT, USELESS = 2.5, 0.9, 2.0
# Quantile of a node's blocks, and of the nodes of a frame, that is taken as white: a definition.
WHITE = 0.95
# Least noise, in steps of the codes.
LEAST_NOISE = 0.25


@dataclass(frozen=True)
class Nodes:
    """Nodes of a frame under lamps."""

    place: Indices  # (N, 2), row and column in the grid of nodes
    light: Array  # (N, 3), mean linear irradiance, RGB
    bright: Array  # (N, 3), irradiance of its brightest blocks of pixels, see `WHITE`
    variance: Array  # (N, 3), variance of ln irradiance by noise and clipping
    range: Array  # (N,), m
    direction: Array  # (N, 3), unit vectors of the lines of sight
    normal: Array  # (N, 3), unit vectors of the surface's normal, towards the camera
    log_scattered: Array  # (K, 3, N), ln S of `LampTables` there
    log_far: Array  # (K, 3), ln S at infinity in the image's middle

    def __post_init__(self) -> None:
        """Refuse arrays of inconsistent shape."""
        number = len(self.range)
        of_nodes = (self.light, self.bright, self.variance, self.direction, self.normal)
        fits = self.place.shape == (number, 2)
        fits &= all(part.shape == (number, 3) for part in of_nodes)
        fits &= self.log_scattered.shape == (len(ATTENUATIONS), 3, number)
        if not fits or self.log_far.shape != (len(ATTENUATIONS), 3):
            raise ValueError("nodes of frames under lamps do not fit one another")
        if not all(np.isfinite(part).all() for part in (*of_nodes, self.range, self.log_scattered)):
            raise ValueError("nodes of frames under lamps are not all finite")

    def every(self, step: int) -> Nodes:
        """Nodes of every so many-th row and column."""
        kept = (self.place % step == 0).all(axis=1)
        return Nodes(
            self.place[kept] // step, self.light[kept], self.bright[kept], self.variance[kept],
            self.range[kept], self.direction[kept], self.normal[kept],
            self.log_scattered[..., kept], self.log_far)


def reduce_to_nodes(blocks: Blocks, rays: Array, tables: LampTables) -> Nodes:
    """Average blocks of pixels over nodes, and fit a plane to each and its neighbours.

    `rays` (h, w, 3) are unit directions of the blocks' middles.
    """
    side = max(1, round(math.sqrt(blocks.range.size / NODES)))
    light, ranges, away = (_tiles(each, side) for each in (
        blocks.light, blocks.range[..., np.newaxis], rays))
    ranges = ranges[..., 0]
    known = np.isfinite(ranges) & np.isfinite(light[..., 0])
    middle = np.ma.median(np.ma.masked_array(ranges, ~known), axis=2).filled(np.inf)
    surface = known & (np.abs(ranges - middle[..., np.newaxis]) < ONE_SURFACE * np.where(
        np.isfinite(middle), middle, 0.0)[..., np.newaxis])
    count = surface.sum(axis=2)
    distance = _mean(ranges[..., np.newaxis], surface)[..., 0]
    shown = (count >= ENOUGH * side**2) & (distance > RANGES[0]) & (distance < RANGES[-1])
    normal = _normals(np.where(surface, ranges, 1.0), away, surface, distance, shown)
    place = np.argwhere(shown)
    irradiance = np.maximum(_mean(light, surface)[shown], 1e-6)
    noise = np.maximum(blocks.noise, LEAST_NOISE * blocks.step)
    samples = count[shown][:, np.newaxis] * blocks.size**2
    cut = (irradiance < FAINT * np.maximum(noise, blocks.step)) | (irradiance > BRIGHT)
    variance = (noise / irradiance) ** 2 / samples + USELESS**2 * cut
    direction = _mean(away, surface)[shown]
    # Blocks of other surfaces do not count.
    hidden = np.where(surface[..., np.newaxis], light, -np.inf)[shown]
    order = np.sort(hidden, axis=1)
    bright = order[:, max(round(WHITE * side**2) - 1, 0)]
    row, column = np.asarray((place + 0.5) * side * blocks.side - 0.5, np.float64).T
    far = tables.log_scattered[:, :, len(tables.rows) // 2, len(tables.columns) // 2, -1]
    return Nodes(
        place, irradiance, np.maximum(bright, irradiance), variance, distance[shown],
        direction / np.linalg.norm(direction, axis=1, keepdims=True), normal[shown],
        tables.scattered_at(column, row, distance[shown]), np.asarray(far, np.float64))


def _tiles(values: NDArray[np.floating], side: int) -> Array:
    """(H, W, C) as (H/side, W/side, side², C)."""
    height, width = values.shape[0] // side, values.shape[1] // side
    cut = values[: height * side, : width * side].astype(np.float64)
    tiles = cut.reshape(height, side, width, side, -1).swapaxes(1, 2)
    return tiles.reshape(height, width, side * side, -1)


def _mean(values: Array, counted: Mask) -> Array:
    """Mean over the counted blocks of each node, (h, w, C); 0 where there is none."""
    total = np.where(counted[..., np.newaxis], values, 0.0).sum(axis=2)
    return np.asarray(total / np.maximum(counted.sum(axis=2), 1)[..., np.newaxis])


def _normals(ranges: Array, rays: Array, surface: Mask, distance: Array, shown: Mask) -> Array:
    """Unit normals towards the camera, (h, w, 3): on a plane n·u = 1/d.

    Planes are fitted to the blocks of each node and of those neighbours that are as far.
    """
    square = np.einsum("hwnk,hwnl,hwn->hwkl", rays, rays, surface)
    right = np.einsum("hwnk,hwn->hwk", rays, surface / ranges)
    height, width = shown.shape
    pad = ((1, 1), (1, 1))
    squares, rights = (
        np.pad(each, (*pad, *((0, 0),) * (each.ndim - 2))) for each in (square, right))
    distances = np.pad(np.where(shown, distance, np.inf), pad, constant_values=np.inf)
    summed, total = np.zeros_like(square), np.zeros_like(right)
    for y in range(3):
        for x in range(3):
            beside = np.s_[y : y + height, x : x + width]
            alike = np.abs(distances[beside] - distance) < ONE_PLANE * distance
            summed += squares[beside] * alike[..., np.newaxis, np.newaxis]
            total += rights[beside] * alike[..., np.newaxis]
    size = np.trace(summed, axis1=2, axis2=3)[..., np.newaxis, np.newaxis]
    plane = np.linalg.solve(
        summed + (1e-6 * size + 1e-12) * np.eye(3), total[..., np.newaxis])[..., 0]
    return np.asarray(-plane / np.maximum(np.linalg.norm(plane, axis=2, keepdims=True), 1e-12))


class Details(NamedTuple):
    """Differences between the means of neighbouring patches, on every scale (Haar 1910).

    For white noise they are independent, with the noise's variance. Row i is the sum of
    ``weight[k] * value[node[k]]`` over k from ``first[i]`` to ``first[i + 1]``.
    """

    first: Indices
    node: Indices
    weight: Array
    level: Indices


def details_of(frames: Sequence[Indices]) -> Details:
    """Differences within frames, and between frames in the order of time.

    `frames` are `Nodes.place` of each; nodes are numbered through all frames.
    """
    rows: list[Row] = []
    first, levels = 0, 0
    wholes = []
    for place in frames:
        numbers = first + np.arange(len(place))
        first += len(place)
        wholes.append(numbers)
        # Places are halved until one square holds all.
        scales = int(place.max(initial=0)).bit_length()
        for level in range(scales):
            _add_squares(rows, place >> level, numbers, level)
        levels = max(levels, scales)
    while len(wholes) > 1:
        for one, other in zip(wholes[0::2], wholes[1::2], strict=False):
            _add(rows, one, other, levels)
        wholes = [np.concatenate(wholes[i : i + 2]) for i in range(0, len(wholes), 2)]
        levels += 1
    ends = np.cumsum([0] + [len(node) for node, _, _ in rows])
    none: Row = (np.zeros(0, np.int64), np.zeros(0), 0)
    nodes, weights, _ = zip(*(rows or [none]), strict=True)
    return Details(
        ends.astype(np.int64), np.concatenate(nodes), np.concatenate(weights),
        np.array([level for _, _, level in rows], np.int64))


def _add_squares(rows: list[Row], place: Indices, numbers: Indices, level: int) -> None:
    """Add the differences within squares of two by two: across, along and between diagonals."""
    square, inside = place // 2, place % 2
    key = square[:, 0] * (int(square[:, 1].max()) + 1) + square[:, 1]
    order = np.argsort(key, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
        row, column = inside[members].T
        mine = numbers[members]
        # n quarters have n − 1 independent differences.
        missing = len(set((2 * row + column).tolist())) - 1
        for side in (column, row, (row + column) % 2):
            if missing:
                missing -= _add(rows, mine[side == 0], mine[side == 1], level)


def _add(rows: list[Row], one: Indices, other: Indices, level: int) -> bool:
    """Add the difference of the means of two sets of nodes, unless one is empty."""
    if len(one) == 0 or len(other) == 0:
        return False
    scale = math.sqrt(len(one) * len(other) / (len(one) + len(other)))
    weight = np.repeat((scale / len(one), -scale / len(other)), (len(one), len(other)))
    rows.append((np.concatenate((one, other)), weight, level))
    return True
