# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""White reference and water type, found again in series whose water is known."""

from dataclasses import replace

import numpy as np
import pytest

from uw_visibility.config.parameters import render_values
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.optics.spectra import load_response
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility.water.meaning.calibration import calibrate
from uw_visibility.water.meaning.depth import diffuse_attenuation

RESPONSE = load_response("nikon_d5100")
WHITE = np.array([1.7, 1.0, 0.8])
TRUE_ATTENUATION = np.array([0.5, 0.28, 0.4])


def series(water_type="clear", depths=None, noise=0.02, seed=0, outliers=0):
    """Estimates of a dive through water of a type, and a sensor's depths."""
    rng = np.random.default_rng(seed)
    if depths is None:
        depths = 4 + 3 * np.sin(np.linspace(0, 6, 80))
    estimates = []
    for k, depth in enumerate(depths):
        rate = (TRUE_ATTENUATION if water_type == "estimated"
                else diffuse_attenuation(water_type, RESPONSE))
        light = rng.uniform(0.2, 0.5) * WHITE * np.exp(-rate * depth)
        light = light * np.exp(noise * rng.standard_normal(3))
        if k < outliers:
            light = light * np.array([3.0, 1.0, 0.5])
        attenuation = TRUE_ATTENUATION + 0.1 * noise * rng.standard_normal(3)
        covariance = np.diag([d**2 for i in light for d in (0.1 * noise, noise * i)])
        estimates.append(WaterEstimate(
            Status.OK, attenuation, light, covariance, 9, 40, (Status.OK,) * 3))
    return estimates, np.array(depths)


@pytest.mark.parametrize("water_type", ["clear", "III", "3C", "5C", "estimated"])
def test_type_and_white_are_found_again(water_type):
    estimates, depths = series(water_type)
    found = calibrate(estimates, depths, RESPONSE)
    assert found.best.water_type == water_type
    error = found.best.white_reference - WHITE
    assert (np.abs(error) <= 4 * found.best.white_reference_stddev).all()
    np.testing.assert_allclose(found.best.white_reference, WHITE, rtol=0.03)
    assert found.best.depth_rms < 0.4
    assert [c.depth_rms for c in found.candidates] == sorted(
        c.depth_rms for c in found.candidates)
    assert len(found.residuals) == 80
    assert abs(np.median(found.residuals)) < 0.1


def test_parameters_can_be_pasted(tmp_path):
    estimates, depths = series("3C")
    found = calibrate(estimates, depths, RESPONSE)
    path = tmp_path / "found.yaml"
    path.write_text(render_values(found.parameters(), "found"), encoding="utf-8")
    config = PipelineConfig.from_yaml(path)
    assert config == PipelineConfig.from_parameters(found.parameters())
    assessor = Assessor(config)
    errors = [assessor.assess(e).depth - z for e, z in zip(estimates, depths, strict=True)]
    np.testing.assert_allclose(errors, found.residuals, atol=0.01)
    before = Assessor(PipelineConfig())
    assert np.abs(errors).mean() < 0.2 * np.abs(
        [before.assess(e).depth - z for e, z in zip(estimates, depths, strict=True)]).mean()


def test_a_dive_at_one_depth_tells_the_white_but_no_type_so_clear_stays():
    estimates, depths = series("clear", np.full(60, 3.0))
    found = calibrate(estimates, depths, RESPONSE)
    assert found.best.water_type == "clear"
    assert found.depth_range == (3.0, 3.0)
    np.testing.assert_allclose(found.best.white_reference, WHITE, rtol=0.03)


def test_some_wrong_estimates_do_not_matter():
    estimates, depths = series("III", outliers=10)
    found = calibrate(estimates, depths, RESPONSE)
    assert found.best.water_type == "III"
    np.testing.assert_allclose(found.best.white_reference, WHITE, rtol=0.05)


def test_white_is_as_certain_as_it_says():
    squares = []
    for seed in range(6):
        found = calibrate(*series("clear", noise=0.05, seed=seed), RESPONSE)
        fit = next(c for c in found.candidates if c.water_type == "clear")
        error = (fit.white_reference - WHITE)[[0, 2]]
        squares.append((error / fit.white_reference_stddev[[0, 2]]) ** 2)
    assert 0.5 < np.mean(squares) < 2.0


def test_errors_that_last_make_it_less_certain():
    estimates, depths = series("clear", noise=0.03)
    slow = np.repeat(np.random.default_rng(1).standard_normal(8), 10) * 0.05
    drifting = [
        WaterEstimate(e.status, e.attenuation, e.ambient_light * np.exp([s, 0, -s]), e.covariance,
                      9, 40, e.channel_status)
        for e, s in zip(series("clear", noise=0.003)[0], slow, strict=True)]
    quick = calibrate(estimates, depths, RESPONSE).candidates
    lasting = calibrate(drifting, depths, RESPONSE).candidates
    spread = [next(c for c in found if c.water_type == "clear").white_reference_stddev[0]
              for found in (quick, lasting)]
    assert spread[1] > 1.3 * spread[0]


def test_frames_without_estimate_or_depth_are_left_out():
    estimates, depths = series()
    estimates[3] = WaterEstimate.not_assessable(Status.TOO_DARK)
    depths[7] = np.nan
    # Red has ended, which the status of the frame does not say.
    dark = np.array([np.nan, 1.0, 1.0])
    estimates[9] = replace(
        estimates[9], attenuation=dark * TRUE_ATTENUATION,
        ambient_light=dark * estimates[9].ambient_light)
    found = calibrate(estimates, depths, RESPONSE)
    assert len(found.residuals) == 77
    np.testing.assert_allclose(found.best.white_reference, WHITE, rtol=0.03)
    with pytest.raises(InputError, match="9 of 9 frames"):
        calibrate(*(part[20:29] for part in series()), RESPONSE)
