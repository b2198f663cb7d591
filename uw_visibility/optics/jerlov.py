# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Jerlov water types: measured absorption and scattering, as a camera sees them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uw_visibility.errors import InputError
from uw_visibility.optics import tables
from uw_visibility.optics.spectra import CameraResponse

# Part of what natural particles scatter that goes backwards: mean of Petzold's
# measurements (1972), in C. D. Mobley, Light and Water, 1994, table 3.10.
BACKSCATTERED = 0.0183


def water_types() -> list[str]:
    """Return the names of the Jerlov water types whose measured properties are shipped."""
    _, rows = tables.read_shipped("jerlov_water_types.csv")
    return list(dict.fromkeys(row[0] for row in rows))


def water_type_spectrum(
    water_type: str,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Measured absorption and scattering of a Jerlov water type.

    Parameters
    ----------
    water_type : str
        One of `water_types`.

    Returns
    -------
    wavelength : (N,) float64 ndarray
        nm, rising.
    absorption, scattering : (N,) float64 ndarray
        a and b, 1/m.

    Raises
    ------
    InputError
        If the type is not known.

    References
    ----------
    B. A. Williamson and R. C. Hollins, Measured IOPs of Jerlov water types,
    Applied Optics 61(33), 2022, doi 10.1364/AO.470464.
    """
    head, rows = tables.read_shipped("jerlov_water_types.csv")
    if water_type not in water_types():
        raise InputError(
            f"no water type {water_type!r}: give one of {', '.join(water_types())}"
        )
    mine = [row for row in rows if row[0] == water_type]
    values = tables.numbers(
        (head, mine), ("wavelength_nm", "a_per_m", "b_per_m"), "jerlov_water_types.csv"
    )
    return values[:, 0], values[:, 1], values[:, 2]


def water_type_attenuation(
    water_type: str, response: CameraResponse
) -> NDArray[np.float64]:
    """Beam attenuation a + b of a Jerlov water type as a camera sees it.

    Parameters
    ----------
    water_type : str
        One of `water_types`.
    response : CameraResponse

    Returns
    -------
    (3,) float64 ndarray
        β for R, G, B, 1/m. Beyond the measured wavelengths, the nearest
        measured one counts.

    Raises
    ------
    InputError
        If the type is not known.

    References
    ----------
    B. A. Williamson and R. C. Hollins, Measured IOPs of Jerlov water types,
    Applied Optics 61(33), 2022, doi 10.1364/AO.470464.
    """
    return _water_type(water_type, response, 1.0)


def water_type_diffuse_attenuation(
    water_type: str, response: CameraResponse
) -> NDArray[np.float64]:
    """Diffuse attenuation K = a + b_b of a Jerlov water type as a camera sees it.

    How daylight fades with depth: light scattered forwards is not lost to it, so
    that only the part scattered back counts, as in clear water's K_w.

    Parameters
    ----------
    water_type : str
        One of `water_types`.
    response : CameraResponse

    Returns
    -------
    (3,) float64 ndarray
        K for R, G, B, 1/m; see `water_type_attenuation` for its source.

    Raises
    ------
    InputError
        If the type is not known.
    """
    return _water_type(water_type, response, BACKSCATTERED)


def _water_type(
    water_type: str, response: CameraResponse, scattering: float
) -> NDArray[np.float64]:
    """Absorption, and a part of scattering, of a Jerlov type as a camera sees it, 1/m."""
    wavelength, absorbed, scattered = water_type_spectrum(water_type)
    return response.band_average(wavelength, absorbed + scattering * scattered)
