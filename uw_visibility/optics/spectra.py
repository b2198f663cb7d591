# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Spectra of sea water and daylight, as a camera sees them (eq. 3, 10, 13-14)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.errors import InputError
from uw_visibility.optics import tables
from uw_visibility.optics.light_model import transmission

Array = NDArray[np.float64]

# Eq. 10 integrates over these wavelengths, which are those of Smith and Baker's table.
WAVELENGTH_MIN = 200.0
WAVELENGTH_MAX = 800.0
WAVELENGTHS = np.arange(WAVELENGTH_MIN, WAVELENGTH_MAX + 0.5)


@dataclass(frozen=True)
class CameraResponse:
    """Relative spectral response of a camera."""

    name: str  # name of the shipped table, or path of the file
    wavelength: Array  # (N,) float64, wavelengths, nm, rising
    sensitivity: Array  # (N, 3) float64, response of R, G and B; the scale of each channel is free

    def at(self, wavelength: Array) -> Array:
        """Response at wavelengths (N,), nm, as (N, 3) float64; 0 beyond those measured."""
        return np.stack([
            np.interp(wavelength, self.wavelength, self.sensitivity[:, c], left=0.0, right=0.0)
            for c in range(3)
        ], axis=1)

    def band_average(self, wavelength: Array, spectrum: Array) -> Array:
        """Mean of a spectrum over rising wavelengths (N,), nm, weighted with the response (eq. 10).

        Beyond the wavelengths given, the nearest value counts.
        """
        weight = self.at(WAVELENGTHS)
        values = np.interp(WAVELENGTHS, wavelength, spectrum)
        return np.asarray(values @ weight / weight.sum(axis=0), dtype=np.float64)


def load_response(name_or_path: str | Path) -> CameraResponse:
    """Load a camera's spectral response: a shipped table (`response_names`), or a CSV file.

    The file has the columns ``wavelength_nm, red, green, blue``; lines that begin with ``#`` are
    comments. Raises `InputError` if there is neither such a name nor such a file, or the file does
    not hold a response: two rows or more, rising wavelengths that overlap 200-800 nm, no negative
    value, and a response in every channel.
    """
    name = str(name_or_path)
    known = response_names()
    if name in known:
        table = tables.read_shipped(f"camera_{name}.csv")
    elif Path(name).is_file():
        table = tables.read_file(Path(name))
    else:
        raise InputError(
            f"no camera response {name!r}: give one of {', '.join(known)}, or the path of "
            "a CSV file with the columns wavelength_nm, red, green, blue")
    values = tables.numbers(table, ("wavelength_nm", "red", "green", "blue"), name)
    response = CameraResponse(name, values[:, 0], values[:, 1:])
    if (response.sensitivity < 0).any():
        raise InputError(f"camera response {name} has a negative value: set it to 0")
    if not (response.at(WAVELENGTHS).sum(axis=0) > 0).all():
        raise InputError(
            f"camera response {name} has a channel without any response between "
            f"{WAVELENGTH_MIN:g} and {WAVELENGTH_MAX:g} nm: wavelengths are in nm")
    return response


def response_names() -> list[str]:
    """Return the names of the camera responses that the package ships."""
    files = (entry.name for entry in resources.files("uw_visibility.data").iterdir())
    return sorted(
        name.removeprefix("camera_").removesuffix(".csv")
        for name in files if name.startswith("camera_"))


@cache
def clear_water_properties() -> Array:
    """Wavelength (200 to 800 nm), absorption a_w and scattering b_sw, 1/m, of clear sea water.

    R. C. Smith and K. S. Baker, Optical properties of the clearest natural waters (200-800 nm),
    Applied Optics 20(2), 1981, doi 10.1364/AO.20.000177.
    """
    name = "clear_sea_water.csv"
    columns = ("wavelength_nm", "absorption_per_m", "scattering_per_m")
    return tables.numbers(tables.read_shipped(name), columns, name).T


def clear_water_spectrum() -> tuple[Array, Array]:
    """Wavelengths, nm, and diffuse attenuation K_w = a_w + b_sw / 2 of clear sea water, 1/m."""
    wavelength, absorption, scattering = clear_water_properties()
    return wavelength, absorption + 0.5 * scattering


def clear_water_attenuation(response: CameraResponse) -> Array:
    """Attenuation κ of clear sea water as a camera sees it, (3,) 1/m (eq. 10)."""
    return response.band_average(*clear_water_spectrum())


@cache
def daylight_spectrum() -> tuple[Array, Array]:
    """Wavelength, nm, rising, and relative power of the CIE standard daylight D55."""
    name = "daylight_d55.csv"
    values = tables.numbers(tables.read_shipped(name), ("wavelength_nm", "relative_power"), name)
    return values[:, 0], values[:, 1]


def theoretical_chromaticity(
    depth: ArrayLike, attenuation: ArrayLike, white_reference: ArrayLike = (1.0, 1.0, 1.0)
) -> Array:
    """Chromaticity I∞ / Σ I∞ of the ambient light over depth, (..., 3) (eq. 13-14).

    depth: depths z, m, of any shape.
    attenuation: (3,) array_like, attenuation of the water above, 1/m; κ for clear water.
    white_reference: (3,) array_like, R, G, B of white at the surface; the scale is free.
    """
    rate = np.asarray(attenuation, dtype=np.float64)
    below = np.asarray(depth, dtype=np.float64)[..., np.newaxis]
    # Attenuation common to the channels does not change the chromaticity.
    light = np.asarray(white_reference, np.float64) * transmission(rate - rate.min(), below)
    return np.asarray(light / light.sum(axis=-1, keepdims=True))
