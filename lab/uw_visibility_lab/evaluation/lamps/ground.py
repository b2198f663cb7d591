# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The same ground in many frames: how much its colour varies from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Map
from uw_visibility_lab.simulation.camera import Pose, StereoCamera

CELL = 0.1
"""Width of a piece of ground, m."""

HALF_WIDTH = 0.6
"""Ground counts so far to either side of the way, m: beyond stand corals."""

WHOLE = 0.8
"""Share of a piece's pixels that a frame must show, of those that a level one has."""

FEWEST_VIEWS = 8
"""Frames that must show a piece."""

STEADY = 0.03
"""Largest variation of the true reflectance: what varies more is hidden in some frames."""

DARK = 0.05
"""Reflectance below which a piece's relative variation says little."""


def ground_cells(
    ranges: Map, camera: StereoCamera, pose: Pose, length: float
) -> NDArray[np.int64]:
    """Number of the piece of ground that each pixel sees; −1 for what does not count.

    Ground counts up to a length along x, m, and pieces that the frame shows whole.
    """
    rays = camera.rig.ray_directions((camera.height, camera.width))
    distance = np.where(np.isfinite(ranges), ranges, 0.0)[..., np.newaxis]
    points = distance * (rays @ pose.rotation().T) + pose.position
    column, row = (np.floor(points[..., k] / CELL).astype(np.int64) for k in (0, 1))
    columns, rows = round(length / CELL), round(HALF_WIDTH / CELL)
    inside = np.isfinite(ranges) & (column >= 0) & (column < columns)
    inside &= (row >= -rows) & (row < rows)
    cells = np.where(inside, (row + rows) * columns + column, -1)
    count = np.bincount(cells[inside], minlength=2 * rows * columns)
    depth = distance[..., 0] * rays[..., 2]
    total = np.bincount(cells[inside], depth[inside], minlength=len(count))
    level = (CELL * camera.focal_length * count / np.maximum(total, 1e-9)) ** 2
    part = count < WHOLE * level
    cells[inside & part[cells]] = -1
    return np.asarray(cells)


@dataclass(frozen=True)
class GroundCells:
    """Pieces of ground that several frames show whole."""

    cells: Sequence[NDArray[np.int64]]  # (H, W); by frame, see `ground_cells`
    steady: NDArray[np.bool_]  # (n, 3); pieces that count, by channel
    views: int  # median number of frames that see one

    @classmethod
    def of(cls, truth: Sequence[Map], cells: Sequence[NDArray[np.int64]]) -> GroundCells:
        """Choose the pieces of ground that look alike in the frames' true reflectance."""
        size = max(int(c.max()) for c in cells) + 1
        everything = cls(cells, np.ones((max(size, 1), 3), np.bool_), 0)
        means = everything.means(truth)
        views = np.isfinite(means[..., 1]).sum(axis=0)
        mean, deviation = _moments(means)
        steady = (views >= FEWEST_VIEWS)[:, np.newaxis] & (mean > DARK)
        steady &= deviation <= STEADY * mean
        seen = views[steady.any(axis=1)]
        return cls(cells, steady, int(np.median(seen)) if len(seen) else 0)

    @property
    def count(self) -> int:
        """Number of pieces that count."""
        return int(self.steady.any(axis=1).sum())

    def means(self, images: Sequence[Map]) -> Array:
        """Mean of each piece in each frame, (frames, n, 3); NaN where it is not seen."""
        size = len(self.steady)
        means = np.full((len(images), size, 3), np.nan)
        for k, (image, cells) in enumerate(zip(images, self.cells, strict=True)):
            known = (cells >= 0) & np.isfinite(image).all(axis=2)
            count = np.bincount(cells[known], minlength=size)
            seen = count > 0
            for c in range(3):
                total = np.bincount(cells[known], image[known][:, c], minlength=size)
                means[k, seen, c] = total[seen] / count[seen]
        return means

    def variation(self, images: Sequence[Map]) -> Array:
        """Standard deviation over mean of the same ground over the frames, RGB."""
        mean, deviation = _moments(self.means(images))
        relative = deviation / np.maximum(mean, 1e-9)
        return np.array([
            relative[self.steady[:, c], c].mean() if self.steady[:, c].any() else np.nan
            for c in range(3)
        ])


def _moments(means: Array) -> tuple[Array, Array]:
    """Mean and standard deviation over the frames that see a piece; 0 for none."""
    seen = np.isfinite(means)
    count = np.maximum(seen.sum(axis=0), 1)
    mean = np.where(seen, means, 0.0).sum(axis=0) / count
    square = np.where(seen, np.square(means - mean), 0.0).sum(axis=0) / count
    return mean, np.sqrt(square)
