# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Visibility and depth against closed forms, and their standard deviations against sampling."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uw_visibility.config.schema import AssessmentConfig, CameraConfig, PipelineConfig
from uw_visibility.optics.light_model import transmission, visibility_distance
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor

ASSESSOR = Assessor(PipelineConfig())
KAPPA = ASSESSOR.clear_water_attenuation


def estimate(attenuation, ambient_light, covariance=None):
    if covariance is None:
        covariance = np.diag([0.01**2, 0.002**2] * 3)
    return WaterEstimate(
        Status.OK, np.array(attenuation, dtype=float), np.array(ambient_light, dtype=float),
        covariance, 12, 40, (Status.OK,) * 3)


@given(st.floats(0, 0.5), st.floats(0, 30), st.floats(0.2, 1))
@settings(deadline=None)
def test_the_model_water_is_assessed_exactly(alpha, depth, light):
    beta = KAPPA + alpha
    ambient = light * transmission(beta, depth)
    seen = ASSESSOR.assess(estimate(beta, ambient, np.zeros((6, 6))))
    assert seen.status is Status.OK
    assert seen.depth_status is Status.OK
    assert seen.mean_attenuation == pytest.approx(alpha, abs=1e-12)
    assert seen.distance == pytest.approx(math.log(10.5) / beta.min())
    assert seen.depth == pytest.approx(depth, abs=1e-6)
    assert seen.depth_stddev == 0


def test_contrast_is_a_parameter():
    other = Assessor(PipelineConfig(assessment=AssessmentConfig(contrast=0.02)))
    seen = other.assess(estimate([0.5, 0.4, 0.3], [0.5, 0.6, 0.7]))
    assert seen.distance == pytest.approx(math.log(0.98 / 0.04 + 1) / 0.3)


def test_the_white_reference_is_divided_out():
    white = (2.0, 1.0, 1.4)
    assessor = Assessor(PipelineConfig(camera=CameraConfig(white_reference=white)))
    ambient = np.array(white) * transmission(KAPPA + 0.2, 4.0)
    assert assessor.assess(estimate(KAPPA + 0.2, ambient)).depth == pytest.approx(4)
    assert abs(ASSESSOR.assess(estimate(KAPPA + 0.2, ambient)).depth - 4) > 0.5


def test_depth_ends_at_the_surface_and_at_the_largest_depth():
    assert ASSESSOR.assess(estimate(KAPPA, [1.0, 0.5, 0.5])).depth == 0
    shallow = Assessor(PipelineConfig(assessment=AssessmentConfig(max_depth=5.0)))
    ambient = transmission(KAPPA, 20.0)
    narrow = np.diag([1e-4, 1e-8] * 3)
    assert shallow.assess(estimate(KAPPA, ambient, narrow)).depth == 5


@pytest.mark.parametrize("depth", [1.0, 12.0])
def test_standard_deviations_are_those_of_samples(depth):
    rng = np.random.default_rng(0)
    beta = KAPPA + 0.15
    ambient = transmission(beta, depth)
    root = 1e-3 * np.diag(np.stack((beta, ambient), axis=1).ravel()) @ (
        np.eye(6) + 0.4 * rng.standard_normal((6, 6)))
    joint = root @ root.T
    seen = ASSESSOR.assess(estimate(beta, ambient, joint))
    centre = np.stack((beta, ambient), axis=1).ravel()
    samples = rng.multivariate_normal(centre, joint, 1200)
    found = [ASSESSOR.assess(estimate(s[0::2], s[1::2], joint)) for s in samples]
    for name in ("mean_attenuation", "distance", "depth"):
        spread = np.std([getattr(visibility, name) for visibility in found])
        assert getattr(seen, f"{name}_stddev") == pytest.approx(spread, rel=0.08), name


@pytest.mark.parametrize("part", [0.05, 0.2, 0.4])
def test_a_distance_lies_in_the_interval_of_attenuations_one_deviation_off(part):
    covariance = np.diag([(0.3 * part) ** 2, 1e-6] * 3)
    seen = ASSESSOR.assess(estimate([0.5, 0.4, 0.3], [0.5, 0.6, 0.7], covariance))
    # Attenuation is uncertain by a factor.
    drawn = 0.3 * np.exp(part * np.random.default_rng(0).standard_normal(100_000))
    nearer, farther = np.quantile(seen.distance * 0.3 / drawn, (0.16, 0.84))
    assert seen.distance_low == pytest.approx(nearer, rel=0.01)
    assert seen.distance_high == pytest.approx(farther, rel=0.01)
    assert seen.distance_stddev == pytest.approx((farther - nearer) / 2, rel=0.03)


@pytest.mark.parametrize("variance", [1.0, 1e6, 1e300])
def test_a_distance_of_which_nothing_is_known_is_refused(variance):
    """The exponential of its deviation is beyond any number."""
    covariance = np.diag([variance, 1e-6] * 3)
    seen = ASSESSOR.assess(estimate([0.5, 0.4, 0.3], [0.5, 0.6, 0.7], covariance))
    assert seen.status is Status.ATTENUATION_UNCERTAIN
    assert math.isnan(seen.distance) and math.isnan(seen.distance_high)


def test_a_distance_has_the_interval_that_the_posterior_tells():
    covariance = np.diag([1e-4, 1e-6] * 3)
    told = replace(
        estimate([0.5, 0.4, 0.3], [0.5, 0.6, 0.7], covariance),
        clearest=-np.log((0.4, 0.3, 0.25)))
    seen = ASSESSOR.assess(told)
    found = np.array((seen.distance_low, seen.distance, seen.distance_high))
    np.testing.assert_allclose(
        found, [visibility_distance(beta, 0.05) for beta in (0.4, 0.3, 0.25)])
    wide = ASSESSOR.assess(replace(told, clearest=-np.log((0.8, 0.3, 0.15))))
    assert wide.status is Status.ATTENUATION_UNCERTAIN
    assert math.isnan(wide.distance_low) and math.isnan(wide.distance)


@pytest.mark.parametrize("reason", [s for s in Status if s is not Status.OK])
def test_what_was_not_estimated_is_not_assessed(reason):
    seen = ASSESSOR.assess(WaterEstimate.not_assessable(reason))
    assert seen.status is seen.depth_status is reason
    assert seen.channels == ""
    numbers = dataclasses.astuple(seen)[2:-1]
    assert all(math.isnan(number) for number in numbers)


def test_a_channel_without_light_leaves_what_the_others_say():
    daylight = np.exp(-8.0 * ASSESSOR.clear_water_attenuation)
    whole = estimate([0.9, 0.4, 0.3], daylight)
    covariance = whole.covariance.copy()
    covariance[:2] = covariance[:, :2] = np.nan
    part = dataclasses.replace(
        whole, status=Status.OK, attenuation=np.array([np.nan, 0.4, 0.3]),
        ambient_light=np.array([np.nan, *daylight[1:]]), covariance=covariance,
        channel_status=(Status.TOO_DARK, Status.OK, Status.OK))
    seen = ASSESSOR.assess(part)
    assert seen.status is seen.depth_status is Status.OK
    assert seen.channels == "GB"
    assert seen.distance == ASSESSOR.assess(whole).distance
    clear = ASSESSOR.clear_water_attenuation
    assert seen.mean_attenuation == pytest.approx(0.35 - clear[1:].mean())
    # Green and blue tell the depth, though less of it than red does.
    assert seen.depth == pytest.approx(8.0, abs=0.01)
    assert seen.depth_stddev > ASSESSOR.assess(whole).depth_stddev
    blind = dataclasses.replace(part, channel_status=(Status.SATURATED, Status.OK, Status.OK))
    assert math.isnan(ASSESSOR.assess(blind).distance)


def test_a_distance_without_hold_is_refused():
    loose = np.diag([0.5**2, 0.002**2] * 3)
    seen = ASSESSOR.assess(estimate([0.5, 0.4, 0.3], [0.5, 0.6, 0.7], loose))
    assert math.isnan(seen.distance)
    assert seen.status is Status.ATTENUATION_UNCERTAIN
    assert math.isfinite(seen.depth)


def test_a_depth_without_hold_is_refused():
    loose = np.diag([0.01**2, 10.0**2] * 3)
    seen = ASSESSOR.assess(estimate([0.5, 0.4, 0.3], [0.5, 0.6, 0.7], loose))
    assert math.isnan(seen.depth)
    assert seen.depth_status is Status.AMBIENT_LIGHT_UNBOUNDED
    assert seen.status is Status.OK
