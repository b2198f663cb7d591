# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Tracking of ground points under lamps, and their light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.images.view import View
from uw_visibility.optics.transfer import linear_table

# Half the width of the patch of ground around a point, m: a tracker prefers spots that differ from
# their surroundings, and drifts off them, so that the light of narrow patches drifts with range. At
# most a part of the image's height, at least so many px.
PATCH, WIDEST, NARROWEST = 0.16, 1 / 6, 2.0
# Ranges read along a patch's side; least part of them that is known and on the plane, and largest
# relative distance from the plane.
ACROSS, KNOWN_PART, OFF_PLANE = 9, 0.5, 0.1
# Largest saturated part of a patch; least mean irradiance.
SATURATED_PART, DARKEST = 0.01, 3.0 / 255
# Parts of the image, along and across.
TILES = 4


@dataclass(frozen=True)
class Sightings:
    """Points of the ground as frames saw them."""

    light: Array  # (N, 3), mean linear irradiance around the point, RGB
    direction: Array  # (N, 3), unit vectors of the lines of sight
    normal: Array  # (N, 3), unit vectors of the ground's normal, towards the camera
    range: Array  # (N,), m
    spread: Array  # (N,), half the width of the patch that the light is the mean of, over the range
    track: NDArray[np.int64]  # (N,), number of the point
    tile: NDArray[np.int64]  # (N,), its part of the image

    def where(self, chosen: Mask) -> Sightings:
        """Those that a mask (N,) chooses."""
        return Sightings(*(getattr(self, field.name)[chosen] for field in fields(self)))


def observe_points(
    irradiance: NDArray[np.float32], saturated: Mask, range_map: NDArray[np.float32], rays: Array,
    points: Array, tracks: NDArray[np.int64],
) -> Sightings:
    """Light and place of points (N, 2: column and row, px) in one image; bad ones are left out.

    Takes linear irradiance (H, W, 3), pixels with a saturated channel, range, m, NaN where unknown,
    unit directions (H, W, 3), and the numbers of the points, (N,).
    """
    height, width = range_map.shape
    size = np.array([width, height])
    # Focal length, px, from the rays.
    scale = 1.0 / float(np.linalg.norm(rays[height // 2, width // 2 + 1]
                                       - rays[height // 2, width // 2]))
    inside = ((points >= 0) & (points <= size - 1)).all(axis=1)
    points, tracks = points[inside], tracks[inside]
    column, row = np.rint(points.T).astype(int)
    distance = range_map[row, column].astype(np.float64)
    # The same ground in all frames.
    half = np.clip(
        PATCH * scale / np.where(distance > 0, distance, np.inf), NARROWEST, WIDEST * height)
    # The sum over a patch needs a pixel's edge beyond it.
    kept = (distance > 0) & (points >= half[:, None]).all(axis=1) & (
        points <= size - 1 - half[:, None]).all(axis=1)
    points, tracks, half, column, row = (each[kept] for each in (points, tracks, half, column, row))
    normal, distance, plane = _planes(range_map, rays, points, half)
    area = 4.0 * half**2
    light = _box_sums(irradiance, points, half) / area[:, None]
    clipped = _box_sums(saturated.astype(np.float32)[..., None], points, half)[:, 0] / area
    good = plane & (clipped <= SATURATED_PART) & (light.min(axis=1, initial=1.0) >= DARKEST)
    tile = row * TILES // height * TILES + column * TILES // width
    return Sightings(
        light, rays[row, column], normal, distance, half / scale, tracks, tile.astype(np.int64)
    ).where(good)


def _planes(
    ranges: NDArray[np.float32], rays: Array, points: Array, half: Array
) -> tuple[Array, Array, Mask]:
    """Unit normals towards the camera, ranges and validity of planes fitted around points.

    On a plane n·u = 1/d.
    """
    steps = np.linspace(-1.0, 1.0, ACROSS)
    columns = np.rint(points[:, :1] + half[:, None] * np.tile(steps, ACROSS)).astype(int)
    rows = np.rint(points[:, 1:] + half[:, None] * np.repeat(steps, ACROSS)).astype(int)
    away = rays[rows, columns]
    inverse = 1.0 / ranges[rows, columns].astype(np.float64)
    weight = np.isfinite(inverse).astype(np.float64)
    inverse = np.where(weight > 0, inverse, 0.0)
    enough = weight.mean(axis=1) >= KNOWN_PART
    plane = np.zeros((len(points), 3))
    for _ in range(2):
        weighted = away * weight[..., None]
        square = np.einsum("nki,nkj->nij", weighted, away) + 1e-9 * np.eye(3)
        plane = np.linalg.solve(square, np.einsum("nki,nk->ni", weighted, inverse)[..., None])[
            ..., 0]
        close = np.abs(np.einsum("nki,ni->nk", away, plane) - inverse) < OFF_PLANE * inverse
        weight = weight * close
    enough &= weight.mean(axis=1) >= KNOWN_PART
    middle = np.einsum("ni,ni->n", away[:, ACROSS**2 // 2], plane)
    enough &= middle > 0
    length = np.maximum(np.linalg.norm(plane, axis=1), 1e-12)
    return -plane / length[:, None], 1.0 / np.where(enough, middle, 1.0), enough


def _box_sums(image: NDArray[np.float32], points: Array, half: Array) -> Array:
    """Sum of (H, W, C) over squares around points, with parts of pixels, (N, C)."""
    summed = cv2.integral(image, sdepth=cv2.CV_64F).reshape(
        image.shape[0] + 1, image.shape[1] + 1, -1)
    # A pixel's middle is half a pixel from its edge.
    low, high = points + 0.5 - half[:, None], points + 0.5 + half[:, None]

    def at(x: Array, y: Array) -> Array:
        return np.stack([
            map_coordinates(summed[..., c], (y, x), order=1, mode="nearest")
            for c in range(summed.shape[2])], axis=1)

    return (at(high[:, 0], high[:, 1]) - at(low[:, 0], high[:, 1])
            - at(high[:, 0], low[:, 1]) + at(low[:, 0], low[:, 1]))


# Largest number of points, largest error of tracking forth and back, px, and the tracker's
# parameters.
MOST_POINTS, RETURN = 250, 0.5
FLOW: dict[str, Any] = {"winSize": (15, 15), "maxLevel": 4}
# Distance of points, as a part of the width, for calibration and for surveys.
CLOSE, WIDE = 1 / 32, 1 / 16
# Width to which frames of a survey are reduced at least, px: ground is compared by patches.
REDUCED_WIDTH = 240


class PointTracker:
    """Tracks points of the ground from frame to frame (Lucas and Kanade 1981).

    `first` is the number of the first track, `apart` the least distance of points over the image's
    width.
    """

    def __init__(self, first: int = 0, apart: float = CLOSE) -> None:
        self.next = first
        self._apart = apart
        self.points = np.zeros((0, 2), np.float32)
        self.tracks = np.zeros(0, np.int64)
        self._before: NDArray[np.uint8] | None = None

    def observe(
        self, irradiance: NDArray[np.float32], saturated: Mask, range_map: NDArray[np.float32],
        rays: Array,
    ) -> Sightings:
        """Follow the points into the next image, start new tracks, and observe all there.

        For what is given see `observe_points`.
        """
        image = _evened(irradiance)
        if self._before is not None and self._before.shape == image.shape and len(self.points):
            points = self.points.reshape(-1, 1, 2)
            there, seen, _ = cv2.calcOpticalFlowPyrLK(self._before, image, points, None, **FLOW)
            back, seen_back, _ = cv2.calcOpticalFlowPyrLK(image, self._before, there, None, **FLOW)
            away = np.linalg.norm((back - points)[:, 0], axis=1)
            kept = (seen[:, 0] & seen_back[:, 0]).astype(bool) & (away < RETURN)
            self.points, self.tracks = there[kept, 0], self.tracks[kept]
        else:
            self.points, self.tracks = self.points[:0], self.tracks[:0]
        free = np.full(image.shape, 255, np.uint8)
        apart = max(6, round(image.shape[1] * self._apart))
        for x, y in self.points:
            cv2.circle(free, (round(float(x)), round(float(y))), apart, 0, -1)
        fresh = cv2.goodFeaturesToTrack(image, MOST_POINTS, 0.02, apart, mask=free)
        if fresh is not None:
            self.points = np.concatenate([self.points, fresh.reshape(-1, 2)])
            numbers = np.arange(self.next, self.next + len(fresh), dtype=np.int64)
            self.tracks = np.concatenate([self.tracks, numbers])
            self.next += len(fresh)
        self._before = image
        return observe_points(
            irradiance, saturated, range_map, rays, self.points.astype(np.float64), self.tracks)


def _evened(irradiance: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Local contrast of ln green, which does not depend on the lamps' light."""
    logarithm = np.log(irradiance[..., 1] + np.float32(2.0 / 255))
    away = logarithm - cv2.GaussianBlur(logarithm, (0, 0), irradiance.shape[1] / 20)
    return np.asarray(np.clip(128 + 80 * away, 0, 255).astype(np.uint8))


@dataclass(frozen=True, eq=False)
class GroundView:
    """A frame at reduced size, in which a survey looks for known points of the ground."""

    irradiance: NDArray[np.float16]  # (h, w, 3), linear, RGB
    saturated: Mask  # (h, w)
    range: NDArray[np.float16]  # (h, w), m; NaN where unknown
    low: Array  # (2,), x/z and y/z of the line of sight through the middle of the first sample
    high: Array  # (2,), the same of the last sample
    range_error: float  # standard deviation of a match's inverse range, 1/m

    @classmethod
    def of(
        cls, view: View, range_map: NDArray[np.float32], rays: Callable[[Array, Array], Array],
        range_error: float,
    ) -> GroundView:
        """Reduce a colour view; `rays` gives unit directions, see `LampEstimator`."""
        assert view.colour is not None
        pixels = view.colour.pixels
        height, width = view.shape
        # Pixels of the camera along a sample's side.
        step = max(1, width // REDUCED_WIDTH)
        size = width // step, height // step
        top = np.iinfo(pixels.dtype).max
        _, clipped = cv2.threshold(pixels, top - 1, 255, cv2.THRESH_BINARY)
        codes = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        middles = np.s_[step // 2:step * size[1]:step, step // 2:step * size[0]:step]
        ranges = range_map[middles]
        if view.valid is not None:
            ranges = np.where(view.valid[middles], ranges, np.float32(np.nan))
        full = np.array([width, height])
        corners = rays(np.array([0, width - 1]), np.array([0, height - 1]))[[0, 1], [0, 1]]
        tangents = corners[:, :2] / corners[:, 2:]
        # From the middle of the first pixel to that of the first sample.
        inset = 0.5 * (full / size - 1.0) / (full - 1.0) * (tangents[1] - tangents[0])
        return cls(
            linear_table(view.transfer, pixels.dtype)[codes].astype(np.float16),
            cv2.resize(clipped, size, interpolation=cv2.INTER_AREA).any(axis=2),
            ranges.astype(np.float16), tangents[0] + inset, tangents[1] - inset,
            range_error)

    def observe(self, tracker: PointTracker) -> Sightings:
        """Light and place in the frame of the points that a tracker follows into it."""
        height, width = self.range.shape
        x = np.linspace(self.low[0], self.high[0], width)
        y = np.linspace(self.low[1], self.high[1], height)
        rays = np.stack(np.broadcast_arrays(x, y[:, np.newaxis], 1.0), axis=2)
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        return tracker.observe(
            self.irradiance.astype(np.float32), self.saturated, self.range.astype(np.float32), rays)
