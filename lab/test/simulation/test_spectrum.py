# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water integrated over wavelength."""

from __future__ import annotations

import numpy as np
import pytest

from uw_visibility.optics.spectra import (
    clear_water_attenuation,
    clear_water_spectrum,
    daylight_spectrum,
    load_response,
)
from uw_visibility.optics.water_type import water_type_attenuation, water_types
from uw_visibility_lab.simulation.water import band_averages


def test_transmission_is_the_integral_over_the_band() -> None:
    """Against an integral of our own, in nanometres, of clear water at the surface."""
    response = load_response("nikon_d5100")
    wavelength = np.arange(380.0, 781.0)
    daylight = np.interp(wavelength, *daylight_spectrum())
    attenuation = np.interp(wavelength, *clear_water_spectrum())
    bands = band_averages("clear", 0.0)
    for distance in (0.5, 3.0, 20.0):
        found = bands.transmission(np.array([distance]))[0]
        for c in range(3):
            weight = daylight * np.interp(
                wavelength, response.wavelength, response.sensitivity[:, c])
            expected = (weight * np.exp(-attenuation * distance)).sum() / weight.sum()
            assert found[c] == pytest.approx(expected, rel=0.02)


def test_each_type_attenuates_as_its_table_says_and_less_with_range() -> None:
    response = load_response("nikon_d5100")
    distances = np.array([0.05, 2.0, 10.0])
    for name in water_types():
        rate = -np.log(band_averages(name, 2.0).transmission(distances)) / distances[:, None]
        # What is attenuated most is gone first.
        assert (np.diff(rate, axis=0) <= 1e-9).all()
        np.testing.assert_allclose(
            rate[0], water_type_attenuation(name, response), rtol=0.12)


def test_grey_particles_add_their_attenuation_at_any_range() -> None:
    distances = np.array([1.0, 5.0, 15.0])
    clear, turbid = (
        np.log(band_averages("clear", 3.0, particles).transmission(distances))
        for particles in (0.0, 0.2)
    )
    # Hardly more light of one end of a band than of the other is lost on the way down.
    np.testing.assert_allclose(clear - turbid, 0.2 * distances[:, None] * np.ones(3), rtol=0.02)


def test_light_fades_with_depth_and_clear_water_is_kappa_s() -> None:
    kappa = clear_water_attenuation(load_response("nikon_d5100"))
    surface, deep = (band_averages("clear", depth).light for depth in (0.0, 5.0))
    np.testing.assert_allclose(surface, 1.0)
    # κ weights without daylight and at no depth; in a wide band the deeper light is clearer.
    assert (deep > np.exp(-5.0 * kappa) * 0.95).all()
    assert (deep < np.exp(-5.0 * kappa) * 1.4).all()


def test_the_veil_grows_to_the_whole_of_it() -> None:
    unveiled = band_averages("1C", 3.0).unveiled(np.array([0.0, 1.0, 10.0, np.inf]))
    np.testing.assert_allclose(unveiled[0], 1.0)
    np.testing.assert_array_equal(unveiled[-1], 0.0)
    assert (np.diff(unveiled, axis=0) < 0.0).all()
