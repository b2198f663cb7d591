# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Fits against closed forms and against scipy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import KAPPA
from scipy.optimize import least_squares

from uw_visibility.water.daylight.fit import ATTENUATION_BOUNDS, fit_plain
from uw_visibility.water.daylight.lower_envelope import fit_lower_envelope

ALL = np.ones(3, dtype=bool)
DEVIATION = 1.04 / 255


def curve(beta, ambient, distance):
    return ambient[:, np.newaxis] * (1 - np.exp(-np.outer(beta, distance)))


def lower(
    distance, dark, ambient_min, active=ALL, start=None, range_error=0.0, deviation=DEVIATION
):
    start = np.stack((KAPPA, ambient_min), axis=1) if start is None else start
    return fit_lower_envelope(
        np.tile(distance, (3, 1)), dark, np.full(dark.shape, deviation), ambient_min, start, KAPPA,
        active, range_error)


def plain(distance, dark, ambient_min, active=ALL):
    return fit_plain(distance, dark, ambient_min, np.stack((KAPPA, ambient_min), axis=1), active)


waters = st.tuples(st.floats(0.0, 0.6), st.floats(0.5, 6.0), st.floats(2.0, 5.0))


@given(waters)
@settings(max_examples=12, deadline=None)
def test_black_patches_give_the_water_exactly(water):
    alpha, depth, stretch = water
    beta = KAPPA + alpha
    ambient = np.exp(-beta * depth)
    distance = np.linspace(1.5, 1.5 * stretch, 40)
    dark = curve(beta, ambient, distance)
    # A white patch: the bright envelope is the ambient light itself.
    np.testing.assert_allclose(
        plain(distance, dark, ambient).parameters[:, 0], beta, rtol=0.02, atol=2e-3)
    found = lower(distance, dark, ambient)
    np.testing.assert_allclose(found.parameters[:, 0], beta, rtol=1e-4)
    np.testing.assert_allclose(found.parameters[:, 1], ambient, rtol=1e-4)
    assert found.converged


def test_ambient_light_beyond_the_bright_patch_comes_from_the_course_over_range():
    beta = KAPPA + 0.4
    ambient = np.array([0.5, 0.7, 0.8])
    distance = np.linspace(0.5, 12, 48)
    dark = curve(beta, ambient, distance)
    for found in (plain(distance, dark, 0.6 * ambient), lower(distance, dark, 0.6 * ambient)):
        np.testing.assert_allclose(found.parameters[:, 1], ambient, rtol=0.02)
        np.testing.assert_allclose(found.parameters[:, 0], beta, rtol=0.04)


def test_ambient_light_is_bounded_by_the_bright_patch():
    distance = np.linspace(1, 8, 40)
    dark = curve(KAPPA + 0.2, np.array([0.3, 0.3, 0.3]), distance)
    for found in (plain(distance, dark, np.full(3, 0.5)), lower(distance, dark, np.full(3, 0.5))):
        assert (found.parameters[:, 1] >= 0.5).all()


def noisy(seed=0, alpha=0.2, darkness=0.05):
    rng = np.random.default_rng(seed)
    beta = KAPPA + alpha
    ambient = np.exp(-2 * beta)
    distance = np.linspace(2, 9, 40)
    rho = rng.exponential(darkness, (3, 40))
    dark = curve(beta, ambient, distance) + (
        ambient[:, np.newaxis] * rho * np.exp(-np.outer(beta, distance)))
    return beta, ambient, distance, dark


@pytest.mark.parametrize("seed", range(5))
def test_what_is_not_black_misleads_the_lower_envelope_less_than_the_plain_fit(seed):
    beta, ambient, distance, dark = noisy(seed)
    errors = [
        np.abs(found.parameters[:, 0] - beta).mean()
        for found in (plain(distance, dark, ambient), lower(distance, dark, ambient))
    ]
    assert errors[1] < 0.4 * errors[0]


@pytest.mark.parametrize("loosest", [1.0, 0.7])
def test_the_minimum_is_that_which_scipy_finds(loosest):
    """One channel; the cost is written out once more, with scales at the solution."""
    _, ambient, distance, dark = noisy(3)
    bound = loosest * ambient
    active = np.array([False, True, False])
    found = lower(distance, dark, bound, active).parameters[1]

    direct = found[1] * np.exp(-found[0] * distance)
    below = np.sqrt(DEVIATION**2 + (0.01 * direct) ** 2)
    above = np.sqrt(DEVIATION**2 + (0.2 * direct) ** 2)
    informative = direct > 5 * DEVIATION
    radiance = (dark[1] - found[1] + direct) / direct
    expected = 0.2 * np.median(np.clip(radiance[informative], 0, 1))

    def residual(p):
        r = dark[1] - p[1] * (1 - (1 - expected) * np.exp(-p[0] * distance))
        low = (r / below) ** 2 / (1 + (r / (5 * below)) ** 2)
        high = 0.25**2 * np.log1p((r / (0.25 * above)) ** 2)
        data = np.sqrt(np.where(r < 0, low, high))
        prior = [(p[1] / bound[1] - 1) / 0.5, min(p[0] / KAPPA[1] - 1, 0) / 0.1]
        return np.concatenate((data, prior))

    reference = least_squares(
        residual, found * [1.003, 1.001], bounds=([1e-4, bound[1]], [10, 2]),
        xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found, reference.x, rtol=2e-3)
    assert 0.5 * (residual(found) ** 2).sum() <= reference.cost * (1 + 1e-4)


def test_twelve_iterations_are_typical():
    counts = [lower(*noisy(seed)[2:4], noisy(seed)[1]).iterations for seed in range(10)]
    assert np.median(counts) <= 14


def test_a_start_elsewhere_ends_at_the_same_place():
    _, ambient, distance, dark = noisy(1)
    first = lower(distance, dark, ambient).parameters
    for start in (first * [3.0, 1.3], first * [0.3, 1.0]):
        again = lower(distance, dark, ambient, start=start).parameters
        np.testing.assert_allclose(again, first, rtol=2e-4)


def test_channels_left_out_are_not_invented():
    _, ambient, distance, dark = noisy()
    active = np.array([False, True, True])
    for fit in (plain, lower):
        found = fit(distance, dark, ambient, active)
        assert np.isnan(found.parameters[0]).all()
        assert np.isnan(found.covariance[0]).all()
        assert np.isfinite(found.parameters[1:]).all()
        assert np.isfinite(found.covariance[2:, 2:]).all()


def test_bins_that_a_channel_lacks_are_left_out():
    beta, ambient, distance, _ = noisy()
    dark = curve(beta, ambient, distance)
    dark[0, ::3] = np.nan
    for fit in (plain, lower):
        assert fit(distance, dark, ambient).parameters[0, 0] == pytest.approx(beta[0], rel=0.02)


def test_covariance_is_a_covariance_and_grows_with_range_error_and_coarse_codes():
    _, ambient, distance, dark = noisy()
    fine = lower(distance, dark, ambient).covariance
    np.testing.assert_allclose(fine, fine.T, atol=1e-12)
    assert (np.linalg.eigvalsh(fine) > -1e-12).all()
    coarse = lower(distance, dark, ambient, deviation=10 * DEVIATION).covariance
    loose = lower(distance, dark, ambient, range_error=0.05).covariance
    assert np.trace(coarse) > np.trace(fine)
    assert np.trace(loose) > np.trace(fine)


def test_a_standard_deviation_covers_the_error_that_darkness_makes():
    ratios = []
    for seed in range(40):
        beta, ambient, distance, dark = noisy(seed, darkness=0.03)
        found = lower(distance, dark, ambient)
        ratios.append(np.abs(found.parameters[:, 0] - beta)
                      / np.sqrt(np.diag(found.covariance)[0::2]))
    assert np.mean(np.array(ratios) < 1) >= 0.6
    assert np.mean(np.array(ratios) < 2) >= 0.9


def test_attenuation_stays_within_its_bounds():
    distance = np.linspace(1, 3, 20)
    dark = np.full((3, 20), 0.5)
    found = lower(distance, dark, np.full(3, 0.5))
    assert (found.parameters[:, 0] <= ATTENUATION_BOUNDS[1]).all()
    assert np.isfinite(found.parameters).all()



def test_a_few_wrong_matches_among_measured_ranges_hardly_count():
    """They put near, dark patches where only light ones are; exact ranges hold no such."""
    beta = KAPPA + 0.2
    ambient = np.exp(-2 * beta)
    distance = np.linspace(4, 13, 40)
    left = np.exp(-np.outer(beta, distance))

    def attenuation(rho, range_error):
        dark = ambient[:, np.newaxis] * (1.0 - (1.0 - rho) * left)
        return lower(
            distance, dark, 0.99 * ambient, range_error=range_error, deviation=0.3 / 255,
        ).parameters[:, 0]

    moved = []
    for range_error in (1e-3, 0.0):
        shifts = []
        for seed in range(10):
            rho = np.random.default_rng(seed).uniform(0.05, 0.35, left.shape)
            wrong = rho.copy()
            wrong[:, 12:14] = -0.3
            shifts.append(attenuation(wrong, range_error) - attenuation(rho, range_error))
        moved.append(np.abs(shifts).mean())
    assert moved[0] < 0.6 * moved[1]


class TestWhitePatch:
    """Ground before a grey wall, whose darkest patches look like water that ends there."""

    DISTANCE = np.concatenate((np.linspace(3.0, 6.8, 30), np.linspace(8.0, 8.7, 6)))
    BETA, AMBIENT = KAPPA + 0.1, np.array([0.52, 0.72, 0.78])

    def light_errors(self, seed, glint=0.0):
        """Relative errors of I∞ with the bright envelope and without; white is at 5 m."""
        rng = np.random.default_rng(seed)
        left = np.exp(-np.outer(self.BETA, self.DISTANCE))

        def seen(radiance):
            return self.AMBIENT[:, np.newaxis] * (1.0 - (1.0 - radiance) * left)

        dark = seen(np.where(self.DISTANCE > 7.0, 0.42, rng.uniform(0.02, 0.22, left.shape)))
        bright = seen(np.where(np.abs(self.DISTANCE - 5.0) < 0.2, 0.95, 0.6))
        bright[:, 10] += glint * self.AMBIENT
        bound = np.sort(bright)[:, -3]
        ranges = np.tile(self.DISTANCE, (3, 1))
        patches = np.stack((ranges, bright, np.full(bright.shape, 1 / 255)), axis=2)
        return [
            fit_lower_envelope(
                ranges, dark, np.full(dark.shape, 0.3 / 255), bound,
                np.stack((KAPPA, bound), axis=1), KAPPA, ALL, 1e-3, patches=shown,
            ).parameters[:, 1] / self.AMBIENT - 1.0
            for shown in (patches, None)
        ]

    def test_white_tells_the_light_where_the_darkest_patches_do_not(self):
        errors = np.square([self.light_errors(seed) for seed in range(40)])
        with_white, without = np.sqrt(errors.mean(axis=(0, 2)))
        assert with_white < 0.6 * without

    def test_a_glint_brighter_than_the_light_is_no_white_patch(self):
        plain, glint = (self.light_errors(0, glint)[0] for glint in (0.0, 0.4))
        np.testing.assert_allclose(glint, plain, atol=2e-3)
