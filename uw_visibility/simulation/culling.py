# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Culling: lists of the shapes that rays may meet, by square tiles of the image."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uw_visibility.compute.jit import njit
from uw_visibility.simulation.camera import StereoCamera

TILE = 16
"""Width of a tile in px."""


class Tiles(NamedTuple):
    """Lists of shapes by tile, one after the other.

    Attributes
    ----------
    columns : int
        Tiles in a row of tiles.
    offsets : ndarray, shape (tiles + 1,), int64
        Where a tile's list starts in `shapes`.
    shapes : ndarray, shape (n,), int32
        Indices of shapes.
    """

    columns: int
    offsets: NDArray[np.int64]
    shapes: NDArray[np.int32]


def assign_to_tiles(
    bounds: NDArray[np.float64],
    camera: StereoCamera,
    eye: NDArray[np.float64],
    rotation: NDArray[np.float64],
    limit: float,
) -> Tiles:
    """List for each tile the shapes whose bounding sphere may show in it.

    Parameters
    ----------
    bounds : ndarray, shape (n, 4), float64
        Centre and radius of a sphere around each shape in m.
    camera : StereoCamera
        Size and focal length of the image.
    eye : ndarray, shape (3,), float64
        Position of the camera in m.
    rotation : ndarray, shape (3, 3), float64
        Axes of the optical frame as columns.
    limit : float
        Range in m beyond which nothing is seen.

    Returns
    -------
    Tiles
    """
    offset = bounds[:, :3] - eye
    radius = bounds[:, 3]
    x, y, z = (offset @ rotation).T
    seen = (z > -radius) & (np.linalg.norm(offset, axis=1) - radius < limit)
    index = np.flatnonzero(seen)
    x, y, z, radius = x[index], y[index], z[index], radius[index]
    near, far = np.maximum(z - radius, 1e-3), z + radius

    def span(middle: NDArray[np.float64], centre: float) -> NDArray[np.int64]:
        """Bound the projection of each sphere, in tiles."""
        low, high = middle - radius, middle + radius
        first = low / np.where(low < 0.0, near, far)
        last = high / np.where(high > 0.0, near, far)
        edges = np.stack([first, last]) * camera.focal_length + centre
        edges += np.array([[-1.0], [1.0]])
        return np.floor(np.clip(edges, -1e6, 1e6) / TILE).astype(np.int64)

    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    across = span(x, camera.principal_point[0])
    down = span(y, camera.principal_point[1])
    offsets, shapes = _lists(index, across, down, columns, rows)
    return Tiles(columns, offsets, shapes)


@njit(nogil=True, error_model="numpy")
def _lists(index: Any, across: Any, down: Any, columns: int, rows: int) -> tuple[Any, Any]:
    """Count each tile's shapes, then write them down."""
    offsets = np.zeros(columns * rows + 1, np.int64)
    for k in range(len(index)):
        for row in range(max(down[0, k], 0), min(down[1, k] + 1, rows)):
            for column in range(max(across[0, k], 0), min(across[1, k] + 1, columns)):
                offsets[row * columns + column + 1] += 1
    offsets = np.cumsum(offsets)
    shapes = np.empty(offsets[-1], np.int32)
    place = offsets.copy()
    for k in range(len(index)):
        for row in range(max(down[0, k], 0), min(down[1, k] + 1, rows)):
            for column in range(max(across[0, k], 0), min(across[1, k] + 1, columns)):
                tile = row * columns + column
                shapes[place[tile]] = index[k]
                place[tile] += 1
    return offsets, shapes
