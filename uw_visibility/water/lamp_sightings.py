# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Light of points of the ground that are tracked over frames."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Half the width of the ground about a point whose light is taken, m; that of the pixels whose
# ranges are; the part of these that is known; least mean irradiance.
PATCH, SLOPE, KNOWN_PART, DARKEST = 0.03, 8, 0.3, 3.0 / 255
# Parts of the image, along and across.
TILES = 4


@dataclass(frozen=True)
class Sightings:
    """Points of the ground as frames saw them.

    Attributes
    ----------
    light : (N, 3) float64 ndarray
        Mean linear irradiance about the point, RGB.
    direction, normal : (N, 3) float64 ndarray
        Unit vectors: line of sight, and the ground's normal, towards the camera.
    range : (N,) float64 ndarray
        m.
    track, tile : (N,) int64 ndarray
        Which point, and its part of the image.
    """

    light: Array
    direction: Array
    normal: Array
    range: Array
    track: NDArray[np.int64]
    tile: NDArray[np.int64]


def observe_points(
    irradiance: NDArray[np.float32], saturated: NDArray[np.bool_],
    range_map: NDArray[np.float32], rays: Array, points: Array, tracks: NDArray[np.int64],
) -> Sightings:
    """Light and place of points in one image; those without are left out.

    Parameters
    ----------
    irradiance : (H, W, 3) float32 ndarray
        Linear, RGB.
    saturated : (H, W) bool ndarray
        Pixels of which a channel is.
    range_map : (H, W) float32 ndarray
        m; NaN where unknown.
    rays : (H, W, 3) float64 ndarray
        Unit directions.
    points : (N, 2) float64 ndarray
        Column and row, px.
    tracks : (N,) int64 ndarray
        Which points they are.
    """
    height, width = range_map.shape
    # Focal length, px, from the rays.
    scale = 1.0 / float(np.linalg.norm(rays[height // 2, width // 2 + 1]
                                       - rays[height // 2, width // 2]))
    found = []
    for (x, y), track in zip(points, tracks, strict=True):
        i, j = round(x), round(y)
        around = np.s_[max(j - SLOPE, 0):j + SLOPE + 1, max(i - SLOPE, 0):i + SLOPE + 1]
        distance = float(np.nanmedian(range_map[around])) if np.isfinite(
            range_map[around]).mean() > KNOWN_PART else math.nan
        # The same ground in all frames.
        half = max(2, round(PATCH * scale / distance)) if distance > 0 else width
        if not (half <= i < width - half and half <= j < height - half):
            continue
        part = np.s_[j - half:j + half + 1, i - half:i + half + 1]
        light = irradiance[part].mean(axis=(0, 1), dtype=np.float64)
        normal = _normal(range_map[around], rays[around])
        if saturated[part].any() or light.min() < DARKEST or normal is None:
            continue
        found.append((light, rays[j, i], normal, distance, track,
                      j * TILES // height * TILES + i * TILES // width))
    if not found:
        none = np.zeros((0, 3))
        ids = np.zeros(0, np.int64)
        return Sightings(none, none, none, np.zeros(0), ids, ids)
    return Sightings(*(np.array(each) for each in zip(*found, strict=True)))


def _normal(ranges: NDArray[np.float32], rays: Array) -> Array | None:
    """Unit normal of a plane through points, towards the camera: n·u = 1/d on a plane."""
    known = np.isfinite(ranges)
    inverse = 1.0 / ranges[known].astype(np.float64)
    away = rays[known]
    normal = np.linalg.lstsq(away, inverse, rcond=None)[0]
    close = np.abs(away @ normal - inverse) < 0.1 * inverse
    if close.sum() < 0.5 * close.size:
        return None
    normal = np.linalg.lstsq(away[close], inverse[close], rcond=None)[0]
    return np.asarray(-normal / np.linalg.norm(normal))
