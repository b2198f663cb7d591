# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Cells of lamp-lit frames, with the light of the lamps at their places."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uw_visibility.images.arrays import Array
from uw_visibility.optics.lamps import ATTENUATIONS, between
from uw_visibility.optics.light_model import transmission


@dataclass(frozen=True)
class Cells:
    """Cells of one frame or many, with the tables' light at their places.

    Attributes
    ----------
    range, count : (N,) float64 ndarray
        m; pixels.
    contrast, noise, mean, dark, bright : (3, N) float64 ndarray
        See `LampObservations`.
    log_direct, log_scattered : (K, 3, N) float64 ndarray
        ln D and ln S over that of the reference, at the tables' attenuations.
    log_reference, log_unit : (N,) float64 ndarray
        ln D of the reference, and ln S over it, the unit of `dark`.
    moved : (P, N) float64 ndarray
        Change of ln D by a standard deviation of each lamp's place and direction.
    log_far : (K, 3) float64 ndarray
        ln S at infinity in the image's middle, at the tables' attenuations.
    """

    range: Array
    count: Array
    contrast: Array
    noise: Array
    mean: Array
    dark: Array
    bright: Array
    log_direct: Array
    log_scattered: Array
    log_reference: Array
    log_unit: Array
    moved: Array
    log_far: Array

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit one another."""
        size = self.range.shape
        of_channels = (self.contrast, self.noise, self.mean, self.dark, self.bright)
        of_nodes = (self.log_direct, self.log_scattered)
        fits = len(size) == 1 and all(part.shape == (3, *size) for part in of_channels)
        fits &= all(part.shape == (len(ATTENUATIONS), 3, *size) for part in of_nodes)
        fits &= self.count.shape == self.log_reference.shape == self.log_unit.shape == size
        fits &= self.moved.shape[1:] == size and self.log_far.shape == (len(ATTENUATIONS), 3)
        if not fits:
            raise ValueError("cells of frames under lamps do not fit one another")

    def direct(self, beta: float, channel: int) -> tuple[Array, Array]:
        """ln D over the reference's, and the path L = −d ln D / dβ, m; each (N,)."""
        low, _, step = between(beta)
        path = (self.log_direct[low, channel] - self.log_direct[low + 1, channel]) / step
        return _interpolated(self.log_direct, beta, channel), path

    def scattered(self, beta: float, channel: int) -> Array:
        """S over the reference's D, (N,)."""
        return np.asarray(np.exp(_interpolated(self.log_scattered, beta, channel)))

    def daylight(self, beta: float) -> Array:
        """e^(−βd) over the reference's D, (N,)."""
        return np.asarray(transmission(beta, self.range) * np.exp(-self.log_reference))

    def far_scattered(self, attenuation: Array) -> Array:
        """S at infinity in the image's middle, (3,); NaN where β is."""
        return np.array([
            math.exp(_interpolated(self.log_far, beta, c)) for c, beta in enumerate(attenuation)])


def _interpolated(table: Array, beta: float, channel: int) -> Array:
    """A table over attenuation and channel, (K, 3, ...), at an attenuation, 1/m."""
    low, share, _ = between(beta)
    return np.asarray((1 - share) * table[low, channel] + share * table[low + 1, channel])
