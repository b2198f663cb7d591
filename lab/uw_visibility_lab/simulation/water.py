# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated water: the paper's model, and departures of real water from it.

A water type has a spectrum, which is integrated over wavelength with a camera's response:

E_c = ∫ s_c(λ) L(λ) (ρ_c e^(−β(λ)d) + ω(λ) (1 − e^(−β(λ)d))) dλ with the camera's response s_c,
daylight at depth L(λ) = I0(λ) e^(−K(λ)z), attenuation β = a + b', diffuse attenuation
K = a + b_b, and the veil's spectrum ω = b'/β: scattering raises it, absorption lowers it
(Akkaynak and Treibitz, CVPR 2018, doi 10.1109/CVPR.2018.00703). Here b' = (1 − `KEPT`) b is the
scattering that a camera loses. The reflectance ρ_c is constant over the channel's band.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError, check_range
from uw_visibility.images.arrays import Array
from uw_visibility.optics.light_model import transmission
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.optics.water_type import (
    BACKSCATTERED,
    KEPT,
    WAVELENGTHS,
    clear_water,
    daylight_response,
    inherent_properties,
    water_types,
)
from uw_visibility_lab.simulation.camera import Triple

RESPONSE = "nikon_d5100"
"""The simulated camera's spectral response: the package's default."""

CLEAR_WATER = clear_water_attenuation(load_response(RESPONSE))
"""Attenuation of clear sea water as this camera sees it, RGB, 1/m."""

EXPOSED = 0.8
"""Irradiance of white in the strongest channel with automatic exposure."""

DEEPEST = 11_000.0
"""Depth of the deepest sea, m."""

CLEAR = "clear"
"""Name of clear sea water among the water types."""

_PATHS = np.concatenate([[0.0], np.geomspace(0.02, 400.0, 400)])


def spectral_types() -> list[str]:
    """Return the names of the waters whose spectra are known."""
    return [CLEAR, *water_types()]


@dataclass(frozen=True)
class BandAverages:
    """Band-averaged transmission of a water's spectrum in a camera's channels."""

    light: Array  # (3,); daylight at depth, relative to that at the surface
    log_transmission: Array  # (n, 3); logarithm of the band-averaged transmission over `_PATHS`
    log_unveiled: Array  # (n, 3); logarithm of 1 − veil / veil at infinity, over `_PATHS`

    def transmission(self, ranges: NDArray[np.floating]) -> Array:
        """Return the band-averaged transmission, shape (..., 3); 0 at infinity."""
        return self._interpolate(ranges, self.log_transmission)

    def unveiled(self, ranges: NDArray[np.floating]) -> Array:
        """Return 1 − veil / veil at infinity, shape (..., 3), 0 .. 1."""
        return self._interpolate(ranges, self.log_unveiled)

    def _interpolate(self, ranges: NDArray[np.floating], table: Array) -> Array:
        flat = np.asarray(ranges, dtype=np.float64).ravel()
        values = np.stack([np.exp(np.interp(flat, _PATHS, table[:, c])) for c in range(3)], 1)
        values[np.isinf(flat)] = 0.0
        return values.reshape((*np.shape(ranges), 3))


@lru_cache(maxsize=16)
def band_averages(water_type: str, depth: float, particles: float = 0.0) -> BandAverages:
    """Integrate a water's spectrum with the camera's response.

    water_type: ``clear`` (Smith and Baker 1981) or a Jerlov type (Williamson and Hollins 2022).
    particles: added scattering by grey particles, 1/m.
    """
    absorption, scattering, backscattering = _spectrum(water_type)
    scattering = scattering + particles
    beam = absorption + scattering
    diffuse = absorption + backscattering + BACKSCATTERED * particles
    surface = daylight_response(load_response(RESPONSE))
    weights = surface * np.exp(-diffuse * depth)[:, np.newaxis]
    light = weights.sum(axis=0) / surface.sum(axis=0)
    veil_weights = weights * (scattering / beam)[:, np.newaxis]
    decay = np.exp(-np.outer(_PATHS, beam))
    # The logarithm of no light is clipped; where all is gone, `Transect` refuses the depth.
    with np.errstate(divide="ignore", invalid="ignore"):
        transmission, unveiled = (
            np.maximum(np.log(decay @ w / w.sum(axis=0)), -700.0)
            for w in (weights, veil_weights)
        )
    return BandAverages(light, transmission, unveiled)


def _spectrum(water_type: str) -> tuple[Array, Array, Array]:
    """Absorption, scattering that a camera loses, and backscattering, by wavelength, 1/m."""
    if water_type == CLEAR:
        absorption, scattering = clear_water(WAVELENGTHS)
        # As in K_w = a_w + b_sw / 2: light that molecules scatter forwards is not lost.
        return absorption, 0.5 * scattering, 0.5 * scattering
    absorption, scattering = inherent_properties(water_type, WAVELENGTHS)
    return absorption, (1.0 - KEPT) * scattering, BACKSCATTERED * scattering


@dataclass(frozen=True)
class WaterEffects:
    """Departures of the water from the paper's model; by default none."""

    # ratio B/W of the veil at infinity to the light on the scene, RGB
    veil: Triple = (1.0, 1.0, 1.0)
    # ``clear``, or a Jerlov type from IB to 5C: integrates over wavelength, see `band_averages`.
    # None: one coefficient per channel
    water_type: str | None = None
    # forward scattering: standard deviation of a point's image in px per m of range
    blur: float = 0.0
    layer: float = 0.0  # attenuation that grey particles add below ``layer_height`` in 1/m
    layer_height: float = 1.0  # height of the layer's top above the mean sea floor in m
    plume: float = 0.0  # attenuation that grey particles add in a part of the view in 1/m
    plume_share: float = 0.5  # width of that part, at the right, as a share of the image's, 0 .. 1
    # relative change of the veil from the bottom of the image to its top
    veil_gradient: float = 0.0

    def __post_init__(self) -> None:
        for name, largest, unit in (
            ("blur", 20.0, "px/m"), ("layer", 10.0, "1/m"), ("plume", 10.0, "1/m"),
            ("plume_share", 1.0, ""),
        ):
            check_range(name.replace("_", " "), getattr(self, name), 0.0, largest, unit)
        check_range("veil gradient", self.veil_gradient, -1.9, 1.9)
        check_range("layer height", self.layer_height, -1e6, 1e6, "m")
        check_range("ratios of the veil", self.veil, 0.0, 10.0, above=True)
        if self.water_type is not None and self.water_type not in spectral_types():
            raise InputError(
                f"no water type {self.water_type!r}: give one of {', '.join(spectral_types())}"
            )


@dataclass(frozen=True)
class Water:
    """Clear sea water with grey particles, and departures from the paper's model."""

    mean_attenuation: float  # attenuation by grey particles α in 1/m, the same in all channels
    depth: float  # depth of the camera in m
    # gain from light (1: white at the surface) to irradiance in the image; None: the brighter of
    # white and open water has 0.8 in the strongest channel
    exposure: float | None = None
    effects: WaterEffects = WaterEffects()  # departures from the paper's model

    def __post_init__(self) -> None:
        check_range("mean attenuation", self.mean_attenuation, 0.0, unit="1/m")
        check_range("depth, positive down,", self.depth, 0.0, DEEPEST, unit="m")
        if self.exposure is not None:
            check_range("exposure", self.exposure, 0.0, above=True)

    def attenuation(self) -> Array:
        """Return β in 1/m, RGB, without layer and plume; for a spectrum that at range zero."""
        bands = self.bands()
        if bands is not None:
            return np.asarray(-bands.log_transmission[1] / _PATHS[1])
        return np.asarray(CLEAR_WATER + self.mean_attenuation)

    def scene_light(self) -> Array:
        """Return W, the light on the scene at the camera's depth, as irradiance in the image."""
        bands = self.bands()
        light = (
            transmission(self.attenuation(), self.depth) if bands is None
            else bands.light)
        brightest = (light * np.maximum(self.effects.veil, 1.0)).max()
        gain = EXPOSED / brightest if self.exposure is None else self.exposure
        return np.asarray(gain * light)

    def ambient_light(self) -> Array:
        """Return the veil B at infinity, the colour of open water; the paper's I∞."""
        return np.asarray(self.scene_light() * self.effects.veil)

    def bands(self) -> BandAverages | None:
        """Return the band averages of the water's spectrum, or None without one."""
        effects = self.effects
        if effects.water_type is None:
            return None
        return band_averages(effects.water_type, self.depth, self.mean_attenuation)
