# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Depth from colour, in water of any kind, against closed forms and samples."""

import math

import numpy as np
import pytest

from uw_visibility.config.parameters import describe
from uw_visibility.config.schema import AssessmentConfig, PipelineConfig
from uw_visibility.errors import InputError
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.optics.water_type import (
    water_type_attenuation,
    water_types,
)
from uw_visibility.status import Status
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility.water.meaning.depth import CLEAR, ESTIMATED, DepthModel, diffuse_attenuation

RESPONSE = load_response("nikon_d5100")
KAPPA = clear_water_attenuation(RESPONSE)
WHITE = np.array([1.4, 1.0, 1.2])
NONE = np.zeros((6, 6))
# Green coastal water: blue goes as fast as red, which no clear water shows.
COASTAL = np.array([0.55, 0.3, 0.42])


def test_the_parameter_knows_every_type_that_is_shipped():
    choices = {i.name: i.choices for i in describe(AssessmentConfig)}["water_type"]
    assert set(choices) == {CLEAR, ESTIMATED, *water_types()}


@pytest.mark.parametrize("depth", [0.5, 3.0, 15.0])
@pytest.mark.parametrize("water_type", [CLEAR, *water_types()])
def test_light_of_a_type_tells_its_depth(water_type, depth):
    rate = diffuse_attenuation(water_type, RESPONSE)
    light = 0.3 * WHITE * np.exp(-rate * depth)
    found, stddev = DepthModel(water_type, RESPONSE, WHITE).depth(COASTAL, light, NONE)
    assert found == pytest.approx(depth, abs=1e-6)
    assert stddev == 0


@pytest.mark.parametrize("depth", [0.5, 3.0, 15.0])
def test_the_estimated_attenuation_tells_the_depth_where_clear_water_does_not(depth):
    light = 0.3 * WHITE * np.exp(-COASTAL * depth)
    found, _ = DepthModel(ESTIMATED, RESPONSE, WHITE).depth(COASTAL, light, NONE)
    assert found == pytest.approx(depth, abs=1e-6)
    clear, _ = DepthModel(CLEAR, RESPONSE, WHITE).depth(COASTAL, light, NONE)
    assert abs(clear - depth) > 0.1 * depth


@pytest.mark.parametrize(("water_type", "depth", "off"), [
    (CLEAR, 2.0, 0.0), (CLEAR, 5.0, 0.1), ("3C", 5.0, 0.1), (ESTIMATED, 2.0, 0.1)])
def test_standard_deviation_is_that_of_samples(water_type, depth, off):
    rng = np.random.default_rng(3)
    rate = COASTAL if water_type == ESTIMATED else diffuse_attenuation(water_type, RESPONSE)
    light = 0.5 * np.exp(-rate * depth) * (1 + off * np.array([-1, 1, -1]))
    centre = np.empty(6)
    centre[0::2], centre[1::2] = COASTAL, light
    root = 2e-3 * np.diag(centre) @ (np.eye(6) + 0.4 * rng.standard_normal((6, 6)))
    covariance = root @ root.T
    model = DepthModel(water_type, RESPONSE)
    _, stddev = model.depth(COASTAL, light, covariance)
    samples = rng.multivariate_normal(centre, covariance, 1500)
    spread = np.std([model.depth(s[0::2], s[1::2], covariance)[0] for s in samples])
    assert stddev == pytest.approx(spread, rel=0.08)


@pytest.mark.parametrize("channel", range(3))
def test_propagation_is_the_derivative(channel):
    light = 0.5 * np.exp(-COASTAL * 4) * [0.9, 1.1, 0.9]
    model = DepthModel(ESTIMATED, RESPONSE)
    for which, step in ((0, 1e-5 * np.eye(3)[channel]), (1, 1e-5 * np.eye(3)[channel])):
        ends = [
            model.depth(COASTAL + sign * step * (which == 0), light + sign * step * (which == 1),
                        NONE)[0] for sign in (1, -1)
        ]
        unit = np.zeros((6, 6))
        unit[2 * channel + which, 2 * channel + which] = 1.0
        stddev = model.depth(COASTAL, light, unit)[1]
        assert stddev == pytest.approx(abs(ends[0] - ends[1]) / 2e-5, rel=1e-3)


def test_attenuation_counts_only_where_it_is_estimated():
    light = np.exp(-COASTAL * 4)
    only_attenuation = np.diag([0.01, 0, 0.01, 0, 0.01, 0])
    assert DepthModel(CLEAR, RESPONSE).depth(COASTAL, light, only_attenuation)[1] == 0
    assert DepthModel(ESTIMATED, RESPONSE).depth(COASTAL, light, only_attenuation)[1] > 0.5


def assess(attenuation, light, deviation):
    covariance = np.diag([deviation**2, (0.01 * light.mean()) ** 2] * 3)
    estimate = WaterEstimate(
        Status.OK, attenuation, light, covariance, 9, 40, (Status.OK,) * 3)
    return Assessor(
        PipelineConfig(assessment=AssessmentConfig(water_type=ESTIMATED))).assess(estimate)


def test_water_that_takes_all_colours_alike_tells_no_depth():
    grey = np.array([0.4, 0.4001, 0.4])
    seen = assess(grey, np.exp(-grey * 5), 0.01)
    assert seen.depth_status is not Status.OK
    assert math.isnan(seen.depth)
    assert math.isfinite(seen.mean_attenuation)
    assert assess(COASTAL, np.exp(-COASTAL * 5), 0.01).depth == pytest.approx(5)


def test_less_light_is_lost_than_a_beam_loses():
    """Forward scattering takes from a beam, not from daylight."""
    for name in water_types():
        diffuse = water_type_attenuation(name, RESPONSE, diffuse=True)
        assert (diffuse < water_type_attenuation(name, RESPONSE)).all()
    # Coastal water takes blue more than green, the ocean the other way round.
    assert water_type_attenuation("5C", RESPONSE, diffuse=True)[2] > 1.1 * (
        water_type_attenuation("5C", RESPONSE, diffuse=True)[1])
    assert water_type_attenuation("IB", RESPONSE, diffuse=True)[2] < (
        water_type_attenuation("IB", RESPONSE, diffuse=True)[1])


def test_an_unknown_type_is_refused():
    with pytest.raises(InputError, match="water type"):
        DepthModel("9Z", RESPONSE)


def deviation(attenuation, depth):
    """Depth by clear water's colour, and its model's standard deviation, where K is β (eq. 2)."""
    model = DepthModel("clear", RESPONSE)
    light = np.exp(-np.asarray(attenuation) * depth)
    found, _ = model.depth(attenuation, light, 1e-8 * np.eye(6))
    stddev, _ = model.model_stddev(found, attenuation, np.full(3, 0.02), light)
    return found, stddev


@pytest.mark.parametrize("depth", [3.0, 6.0, 12.0])
def test_where_yellow_matter_takes_the_blue_depth_by_clear_waters_colour_is_not_sure(depth):
    # Grey particles leave the colour, and so the depth.
    grey, stddev = deviation(KAPPA + 0.2, depth)
    assert grey == pytest.approx(depth, abs=0.01)
    yellow, unsure = deviation(KAPPA + np.array([0.05, 0.16, 0.27]), depth)
    assert depth - yellow > 0.5 * depth
    assert depth - yellow < 3.0 * unsure
    assert depth - yellow > 1.8 * stddev


class TestNeutralLight:
    """It is the surface's, or of a camera that was balanced below water."""

    BALANCED = (1.79, 1.0, 1.35)

    def assessed(self, depth, white=(1.0, 1.0, 1.0), gains=(1.0, 1.0, 1.0)):
        """Depth and its model's standard deviation in turbid coastal water, 3C."""
        diffuse = water_type_attenuation("3C", RESPONSE, diffuse=True)
        light = np.exp(-diffuse * depth) * gains
        attenuation = water_type_attenuation("3C", RESPONSE)
        model = DepthModel("clear", RESPONSE, white)
        found, _ = model.depth(attenuation, light, 1e-8 * np.eye(6))
        return found, model.model_stddev(found, attenuation, np.full(3, 0.05), light)[0]

    def test_of_a_camera_whose_white_is_not_told_it_leaves_depth_open(self):
        depth = 8.0
        diffuse = water_type_attenuation("3C", RESPONSE, diffuse=True)
        found, stddev = self.assessed(depth, gains=np.exp(0.95 * diffuse * depth))
        assert found < 2.0
        assert depth - found < 3.0 * stddev

    def test_of_a_camera_whose_white_is_told_it_does_not(self):
        depth = 0.5
        _, untold = self.assessed(depth)
        _, told = self.assessed(depth, self.BALANCED, self.BALANCED)
        assert told < 0.7 * untold

    def test_coloured_light_is_as_sure_as_before(self):
        (_, untold), (_, told) = (
            self.assessed(6.0, white, white) for white in ((1.0, 1.0, 1.0), self.BALANCED))
        assert untold == pytest.approx(told, rel=0.05)


def test_light_without_red_is_no_error():
    model = DepthModel("clear", RESPONSE)
    stddev, _ = model.model_stddev(
        60.0, KAPPA + 0.1, np.full(3, 0.01), np.array([1e-12, 1e-12, 1.0]))
    assert math.isfinite(stddev)
