# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Tracking of points of the ground from frame to frame under lamps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Mask
from uw_visibility.images.view import View
from uw_visibility.optics.transfer import linear_table
from uw_visibility.water.lamps.sightings import Sightings, observe_points

# Points tracked at a time, how far one may come back from its own place, px, and the tracker's.
MOST_POINTS, RETURN = 250, 0.5
FLOW: dict[str, Any] = {"winSize": (15, 15), "maxLevel": 4}
# Distance of points, as a part of the width, for calibration and for surveys.
CLOSE, WIDE = 1 / 32, 1 / 16
# Width to which frames of a survey are reduced at least, px: ground is compared by patches.
REDUCED_WIDTH = 240


class PointTracker:
    """Tracks points of the ground from frame to frame (Lucas and Kanade 1981).

    Parameters
    ----------
    first : int
        Number of the first track.
    apart : float
        Least distance of the points, over the image's width.
    """

    def __init__(self, first: int = 0, apart: float = CLOSE) -> None:
        self.next = first
        self._apart = apart
        self.points = np.zeros((0, 2), np.float32)
        self.tracks = np.zeros(0, np.int64)
        self._before: NDArray[np.uint8] | None = None

    def follow(self, irradiance: NDArray[np.float32]) -> None:
        """Follow the points into the next image, (H, W, 3) linear RGB, and start new tracks."""
        image = _evened(irradiance)
        if self._before is not None and self._before.shape == image.shape and len(self.points):
            points = self.points.reshape(-1, 1, 2)
            there, seen, _ = cv2.calcOpticalFlowPyrLK(self._before, image, points, None, **FLOW)
            back, seen_back, _ = cv2.calcOpticalFlowPyrLK(image, self._before, there, None, **FLOW)
            away = np.linalg.norm((back - points)[:, 0], axis=1)
            kept = (seen[:, 0] & seen_back[:, 0]).astype(bool) & (away < RETURN)
            self.points, self.tracks = there[kept, 0], self.tracks[kept]
        elif self._before is not None:
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


def _evened(irradiance: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Local contrast of the logarithm of green, which the light of lamps does not change."""
    logarithm = np.log(irradiance[..., 1] + np.float32(2.0 / 255))
    away = logarithm - cv2.GaussianBlur(logarithm, (0, 0), irradiance.shape[1] / 20)
    return np.asarray(np.clip(128 + 80 * away, 0, 255).astype(np.uint8))


@dataclass(frozen=True, eq=False)
class GroundView:
    """A frame at reduced size, in which a survey looks for known points of the ground.

    Attributes
    ----------
    irradiance : (h, w, 3) float16 ndarray
        Linear, RGB.
    saturated : (h, w) bool ndarray
    range : (h, w) float16 ndarray
        m; NaN where unknown.
    low, high : (2,) float64 ndarray
        x/z and y/z of the lines of sight through the middles of the first and the last sample.
    """

    irradiance: NDArray[np.float16]
    saturated: Mask
    range: NDArray[np.float16]
    low: Array
    high: Array

    @classmethod
    def of(cls, view: View, range_map: NDArray[np.float32], rays: Array) -> GroundView:
        """Reduce a colour view.

        `rays` (Y, X, 3) are unit directions of a grid from the first to the last of the camera's
        pixels.
        """
        assert view.colour is not None
        pixels = view.colour.pixels
        height, width = view.shape
        # A sample holds so many of the camera's pixels along a row.
        step = max(1, width // REDUCED_WIDTH)
        size = width // step, height // step
        top = np.iinfo(pixels.dtype).max
        _, clipped = cv2.threshold(pixels, top - 1, 255, cv2.THRESH_BINARY)
        codes = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        ranges = range_map[step // 2::step, step // 2::step][:size[1], :size[0]]
        if view.valid is not None:
            known = view.valid[step // 2::step, step // 2::step][:size[1], :size[0]]
            ranges = np.where(known, ranges, np.float32(np.nan))
        corners = np.array([rays[0, 0], rays[-1, -1]])
        tangents = corners[:, :2] / corners[:, 2:]
        # From the middle of the first pixel to that of the first sample.
        full = np.array([width, height])
        inset = 0.5 * (full / size - 1.0) / (full - 1.0) * (tangents[1] - tangents[0])
        return cls(
            linear_table(view.transfer, pixels.dtype)[codes].astype(np.float16),
            cv2.resize(clipped, size, interpolation=cv2.INTER_AREA).any(axis=2),
            ranges.astype(np.float16), tangents[0] + inset, tangents[1] - inset)

    def rays(self) -> Array:
        """Unit directions of the samples, (h, w, 3)."""
        height, width = self.range.shape
        x = np.linspace(self.low[0], self.high[0], width)
        y = np.linspace(self.low[1], self.high[1], height)
        directions = np.stack(np.broadcast_arrays(x, y[:, np.newaxis], 1.0), axis=2)
        return np.asarray(directions / np.linalg.norm(directions, axis=2, keepdims=True))


class GroundTracker:
    """Finds the points of a survey's ground in frame after frame."""

    def __init__(self) -> None:
        self._tracker = PointTracker(apart=WIDE)

    def observe(self, ground: GroundView) -> Sightings:
        """Light and place of the points in the next frame."""
        irradiance = ground.irradiance.astype(np.float32)
        self._tracker.follow(irradiance)
        return observe_points(
            irradiance, ground.saturated, ground.range.astype(np.float32), ground.rays(),
            self._tracker.points.astype(np.float64), self._tracker.tracks)
