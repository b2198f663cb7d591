# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Optics of clear water and camera against published values and closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.errors import InputError
from uw_visibility.optics import spectra as optics


def test_clear_water_attenuation_of_the_nikon_d5100():
    kappa = optics.clear_water_attenuation(optics.load_response("nikon_d5100"))
    np.testing.assert_allclose(kappa, [0.228, 0.066, 0.025], atol=6e-4)


def test_clear_water_spectrum_is_absorption_plus_half_the_scattering():
    wavelength, attenuation = optics.clear_water_spectrum()
    # Smith and Baker 1981, table I: a_w 0.0145 and b_sw 0.0045 at 450 nm.
    assert attenuation[wavelength == 450] == pytest.approx(0.0145 + 0.00225)
    assert (wavelength[0], wavelength[-1]) == (200, 800)


@pytest.mark.parametrize("name", optics.response_names())
def test_shipped_responses_see_red_fade_first(name):
    kappa = optics.clear_water_attenuation(optics.load_response(name))
    assert kappa[0] > kappa[1] > kappa[2] > 0


def test_at_least_three_responses_are_shipped():
    assert len(optics.response_names()) >= 3


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_response_of_a_single_wavelength_gives_the_table_at_it(tmp_path):
    rows = [
        f"{nm},{int(nm == 600)},{int(nm == 500)},{int(nm == 450)}" for nm in range(400, 701)
    ]
    path = write(tmp_path / "own.csv", "\n".join(["wavelength_nm,red,green,blue", *rows]))
    kappa = optics.clear_water_attenuation(optics.load_response(path))
    np.testing.assert_allclose(kappa, [0.2447, 0.02715, 0.01675], rtol=1e-9)


@given(st.tuples(*[st.floats(1e-3, 1e3)] * 3))
def test_attenuation_does_not_depend_on_the_scale_of_the_response(scales):
    response = optics.load_response("nikon_d5100")
    scaled = optics.CameraResponse(
        "scaled", response.wavelength, response.sensitivity * np.array(scales)
    )
    np.testing.assert_allclose(
        optics.clear_water_attenuation(scaled), optics.clear_water_attenuation(response)
    )


HEAD = "wavelength_nm,red,green,blue\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("wavelength_nm,red,green\n400,1,1\n700,1,1\n", "'blue'"),
        (HEAD + "400,1,1,1\n700,1,x,1\n", "'x'"),
        (HEAD + "400,1,1\n700,1,1,1\n", "row without a number"),
        (HEAD + "400,1,1,1\n", "two rows"),
        (HEAD + "400,1,1,nan\n700,1,1,1\n", "finite"),
        (HEAD + "700,1,1,1\n400,1,1,1\n", "out of order"),
        (HEAD + "400,1,1,1\n700,1,-1,1\n", "negative"),
        (HEAD + "400,1,0,1\n700,1,0,1\n", "without any response"),
        (HEAD + "0.4,1,1,1\n0.7,1,1,1\n", "in nm"),
        ("", "wavelength_nm"),
    ],
)
def test_a_response_that_is_none_is_refused_by_name(tmp_path, text, says):
    path = write(tmp_path / "bad.csv", text)
    with pytest.raises(InputError, match=says) as error:
        optics.load_response(path)
    assert "bad.csv" in str(error.value)


def test_a_response_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "bad.csv"
    path.write_bytes(b"\xff\xfe\x00\x81" * 10)
    with pytest.raises(InputError, match=r"bad\.csv is not a CSV"):
        optics.load_response(path)


def test_an_unknown_response_names_the_known_ones():
    with pytest.raises(InputError, match=r"'gopro'.*nikon_d5100"):
        optics.load_response("gopro")


def test_theoretical_chromaticity_follows_the_exponential_law():
    kappa = np.array([0.228, 0.066, 0.025])
    light = np.array([1.2, 1.0, 0.7]) * np.exp(-kappa * 3.5)
    gamma = optics.theoretical_chromaticity(3.5, kappa, [1.2, 1.0, 0.7])
    np.testing.assert_allclose(gamma, light / light.sum())


@given(st.floats(0, 200), st.floats(0.01, 5))
def test_chromaticity_sums_to_one_and_ignores_grey_attenuation(depth, grey):
    kappa = np.array([0.228, 0.066, 0.025])
    gamma = optics.theoretical_chromaticity(depth, kappa)
    assert gamma.sum() == pytest.approx(1)
    np.testing.assert_allclose(gamma, optics.theoretical_chromaticity(depth, kappa + grey),
                               atol=1e-9)


def test_chromaticity_of_many_depths():
    gamma = optics.theoretical_chromaticity(np.linspace(0, 60, 7), [0.2, 0.1, 0.05])
    assert gamma.shape == (7, 3)
    assert (np.diff(gamma[:, 0]) < 0).all()


def test_every_shipped_table_names_its_source_and_licence():
    from importlib import resources

    tables = [f for f in resources.files("uw_visibility.data").iterdir()
              if f.name.endswith(".csv")]
    assert len(tables) >= 7
    for table in tables:
        head = [line for line in table.read_text("utf-8").splitlines() if line.startswith("#")]
        assert any("Source:" in line for line in head), table.name
        assert any("Licence:" in line for line in head), table.name
