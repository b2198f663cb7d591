# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Jerlov water types: attenuation of beams and daylight for a camera, and Secchi depth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.optics import tables
from uw_visibility.optics.spectra import CameraResponse, clear_water_properties, daylight_spectrum
from uw_visibility.optics.visual_range import remote_sensing_reflectance, secchi_depth

TYPES = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")
"""From the clearest ocean to turbid coasts."""

DIFFUSE_WAVELENGTH = 490.0
"""Wavelength of the diffuse attenuation Kd in oceanography, nm."""
SECCHI_WAVELENGTHS = (443.0, 665.0)
"""Range of wavelengths in which a Secchi disk is seen, nm (Lee et al. 2015)."""

WAVELENGTHS = np.arange(380.0, 781.0, 5.0)
"""Grid for integrals over the visible spectrum, nm."""

# Table of measured properties.
MEASURED = "jerlov_water_types.csv"

Vector = NDArray[np.float64]
# Backscattering ratio b_b / b of natural particles: mean of Petzold's measurements (1972), in
# C. D. Mobley, Light and Water, 1994, table 3.10.
BACKSCATTERED = 0.0183
# Part of scattering by small angles that is not lost to a camera, (c − β) / b, and its standard
# deviation: median of 13 path-traced scenes 0.83 (0.72 to 0.92), of 4 with Fournier and Forand's
# phase functions 0.92 (lab/studies/beam_attenuation.md).
KEPT, KEPT_DEVIATION = 0.83, 0.1


@dataclass(frozen=True)
class WaterType:
    """Jerlov water type."""

    name: str  # one of `TYPES`
    diffuse_attenuation_490: float  # Kd at 490 nm, 1/m (Jerlov 1976)
    least_diffuse_attenuation: float  # the least Kd between 443 and 665 nm, 1/m
    clearest_wavelength: float  # wavelength of the least Kd, nm
    secchi_depth: float  # by Lee et al. 2015, m.


@cache
def water_type(name: str) -> WaterType:
    """Return a Jerlov water type by its name, one of `TYPES`."""
    file = "jerlov_diffuse_attenuation.csv"
    wavelength, diffuse = tables.numbers(tables.read_shipped(file), ("wavelength_nm", name), file).T
    grid = np.arange(SECCHI_WAVELENGTHS[0], SECCHI_WAVELENGTHS[1] + 0.5)
    values = np.interp(grid, wavelength, diffuse)
    least = int(values.argmin())
    absorption, scattering = inherent_properties(name, grid[least:least + 1])
    pure = clear_water(grid[least:least + 1])[1]
    # Molecules scatter half of their light backwards, particles little.
    backscattering = 0.5 * pure + BACKSCATTERED * np.maximum(scattering - pure, 0.0)
    reflectance = remote_sensing_reflectance(absorption, backscattering)
    return WaterType(
        name, float(np.interp(DIFFUSE_WAVELENGTH, wavelength, diffuse)), float(values[least]),
        float(grid[least]), float(secchi_depth(values[least], reflectance)[0]))


def inherent_properties(name: str, wavelength: Vector) -> tuple[Vector, Vector]:
    """Absorption a and scattering b of a Jerlov water type at wavelengths (N,), nm; 1/m.

    Measured values (Williamson and Hollins 2022) if available, otherwise modelled ones (Solonenko
    and Mobley 2015: I, IA, 7C, 9C). The excess of absorption over that of clear water, which rises
    steeply towards red, is interpolated.
    """
    file = MEASURED if name in water_types() else "jerlov_modelled_properties.csv"
    known, absorbed, scattered = _properties(name, file)
    excess = absorbed - clear_water(known)[0]
    absorption = clear_water(wavelength)[0] + np.interp(wavelength, known, excess)
    return np.maximum(absorption, 1e-3), np.interp(wavelength, known, scattered)


def seen_attenuation(
    name: str, response: CameraResponse, depth: float, path: float, kept: float = KEPT
) -> NDArray[np.float64]:
    """Attenuation of a Jerlov type as a camera sees it, at a depth over a path (m); (3,) 1/m.

    Computed from the band-averaged transmission over the path, in the daylight at the depth: both
    shift red towards wavelengths of less absorption. The part `kept` of scattering is not lost.
    """
    absorption, scattering = inherent_properties(name, WAVELENGTHS)
    weight = daylight_response(response) * np.exp(
        -depth * (absorption + BACKSCATTERED * scattering))[:, np.newaxis]
    left = np.exp(-path * (absorption + (1.0 - kept) * scattering)) @ weight / weight.sum(axis=0)
    return np.asarray(-np.log(left) / path)


def daylight_response(response: CameraResponse) -> Vector:
    """Return response times daylight, shape (n, 3), at `WAVELENGTHS`."""
    daylight = np.interp(WAVELENGTHS, *daylight_spectrum())
    return np.asarray(response.at(WAVELENGTHS) * daylight[:, np.newaxis])


def effective_wavelengths(response: CameraResponse) -> NDArray[np.float64]:
    """Centroids of a camera's channels in daylight, (3,) float64, R, G, B, nm."""
    weight = daylight_response(response)
    return np.asarray(WAVELENGTHS @ weight / weight.sum(axis=0))


def clear_water(wavelength: Vector) -> tuple[Vector, Vector]:
    """Absorption and scattering of clear sea water at wavelengths, nm, 1/m."""
    known, absorbed, scattered = clear_water_properties()
    return np.interp(wavelength, known, absorbed), np.interp(wavelength, known, scattered)


def water_types() -> list[str]:
    """Return the names of the Jerlov water types whose measured properties are shipped."""
    _, rows = tables.read_shipped(MEASURED)
    return list(dict.fromkeys(row[0] for row in rows))


@cache
def _properties(name: str, file: str) -> NDArray[np.float64]:
    """Wavelengths, absorption and scattering of a type in a shipped table, (3, N)."""
    head, rows = tables.read_shipped(file)
    mine = tuple(row for row in rows if row[0] == name)
    return tables.numbers((head, mine), ("wavelength_nm", "a_per_m", "b_per_m"), file).T


def water_type_attenuation(
    water_type: str, response: CameraResponse, *, diffuse: bool = False
) -> NDArray[np.float64]:
    """Attenuation β of a Jerlov water type as a camera sees it, or the diffuse K, (3,) 1/m.

    β = a + (1 - F) b, with F the part `KEPT`. K = a + b_b is the attenuation of daylight with
    depth, to which forward scattering does not contribute. Beyond the measured wavelengths, the
    nearest value counts. B. A. Williamson and R. C. Hollins, Measured IOPs of Jerlov water types,
    Applied Optics 61(33), 2022, doi 10.1364/AO.470464.

    Raises `InputError` if the type is not one of `water_types`.
    """
    if water_type not in water_types():
        raise InputError(f"no water type {water_type!r}: give one of {', '.join(water_types())}")
    wavelength, absorbed, scattered = _properties(water_type, MEASURED)
    lost = BACKSCATTERED if diffuse else 1.0 - KEPT
    return response.band_average(wavelength, absorbed + lost * scattered)
