# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""One light for veil and scene: posterior and dark envelope together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import KAPPA

from uw_visibility.water.daylight.inference import Posterior
from uw_visibility.water.daylight.one_light import NOTHING_EXPECTED, Daylight, fit_one_light
from uw_visibility.water.observations import Envelopes

ALL = np.ones(3, dtype=bool)
RANGES = np.geomspace(1.0, 8.0, 24)


def envelope(attenuation, light, radiance=0.0, brightest=0.9, range_error=0.0, code=1 / 255):
    """Envelopes of darkest patches of a radiance, (24,) or one, and of bright ones."""
    direct = light[:, np.newaxis] * np.exp(-attenuation[:, np.newaxis] * RANGES)
    veil = light[:, np.newaxis] - direct
    flat = np.broadcast_to(RANGES, (3, len(RANGES)))
    step = np.full((3, len(RANGES)), code)
    return Envelopes(
        RANGES, np.full(len(RANGES), 100), veil + radiance * direct, flat,
        veil + brightest * direct, step, 0.5 * step, np.zeros(3), np.zeros(3), False, (1.0, 8.0),
        range_error)


def posterior(attenuation, light, deviation=0.5):
    """A posterior that knows each of ln β, ln B and ln W with the same deviation."""
    mean = np.stack((np.log(attenuation), np.log(light), np.log(light)), axis=1)
    return Posterior(mean, deviation**2 * np.eye(9), mean[np.newaxis], np.ones(1))


def fitted(seen, expected, daylight=None, tolerance=0.15, channels=ALL):
    return fit_one_light(expected, seen, channels, daylight, tolerance)


@given(st.floats(0.03, 0.5), st.floats(0.5, 6.0), st.floats(-0.4, 0.4), st.floats(-0.2, 0.2))
@settings(max_examples=40, deadline=None)
def test_black_patches_give_the_water_wherever_the_posterior_is(alpha, depth, off, of_light):
    beta = KAPPA + alpha
    light = np.exp(-KAPPA * depth)
    parameters, covariance = fitted(
        envelope(beta, light), posterior(beta * np.exp(off), light * np.exp(of_light)))
    error = np.abs(parameters[:, 0] - beta)
    deviation = np.sqrt(np.diag(covariance)[0::2])
    assert (error < 0.12 * beta).all()
    assert (error < 2.0 * deviation).all()


def test_patches_that_are_not_black_hardly_count():
    beta, light = KAPPA + 0.2, np.array([0.5, 0.8, 0.9])
    rng = np.random.default_rng(0)
    radiance = np.where(rng.random(24) < 0.4, rng.uniform(0.1, 0.5, 24), 0.0)
    parameters, _ = fitted(envelope(beta, light, radiance), posterior(beta * 1.2, light))
    np.testing.assert_allclose(parameters[:, 0], beta, rtol=0.15)


def test_bins_below_black_lose_their_weight():
    beta, light = KAPPA + 0.2, np.array([0.5, 0.8, 0.9])
    seen = envelope(beta, light, range_error=1e-3)
    seen.dark[:, 5] *= 0.2
    parameters, _ = fitted(seen, posterior(beta * 1.2, light))
    np.testing.assert_allclose(parameters[:, 0], beta, rtol=0.08)


def test_the_deviation_grows_with_range_error_coarse_codes_and_what_is_not_black():
    beta, light = KAPPA + 0.4, np.array([0.5, 0.8, 0.9])

    def deviation(**how):
        covariance = fitted(envelope(beta, light, **how), posterior(beta, light))[1]
        assert (np.linalg.eigvalsh(covariance) > 0).all()
        return np.sqrt(np.diag(covariance)[0::2])

    exact = deviation()
    assert np.linalg.norm(deviation(range_error=0.05)) > 1.1 * np.linalg.norm(exact)
    assert np.linalg.norm(deviation(code=16 / 255)) > 1.1 * np.linalg.norm(exact)
    assert np.linalg.norm(deviation(radiance=0.1)) > 1.1 * np.linalg.norm(exact)


def test_light_is_not_below_the_bright_envelope():
    beta, light = KAPPA + 0.1, np.array([0.5, 0.8, 0.9])
    seen = envelope(beta, light, brightest=1.0)
    parameters, _ = fitted(seen, posterior(beta, 0.7 * light))
    assert (parameters[:, 1] > 0.97 * light).all()


def test_a_channel_that_is_not_seen_keeps_its_posterior():
    beta, light = KAPPA + 0.1, np.array([0.5, 0.8, 0.9])
    seen = envelope(beta, light)
    seen.dark[0] = 0.0
    parameters, _ = fitted(
        seen, posterior(beta * 1.3, light), channels=np.array([False, True, True]))
    assert parameters[0, 0] == pytest.approx(1.3 * beta[0], rel=1e-3)
    np.testing.assert_allclose(parameters[1:, 0], beta[1:], rtol=0.08)


def test_daylight_tells_the_light_of_a_channel_in_which_no_veil_shows():
    depth, reference = 4.0, np.array([0.8, 1.0, 1.3])
    light = reference * np.exp(-KAPPA * depth)
    told = light * [1.0, 1.0, 0.6]
    seen = envelope(KAPPA, light, brightest=0.5)

    def blue(daylight, tolerance=0.05):
        parameters, _ = fitted(seen, posterior(KAPPA, told), daylight, tolerance)
        return abs(np.log(parameters[2, 1] / light[2]))

    assert blue(Daylight(reference, KAPPA)) < 0.6 * blue(None)
    assert blue(Daylight(reference, KAPPA)) < blue(Daylight(np.ones(3), KAPPA))
    assert blue(Daylight(reference, KAPPA), NOTHING_EXPECTED) == pytest.approx(
        blue(None), abs=1e-3)


def test_the_waters_own_attenuation_can_stand_for_that_above():
    direction, value = Daylight(np.ones(3), None).colour(np.array([0.4, 0.2, 0.1]))
    assert value == 0.0
    # Neither brightness nor depth changes the colour along it.
    assert direction.sum() == pytest.approx(0.0, abs=1e-12)
    assert direction @ [0.4, 0.2, 0.1] == pytest.approx(0.0, abs=1e-12)
