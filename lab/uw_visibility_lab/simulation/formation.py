# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Image formation in simulated water: E = W ρ e^(−T) + B (1 − e^(−T)), and extensions.

T is the optical path: β times range, plus that of a layer or a plume. In water with a
spectrum, band averages replace the exponentials.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.images.arrays import Array, Map
from uw_visibility.optics import light_model
from uw_visibility.optics.light_model import attenuate
from uw_visibility_lab.simulation.view import View
from uw_visibility_lab.simulation.water import Water, WaterEffects

FEW_PIXELS = 20_000
"""Number of pixels that suffices to fit the effective attenuation."""

# Standard deviations of the blurred images, px; in between, images are interpolated.
_BLURS = (0.0, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)


def form_image(view: View, water: Water) -> Map:
    """Irradiance of an image."""
    effects = water.effects
    if effects == WaterEffects():
        return view.image(attenuate(
            view.radiance, view.ranges, water.attenuation(), water.ambient_light()))
    transmission, unveiled = path_transmission(view, water)
    rows, columns = view.shape
    seen = 1.0 + effects.veil_gradient * (0.5 - (view.pixel // columns + 0.5) / rows)
    direct, veil = (view.image(part.astype(np.float32)) for part in (
        water.scene_light() * view.radiance * transmission,
        water.ambient_light() * seen[:, np.newaxis] * (1.0 - unveiled)))
    if effects.blur > 0.0:
        direct = blur_by_range(direct, view.range, effects.blur)
    return direct + veil


def path_transmission(view: View, water: Water) -> tuple[Array, Array]:
    """Transmission of the scene's light, and 1 − veil / veil at infinity, each (n, 3).

    Both are e^(−T) where the water has no spectrum.
    """
    bands = water.bands()
    if bands is None:
        path = view.ranges.astype(np.float64)[:, np.newaxis]
        transmission = light_model.transmission(np.maximum(water.attenuation(), 1e-12), path)
        unveiled = transmission
    else:
        transmission, unveiled = bands.transmission(view.ranges), bands.unveiled(view.ranges)
    added = light_model.transmission(1.0, added_path(view, water.effects)[:, np.newaxis])
    return transmission * added, unveiled * added


def added_path(view: View, effects: WaterEffects) -> Array:
    """Optical path that layer and plume add to each sample, (n,)."""
    thickness, ranges = np.zeros(view.ranges.shape), view.ranges.astype(np.float64)
    if effects.layer > 0.0:
        thickness += effects.layer * path_below(view, effects.layer_height)
    if effects.plume > 0.0:
        columns = view.shape[1]
        inside = (view.pixel % columns + 0.5) / columns > 1.0 - effects.plume_share
        thickness[inside] += effects.plume * ranges[inside]
    return thickness


def path_below(view: View, top: float) -> Array:
    """Length of each line of sight below a height over the mean sea floor, m, (n,)."""
    above, rise = view.eye[2] - top, view.rays @ view.rotation[2]
    with np.errstate(divide="ignore"):
        crossing = np.where(rise == 0.0, np.inf, -above / rise)
    if above > 0.0:
        entered = np.where(rise < 0.0, crossing, 0.0)
        return np.where(rise < 0.0, np.maximum(view.ranges - entered, 0.0), 0.0)
    return np.where(rise > 0.0, np.minimum(view.ranges, crossing), view.ranges)


def blur_by_range(direct: Map, ranges: Map, blur: float) -> Map:
    """Blur by forward scattering: a Gaussian whose width grows with range, in px per m."""
    known = np.isfinite(ranges)
    farthest = float(ranges[known].max()) if known.any() else 0.0
    sigma = np.minimum(blur * np.where(known, ranges, farthest), _BLURS[-1])
    blurred = np.zeros_like(direct)
    for k, width in enumerate(_BLURS):
        # Weight of this blur in the linear interpolation; the sum over all is 1.
        weight = np.interp(sigma, _BLURS, np.eye(len(_BLURS))[k]).astype(np.float32)
        if not weight.any():
            continue
        image = cv2.GaussianBlur(direct, (0, 0), width) if width > 0.0 else direct
        blurred += weight[..., np.newaxis] * image
    return blurred


def effective_attenuation(view: View, water: Water) -> Array:
    """Effective attenuation: β (1/m, RGB) of the e^(−βd) that fits the transmission best.

    Least squares over the pixels that see the scene. It is the reference for estimates of one β
    per channel in water with a spectrum, or with a β that varies over the image. With a spectrum it
    depends on the ranges in view, since strongly attenuated wavelengths vanish first.
    """
    effects = water.effects
    seen = np.flatnonzero(np.isfinite(view.range))
    even = effects.water_type is None and effects.layer == 0.0 and effects.plume == 0.0
    if even or len(seen) == 0:
        return water.attenuation()
    few = seen[::max(1, len(seen) // FEW_PIXELS)]
    return fit_attenuation(view.ranges[few], path_transmission(view, water)[0][few])


def fit_attenuation(
    ranges: NDArray[np.floating], transmission: NDArray[np.floating]
) -> Array:
    """Least-squares β of transmissions, Σ (t − e^(−βd))², by Gauss-Newton steps.

    ranges: (n,), m. transmission: (n, C), 0..1. Returns (C,), 1/m.
    """
    d = np.asarray(ranges, np.float64)[:, np.newaxis]
    seen = np.asarray(transmission, np.float64)
    rate = np.maximum(-np.log(np.maximum(seen, 1e-12)) / d, 1e-9)
    # The result is between the least and the largest β of single pixels.
    low, high = rate.min(0), rate.max(0)
    beta = np.median(rate, axis=0)
    for _ in range(12):
        model = np.exp(-beta * d)
        slope = -d * model
        gain = (slope * (seen - model)).sum(0) / np.maximum((slope * slope).sum(0), 1e-300)
        beta = np.clip(beta + gain, low, high)
    return np.asarray(beta)
