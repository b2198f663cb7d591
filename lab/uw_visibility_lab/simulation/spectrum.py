# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water integrated over wavelength with a camera's response, instead of one β per channel.

E_c = ∫ s_c(λ) L(λ) (ρ_c e^(−β(λ)d) + ω(λ) (1 − e^(−β(λ)d))) dλ with the camera's response s_c,
daylight at depth L(λ) = I0(λ) e^(−K(λ)z), attenuation β = a + b', diffuse attenuation
K = a + b_b, and the veil's spectrum ω = b'/β, which scattering gives and absorption takes
(Akkaynak and Treibitz, CVPR 2018, doi 10.1109/CVPR.2018.00703). Here b' is the scattering that a
camera loses (`KEPT`). A reflectance ρ_c is that of its channel: even over the channel's band.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.images.arrays import Array
from uw_visibility.optics.spectra import load_response
from uw_visibility.optics.water_type import (
    BACKSCATTERED,
    KEPT,
    WAVELENGTHS,
    clear_water,
    daylight_response,
    inherent_properties,
    water_types,
)

CLEAR = "clear"
"""Name of clear sea water among the water types."""

CDOM_SLOPE = 0.015
"""Decay of a_y(λ) in 1/nm (Bricaud, Morel and Prieur 1981, doi 10.4319/lo.1981.26.1.0043)."""
CDOM_WAVELENGTH = 440.0
PARTICLE_WAVELENGTH = 550.0

_PATHS = np.concatenate([[0.0], np.geomspace(0.02, 400.0, 400)])


def spectral_types() -> list[str]:
    """Return the names of the waters whose spectra are known."""
    return [CLEAR, *water_types()]


@dataclass(frozen=True)
class BandAverages:
    """Band-averaged transmission of a water's spectrum in a camera's channels."""

    # (3,); daylight at depth for a camera that is balanced at the surface, where it is 1
    light: Array
    path: Array  # (n,); ranges in m, rising from 0
    log_transmission: Array  # (n, 3); logarithm of the band-averaged transmission over these ranges
    log_unveiled: Array  # (n, 3); logarithm of what the veil lacks of its value at infinity

    def transmission(self, ranges: NDArray[np.floating]) -> Array:
        """Return the band-averaged transmission, shape (..., 3); 0 at infinity."""
        return self._interpolate(ranges, self.log_transmission)

    def unveiled(self, ranges: NDArray[np.floating]) -> Array:
        """Missing share of the veil's value at infinity, shape (..., 3), 0 .. 1."""
        return self._interpolate(ranges, self.log_unveiled)

    def _interpolate(self, ranges: NDArray[np.floating], table: Array) -> Array:
        flat = np.asarray(ranges, dtype=np.float64).ravel()
        values = np.stack([np.exp(np.interp(flat, self.path, table[:, c])) for c in range(3)], 1)
        values[np.isinf(flat)] = 0.0
        return values.reshape((*np.shape(ranges), 3))


@lru_cache(maxsize=16)
def band_averages(
    water_type: str,
    depth: float,
    particles: float = 0.0,
    particle_slope: float = 0.0,
    cdom: float = 0.0,
    response: str = "nikon_d5100",
) -> BandAverages:
    """Integrate a water's spectrum with a camera's response.

    water_type: ``clear`` (Smith and Baker 1981) or a Jerlov type (Williamson and Hollins 2022).
    particles, cdom: attenuation by more particles at 550 nm, absorption at 440 nm, 1/m.
    particle_slope: exponent γ of the particles' spectrum (550 nm / λ)^γ; 0 = grey.
    """
    absorption, scattering, backscattering = _spectrum(water_type)
    absorption = absorption + cdom * np.exp(-CDOM_SLOPE * (WAVELENGTHS - CDOM_WAVELENGTH))
    grains = particles * (PARTICLE_WAVELENGTH / WAVELENGTHS) ** particle_slope
    scattering = scattering + grains
    beam = absorption + scattering
    diffuse = absorption + backscattering + BACKSCATTERED * grains
    surface = daylight_response(load_response(response))
    weights = surface * np.exp(-diffuse * depth)[:, np.newaxis]
    light = weights.sum(axis=0) / surface.sum(axis=0)
    veil_weights = weights * (scattering / beam)[:, np.newaxis]
    decay = np.exp(-np.outer(_PATHS, beam))
    with np.errstate(divide="ignore"):  # beyond all light the logarithm is cut off
        transmission, unveiled = (
            np.maximum(np.log(decay @ w / w.sum(axis=0)), -700.0)
            for w in (weights, veil_weights)
        )
    return BandAverages(light, _PATHS, transmission, unveiled)


def _spectrum(water_type: str) -> tuple[Array, Array, Array]:
    """Absorption, scattering that is lost to a camera, and backscattering, by wavelength, 1/m."""
    if water_type not in spectral_types():
        raise InputError(
            f"no water type {water_type!r}: give one of {', '.join(spectral_types())}"
        )
    if water_type == CLEAR:
        absorption, scattering = clear_water(WAVELENGTHS)
        # As in K_w = a_w + b_sw / 2: what molecules scatter forwards is not lost.
        return absorption, 0.5 * scattering, 0.5 * scattering
    absorption, scattering = inherent_properties(water_type, WAVELENGTHS)
    return absorption, (1.0 - KEPT) * scattering, BACKSCATTERED * scattering
