# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image formation in simulated water: E = W ρ e^(−T) + B (1 − e^(−T)), and beyond.

T is the optical path: β times range, and what a layer or a plume adds. In water with a
spectrum, bands' averages take the place of the exponentials.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics import light_model
from uw_visibility.optics.light_model import attenuate
from uw_visibility_lab.simulation.view import View
from uw_visibility_lab.simulation.water import Water, WaterEffects

FEW_PIXELS = 20_000
"""Pixels that are enough to fit the effective attenuation to."""

# Steps of the standard deviation of blur, px; between them it is interpolated.
_BLURS = (0.0, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)


@dataclass(frozen=True)
class Geometry:
    """Viewing directions of an image's pixels."""

    rise: Array  # (H, W); upward component of the unit vector along each pixel's ray
    # column, row: (H, W); position in the image, 0 .. 1 from left to right and from top to bottom
    column: Array
    row: Array
    height: float  # height of the camera above the mean sea floor in m

    @classmethod
    def of_rays(cls, rays: Array, up: Array, height: float) -> Geometry:
        """Take unit rays, shape (H, W, 3), and the upward direction, in one frame."""
        rows, columns = rays.shape[:2]
        column, row = np.meshgrid(
            (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
        return cls(rays @ up, column, row, height)

    def at(self, pixels: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Geometry:
        """Return that of single pixels, shape (n, 1)."""
        rise, column, row = (
            part[pixels][:, np.newaxis] for part in (self.rise, self.column, self.row))
        return Geometry(rise, column, row, self.height)


def form_image(view: View, geometry: Geometry, water: Water) -> Map:
    """Irradiance of an image."""
    edges = view.edges
    if water.effects == WaterEffects():
        beta, ambient = water.attenuation(), water.ambient_light()
        irradiance = attenuate(view.radiance, view.range, beta, ambient)
        # A pixel at an edge is the mean of what its quarters see through the water.
        quarters = attenuate(view.edge_radiance, view.edge_range, beta, ambient)
        irradiance[edges] = quarters.mean(axis=1)
        return irradiance
    direct, veil = split_irradiance(view.radiance, view.range, geometry, water)
    parts = split_irradiance(view.edge_radiance, view.edge_range, geometry.at(edges), water)
    direct[edges], veil[edges] = (part.mean(axis=1) for part in parts)
    if water.effects.blur > 0.0:
        direct = blur_by_range(direct, view.range, water.effects.blur)
    return direct + veil


def split_irradiance(
    radiance: Map, ranges: Map, geometry: Geometry, water: Water
) -> tuple[Map, Map]:
    """Direct signal and veil, apart, each of shape (..., 3).

    See `form_image`; without the blur.
    """
    effects = water.effects
    transmission, unveiled = path_transmission(ranges, geometry, water)
    lit = 1.0 + effects.light_gradient * (geometry.column - 0.5)
    seen = 1.0 + effects.veil_gradient * (0.5 - geometry.row)
    direct = water.scene_light() * lit[..., np.newaxis] * radiance * transmission
    veil = light_model.veil_of(water.ambient_light() * seen[..., np.newaxis], unveiled)
    return direct.astype(np.float32), veil.astype(np.float32)


def path_transmission(ranges: Map, geometry: Geometry, water: Water) -> tuple[Array, Array]:
    """Transmission of the scene's light, and missing share of the veil, each (..., 3).

    Both are e^(−T) where the water has no spectrum.
    """
    bands = water.bands()
    if bands is None:
        path = np.asarray(ranges, dtype=np.float64)[..., np.newaxis]
        transmission = light_model.transmission(np.maximum(water.attenuation(), 1e-12), path)
        unveiled = transmission
    else:
        transmission, unveiled = bands.transmission(ranges), bands.unveiled(ranges)
    thickness = added_path(ranges, geometry, water.effects)[..., np.newaxis]
    added = light_model.transmission(1.0, thickness)
    return transmission * added, unveiled * added


def added_path(ranges: Map, geometry: Geometry, effects: WaterEffects) -> Array:
    """Optical path that layer and plume add, of the shape of the ranges."""
    path = np.zeros(np.shape(ranges))
    if effects.layer > 0.0:
        path += effects.layer * _below(
            np.asarray(ranges, dtype=np.float64), geometry, effects.layer_height)
    if effects.plume > 0.0:
        inside = np.broadcast_to(geometry.column > 1.0 - effects.plume_share, path.shape)
        path[inside] += effects.plume * np.asarray(ranges, dtype=np.float64)[inside]
    return path


def _below(ranges: Array, geometry: Geometry, top: float) -> Array:
    """Length of each line of sight that lies below a height, in m."""
    above = geometry.height - top
    with np.errstate(divide="ignore"):
        crossing = np.where(geometry.rise == 0.0, np.inf, -above / geometry.rise)
    if above > 0.0:
        sinking = geometry.rise < 0.0
        return np.where(sinking, np.maximum(ranges - np.where(sinking, crossing, 0.0), 0.0), 0.0)
    return np.where(geometry.rise > 0.0, np.minimum(ranges, crossing), ranges)


def blur_by_range(direct: Map, ranges: Map, blur: float) -> Map:
    """Blur by forward scattering: a Gaussian whose width grows with range, in px per m."""
    known = np.isfinite(ranges)
    farthest = float(ranges[known].max()) if known.any() else 0.0
    sigma = np.minimum(blur * np.where(known, ranges, farthest), _BLURS[-1])
    blurred = np.zeros_like(direct)
    for k, width in enumerate(_BLURS):
        # Of this step, in the interpolation between steps; the sum of weights is 1.
        weight = np.interp(sigma, _BLURS, np.eye(len(_BLURS))[k]).astype(np.float32)
        if not weight.any():
            continue
        image = cv2.GaussianBlur(direct, (0, 0), width) if width > 0.0 else direct
        blurred += weight[..., np.newaxis] * image
    return blurred


def effective_attenuation(ranges: Map, geometry: Geometry, water: Water) -> Array:
    """Effective attenuation: β (1/m, RGB) of the e^(−βd) that fits the transmission best.

    Least squares over the pixels that see the scene, by their ranges in m. It is what an estimate
    of one β per channel can be held to where the truth has a spectrum, or differs over the image:
    with a spectrum it depends on the ranges in view, since what water takes most is gone first.
    """
    effects = water.effects
    if effects.water_type is None and effects.layer == 0.0 and effects.plume == 0.0:
        return water.attenuation()
    seen = np.nonzero(np.isfinite(ranges))
    if len(seen[0]) == 0:
        return water.attenuation()
    step = max(1, len(seen[0]) // FEW_PIXELS)
    few = (seen[0][::step], seen[1][::step])
    distance = ranges[few].astype(np.float64)
    transmission, _ = path_transmission(ranges[few][:, np.newaxis], geometry.at(few), water)
    return fit_attenuation(distance, transmission[:, 0])


def fit_attenuation(
    ranges: NDArray[np.floating], transmission: NDArray[np.floating]
) -> Array:
    """Least-squares β of transmissions, Σ (t − e^(−βd))², by Gauss-Newton steps.

    Parameters
    ----------
    ranges : (n,) ndarray
        m.
    transmission : (n, C) ndarray
        0..1.

    Returns
    -------
    (C,) float64 ndarray
        1/m.
    """
    d = np.asarray(ranges, np.float64)[:, np.newaxis]
    seen = np.asarray(transmission, np.float64)
    rate = np.maximum(-np.log(np.maximum(seen, 1e-12)) / d, 1e-9)
    # Between the least and the largest of the pixels' own.
    low, high = rate.min(0), rate.max(0)
    beta = np.median(rate, axis=0)
    for _ in range(12):
        model = np.exp(-beta * d)
        slope = -d * model
        gain = (slope * (seen - model)).sum(0) / np.maximum((slope * slope).sum(0), 1e-300)
        beta = np.clip(beta + gain, low, high)
    return np.asarray(beta)
