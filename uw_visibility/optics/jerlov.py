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
    water_type: str, response: CameraResponse, *, diffuse: bool = False
) -> NDArray[np.float64]:
    """Beam attenuation a + b of a Jerlov water type as a camera sees it, or the diffuse one.

    Parameters
    ----------
    water_type : str
        One of `water_types`.
    response : CameraResponse
    diffuse : bool
        Whether to return K = a + b_b, by which daylight fades with depth: light scattered
        forwards is not lost to it, so that only the part scattered back counts, as in clear
        water's K_w.

    Returns
    -------
    (3,) float64 ndarray
        β or K for R, G, B, 1/m. Beyond the measured wavelengths, the nearest
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
    wavelength, absorbed, scattered = water_type_spectrum(water_type)
    lost = BACKSCATTERED if diffuse else 1.0
    return response.band_average(wavelength, absorbed + lost * scattered)
