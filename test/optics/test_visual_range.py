# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Visual ranges and Jerlov types against closed forms and published tables."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from uw_visibility.optics import water_type as types
from uw_visibility.optics.spectra import load_response
from uw_visibility.optics.visual_range import (
    SECCHI_DEVIATION,
    black_disc_visibility,
    remote_sensing_reflectance,
    secchi_depth,
)


def table(path: Path) -> list[dict[str, str]]:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def test_black_disc_is_seen_over_attenuation_lengths():
    # Davies-Colley 1988: contrast falls to the eye's threshold e^-4.8 = 0.008.
    np.testing.assert_allclose(np.exp(-0.5 * black_disc_visibility(0.5)), np.exp(-4.8))
    np.testing.assert_allclose(black_disc_visibility([0.1, 1.2]), [48.0, 4.0])


@pytest.mark.parametrize(("diffuse", "reflectance", "expected"), [
    (0.02, 0.012, 45.7416), (0.05, 0.008, 18.5428), (0.1, 0.005, 9.3613), (0.25, 0.004, 3.7563),
    (0.6, 0.010, 1.5351), (1.5, 0.020, 0.5927), (4.0, 0.030, 0.2136), (8.0, 0.2, 0.0765),
])
def test_secchi_depths_worked_out_apart(
    diffuse: float, reflectance: float, expected: float
) -> None:
    """The formula of Lee et al. 2015 in decimal arithmetic, from dark ocean to muddy lake.

    Measurements of theirs, which would test the formula and not its code, are not at hand.
    """
    assert secchi_depth(diffuse, reflectance) == pytest.approx(expected, abs=6e-5)


def test_secchi_depths_differ_from_measured_ones_by_the_published_mean():
    # Lee et al. 2015: mean absolute difference of 18 %.
    assert norm(scale=SECCHI_DEVIATION).expect(abs) == pytest.approx(0.18)


@pytest.mark.parametrize(("diffuse", "reflectance", "published"), [
    (0.932040078, 0.012286001, 0.980577587), (0.444279535, 0.013437334, 2.050635327),
    (0.670261686, 0.016316668, 1.352404147), (0.954689364, 0.019392445, 0.933526176),
    (1.237729635, 0.011719334, 0.742471388), (0.404597760, 0.016009779, 2.234498567),
    (0.324276417, 0.011263501, 2.841278319), (0.249784366, 0.010693779, 3.69623495),
    (1.650796381, 0.012339334, 0.55729426), (0.306245305, 0.005735556, 3.05939738),
])
def test_secchi_depths_as_others_published_them(
    diffuse: float, reflectance: float, published: float
) -> None:
    """Kd, Rrs and Secchi depths of Landsat 8 over the Virginia Coast Reserve, by others' code.

    S. E. Lang, Modeling Coastal Water Clarity Using Landsat-8 and Sentinel-2, data in the
    repository ocean-slang/Coastal-OC-Remote-Sensing-V2, lmnonlinear/data (landsat8only.csv,
    leelandsatsecchi.csv). Where Kd is least between the bands, Lee et al. 2016 (doi
    10.1016/j.rse.2016.02.033) take the greatest Rrs of all bands, which is up to 0.7 % off.
    """
    assert secchi_depth(diffuse, reflectance) == pytest.approx(published, rel=0.008)


def test_reflectance_of_clear_and_of_scattering_water():
    # Gordon et al. 1988 in the form of Lee et al. 2002: r = (0.0895 + 0.1247 u) u below water.
    assert remote_sensing_reflectance(1.0, 0.0) == 0.0
    assert remote_sensing_reflectance(0.0, 1.0) == pytest.approx(
        0.52 * 0.2142 / (1 - 1.7 * 0.2142))


def test_water_types_are_in_order():
    found = [types.water_type(name) for name in types.TYPES]
    depths = [each.secchi_depth for each in found]
    assert depths == sorted(depths, reverse=True)
    # Jerlov 1976: the clearest ocean's Kd is 0.018 1/m at 475 nm, III's 0.115 at 500 nm.
    assert found[0].least_diffuse_attenuation == 0.018
    assert found[0].clearest_wavelength == 475.0
    assert types.water_type("III").least_diffuse_attenuation == 0.115
    # Turbid water is clearest in green.
    assert types.water_type("5C").clearest_wavelength == 550.0
    assert types.water_type("1C").diffuse_attenuation_490 == pytest.approx(0.152)


def test_diffuse_attenuation_agrees_with_other_tables(shared_data):
    """Those of Jerlov himself, and of Solonenko and Mobley, who follow him."""
    for row in table(shared_data / "optics" / "solonenko_mobley_2015_iop.csv"):
        kd = row["Kd0_reference_per_m"]
        if row["wavelength_nm"] != "475" or not kd:
            continue
        found = types.water_type(row["water_type"])
        if found.clearest_wavelength == 475.0:
            assert found.least_diffuse_attenuation == pytest.approx(float(kd), rel=0.05)


def test_a_camera_sees_absorption_and_scattering():
    response = load_response("nikon_d5100")
    centre = types.effective_wavelengths(response)
    assert (np.diff(centre) < 0).all()
    # An evenly sensitive look through little water at one wavelength's properties.
    absorption, scattering = types.inherent_properties("II", np.array([488.0]))
    assert absorption + scattering == pytest.approx(0.0465781 + 0.196966)
    near = types.seen_attenuation("II", response, 0.0, 0.01)
    far = types.seen_attenuation("II", response, 10.0, 8.0)
    # Red light that water takes most is gone first.
    assert far[0] < 0.85 * near[0]
    np.testing.assert_allclose(far[1:], near[1:], rtol=0.15)
