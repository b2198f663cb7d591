# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Spectra of sea water and daylight, as a camera sees them (eq. 3, 10, 13-14)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uw_visibility.errors import InputError
from uw_visibility.optics import tables
from uw_visibility.optics.light_model import transmission

# Eq. 10 integrates over these wavelengths, which are those of Smith and Baker's table.
WAVELENGTH_MIN = 200.0
WAVELENGTH_MAX = 800.0
WAVELENGTHS = np.arange(WAVELENGTH_MIN, WAVELENGTH_MAX + 0.5)


@dataclass(frozen=True)
class CameraResponse:
    """Relative spectral response of a camera.

    Attributes
    ----------
    name : str
        Name of the shipped table, or path of the file.
    wavelength : (N,) float64 ndarray
        Wavelengths, nm, rising.
    sensitivity : (N, 3) float64 ndarray
        Response of R, G and B; the scale of each channel is free.
    """

    name: str
    wavelength: NDArray[np.float64]
    sensitivity: NDArray[np.float64]

    def at(self, wavelength: NDArray[np.float64]) -> NDArray[np.float64]:
        """Response at wavelengths (N,), nm, as (N, 3) float64; 0 beyond those measured."""
        return np.stack([
            np.interp(wavelength, self.wavelength, self.sensitivity[:, c], left=0.0, right=0.0)
            for c in range(3)
        ], axis=1)

    def band_average(
        self, wavelength: NDArray[np.float64], spectrum: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Mean of a spectrum, weighted with the response of each channel (eq. 10).

        Parameters
        ----------
        wavelength, spectrum : (N,) float64 ndarray
            nm, rising, and the values there; beyond, the nearest value counts.

        Returns
        -------
        (3,) float64 ndarray
        """
        weight = self.at(WAVELENGTHS)
        values = np.interp(WAVELENGTHS, wavelength, spectrum)
        return np.asarray(values @ weight / weight.sum(axis=0), dtype=np.float64)


def load_response(name_or_path: str | Path) -> CameraResponse:
    """Load a camera's spectral response.

    Parameters
    ----------
    name_or_path : str or Path
        Name of a shipped table (see `response_names`), or path of a CSV file
        with the columns ``wavelength_nm, red, green, blue``; lines that begin
        with ``#`` are comments.

    Returns
    -------
    CameraResponse

    Raises
    ------
    InputError
        If there is neither such a name nor such a file, or the file does not
        hold a response: two rows or more, rising wavelengths that overlap
        200-800 nm, no negative value, and light in every channel.
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
            "a CSV file with the columns wavelength_nm, red, green, blue"
        )
    values = tables.numbers(table, ("wavelength_nm", "red", "green", "blue"), name)
    response = CameraResponse(name, values[:, 0], values[:, 1:])
    if (response.sensitivity < 0).any():
        raise InputError(f"camera response {name} has a negative value: set it to 0")
    if not (response.at(WAVELENGTHS).sum(axis=0) > 0).all():
        raise InputError(
            f"camera response {name} has a channel without any response between "
            f"{WAVELENGTH_MIN:g} and {WAVELENGTH_MAX:g} nm: wavelengths are in nm"
        )
    return response


def response_names() -> list[str]:
    """Return the names of the camera responses that the package ships."""
    return tables.shipped_names("camera_")


@cache
def clear_water_properties() -> NDArray[np.float64]:
    """Absorption and scattering of the clearest sea water.

    Returns
    -------
    (3, N) float64 ndarray
        Wavelength, nm, 200 to 800; a_w and b_sw, 1/m.

    References
    ----------
    R. C. Smith and K. S. Baker, Optical properties of the clearest natural
    waters (200-800 nm), Applied Optics 20(2), 1981, doi 10.1364/AO.20.000177.
    """
    name = "clear_sea_water.csv"
    columns = ("wavelength_nm", "absorption_per_m", "scattering_per_m")
    return tables.numbers(tables.read_shipped(name), columns, name).T


def clear_water_spectrum() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Wavelengths, nm, and diffuse attenuation K_w = a_w + b_sw / 2 of clear sea water, 1/m."""
    wavelength, absorption, scattering = clear_water_properties()
    return wavelength, absorption + 0.5 * scattering


def clear_water_attenuation(response: CameraResponse) -> NDArray[np.float64]:
    """Attenuation κ of clear sea water as a camera sees it (eq. 10).

    K_w(λ) weighted with the response, which is normalised to an integral of 1
    in each channel.

    Parameters
    ----------
    response : CameraResponse

    Returns
    -------
    (3,) float64 ndarray
        κ for R, G, B, 1/m.
    """
    return response.band_average(*clear_water_spectrum())


def compose_attenuation(
    clear_water: ArrayLike,
    particle_scattering: ArrayLike = 0.0,
    particle_absorption: ArrayLike = 0.0,
    dissolved_absorption: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    """Total beam attenuation β = K_w + b_p + a_p + a_y (eq. 3, its lower bound).

    Parameters
    ----------
    clear_water, particle_scattering, particle_absorption, dissolved_absorption : array_like
        Coefficients, 1/m, per channel or per wavelength; shapes broadcast.

    Returns
    -------
    float64 ndarray
        β, 1/m.

    Raises
    ------
    InputError
        If a coefficient is negative.
    """
    terms = {
        "clear water attenuation": clear_water,
        "particle scattering": particle_scattering,
        "particle absorption": particle_absorption,
        "absorption of dissolved matter": dissolved_absorption,
    }
    total = np.zeros(())
    for name, term in terms.items():
        coefficient = np.asarray(term, dtype=np.float64)
        if not (coefficient >= 0).all():
            raise InputError(f"{name} is negative: give 1/m, 0 or more")
        total = total + coefficient
    return total


def daylight_spectrum() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Relative spectral power of the CIE standard daylight D55.

    Returns
    -------
    wavelength : (N,) float64 ndarray
        nm, rising.
    power : (N,) float64 ndarray
        Relative; the scale is free.
    """
    name = "daylight_d55.csv"
    values = tables.numbers(
        tables.read_shipped(name), ("wavelength_nm", "relative_power"), name
    )
    return values[:, 0], values[:, 1]


def theoretical_chromaticity(
    depth: ArrayLike, attenuation: ArrayLike, white_reference: ArrayLike = (1.0, 1.0, 1.0)
) -> NDArray[np.float64]:
    """Chromaticity of the ambient light over depth (eq. 13-14).

    Parameters
    ----------
    depth : array_like
        Depths z, m, of any shape.
    attenuation : (3,) array_like
        Attenuation of the water above, 1/m; κ for clear water.
    white_reference : (3,) array_like
        R, G, B of white at the surface; the scale is free.

    Returns
    -------
    (..., 3) float64 ndarray
        I∞^c / Σ I∞^c with I∞ = white · exp(-attenuation · z); sums to 1.
    """
    rate = np.asarray(attenuation, dtype=np.float64)
    below = np.asarray(depth, dtype=np.float64)[..., np.newaxis]
    # Of the chromaticity, what all channels lose alike is no part.
    light = np.asarray(white_reference, np.float64) * transmission(rate - rate.min(), below)
    return np.asarray(light / light.sum(axis=-1, keepdims=True))
