# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Water of surveys at nearly constant range, over rendered frames of a varied sea floor."""

import functools
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uw_visibility.config.schema import PipelineConfig, SurveyConfig, WaterConfig
from uw_visibility.images.view import View
from uw_visibility.optics.light_model import transmission
from uw_visibility.status import Status
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility.water.meaning.assessment import Assessor
from uw_visibility.water.series.survey import FrameWindow, Survey

ASSESSOR = Assessor(PipelineConfig())
KAPPA = ASSESSOR.clear_water_attenuation
ESTIMATORS = {
    veil: WaterEstimator(WaterConfig(veil=veil), KAPPA, daylight=ASSESSOR.daylight)
    for veil in ("free", "paper")}
ESTIMATOR = ESTIMATORS["paper"]
RANGE_ERROR = 0.001
WIDTH, HEIGHT = 160, 120


def sea_floor(rng, length):
    """Radiance of a floor of stones and sand of all brightnesses, with dark gaps between."""
    floor = np.empty((2 * HEIGHT, length, 3), np.float32)
    grain = cv2.GaussianBlur(rng.standard_normal(floor.shape[:2]), (0, 0), 2.0)
    sand = 0.45 + 0.1 * grain / grain.std()
    floor[:] = np.clip(sand, 0.05, 1.0)[..., np.newaxis] * (1.0, 0.95, 0.85)
    for _ in range(length // 3):
        centre = (int(rng.integers(length)), int(rng.integers(2 * HEIGHT)))
        axes = (int(rng.integers(4, 26)), int(rng.integers(4, 18)))
        angle = float(rng.integers(180))
        look = rng.uniform(0.05, 1.0) * rng.uniform(0.75, 1.0, 3)
        cv2.ellipse(floor, centre, axes, angle, 0, 360, (0.01, 0.01, 0.01), 3)
        cv2.ellipse(floor, centre, axes, angle, 0, 360, look.tolist(), -1)
    return floor


def survey_frames(seed, mean_attenuation, *, frames=60, amplitude=0.3, exposure=False,
                  sinking=False, veil=1.0, water=None):
    """Yield stamp, image and range of frames 2 m above the floor, which climb and sink.

    The exposure jumps where asked to; or the light changes with the camera's depth. The
    veil is that part of the light on the scene.
    """
    rng = np.random.default_rng(seed)
    floor = sea_floor(rng, 12 * frames + 2 * WIDTH)
    relief = cv2.GaussianBlur(rng.standard_normal(floor.shape[:2]), (0, 0), 12.0)
    relief *= 0.05 / relief.std()
    phase = rng.uniform(0, 2 * np.pi)
    for k in range(frames):
        altitude = 2.0 + amplitude * np.sin(2 * np.pi * k / 17 + phase)
        x, scale = 12 * k, altitude / 2.0
        part = np.s_[0:int(HEIGHT * scale * 1.4), x:x + int(WIDTH * scale * 1.4)]
        radiance = cv2.resize(floor[part], (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        distance = altitude + cv2.resize(relief[part], (WIDTH, HEIGHT))
        alpha = mean_attenuation if water is None else water(k)
        attenuation = KAPPA + alpha
        light = transmission(attenuation, 3.0)
        if sinking:
            light = light * np.exp(-attenuation * (2.0 - altitude))
        left = np.exp(-attenuation * distance[..., np.newaxis])
        irradiance = light * (radiance * left + veil * (1.0 - left))
        if exposure:
            irradiance *= rng.uniform(0.6, 1.0)
        noisy = irradiance + 0.002 * rng.standard_normal(irradiance.shape)
        codes = np.rint(255 * np.clip(noisy, 0, 1)).astype(np.uint8)
        yield float(k), codes, distance.astype(np.float32)


def observed(frames, model="paper"):
    """What the estimator says of each frame alone."""
    return [
        (stamp, ESTIMATORS[model].estimate_view(View.of(image), distance, range_error=RANGE_ERROR))
        for stamp, image, distance in frames]


@functools.cache
def observed_survey(seed, alpha, model="paper", **options):
    return observed(survey_frames(seed, alpha, **options), model)


def surveyed(frames, model="paper", **config):
    survey = Survey(SurveyConfig(**config), ESTIMATORS[model])
    for stamp, alone in frames:
        survey.add(alone, stamp)
    return survey, alone


@pytest.mark.parametrize(("alpha", "light"), [
    (0.1, "constant"), (0.3, "exposure"), (0.1, "sinking")])
def test_a_survey_at_two_metres_shows_the_water(alpha, light):
    options = {} if light == "constant" else {light: True}
    survey, alone = surveyed(observed_survey(0, alpha, **options))
    # A frame by itself does not.
    assert alone.status is Status.RANGE_SPREAD_TOO_SMALL
    found = survey.estimate()
    assert found.water.status is Status.OK
    assert found.frames == 60
    assert found.duration == 59.0
    assert 1.4 < found.range_min < 1.75 < 2.25 < found.range_max < 2.6
    deviation = found.water.attenuation_stddev
    assert np.max(np.abs(found.water.attenuation - KAPPA - alpha) / deviation) < 3.0
    assert np.mean(deviation / found.water.attenuation) < 0.5


@pytest.mark.parametrize(("alpha", "veil", "most"), [
    (0.3, 1.0, 0.4), (0.1, 0.5, 0.75),
])
def test_where_the_veil_may_differ_from_the_light_a_survey_says_less(alpha, veil, most):
    water = surveyed(observed_survey(0, alpha, "free", veil=veil), "free")[0].estimate().water
    assert water.status is Status.OK
    relative = water.attenuation_stddev / water.attenuation
    assert np.max(np.abs(np.log(water.attenuation / (KAPPA + alpha)) / relative)) < 3.0
    assert np.mean(relative) < most


@pytest.mark.parametrize(("veil", "exposure"), [(0.3, True), (1.0, False)])
def test_light_over_altitude_shows_the_water(veil, exposure):
    """Frames of one altitude hardly show it, and each may have an exposure of its own."""
    frames = observed_survey(0, 0.3, "free", veil=veil, amplitude=0.8, exposure=exposure)
    water = surveyed(frames, "free")[0].estimate().water
    assert water.status is Status.OK
    assert np.max(np.abs(np.log(water.attenuation / (KAPPA + 0.3)))) < 0.3
    assert np.max(water.attenuation_stddev / water.attenuation) < 0.4


def test_an_exposure_that_follows_the_altitude_hides_a_part_of_the_attenuation():
    frames = [
        (stamp, (image * (25.0 / image.mean())).astype(np.uint8), distance)
        for stamp, image, distance in survey_frames(0, 0.3, veil=0.3, amplitude=0.8)]
    water = surveyed(observed(frames, "free"), "free")[0].estimate().water
    error = np.log(water.attenuation / (KAPPA + 0.3))
    assert np.min(error) > -0.6
    assert np.min(error * water.attenuation / water.attenuation_stddev) > -2.0


def test_over_sand_without_anything_dark_the_deviation_holds(monkeypatch):
    def sand(rng, length):
        grain = cv2.GaussianBlur(rng.standard_normal((2 * HEIGHT, length)), (0, 0), 2.0)
        shade = np.clip(0.45 + 0.07 * grain / grain.std(), 0.3, 0.6)
        return (shade[..., np.newaxis] * np.ones(3)).astype(np.float32)

    monkeypatch.setitem(globals(), "sea_floor", sand)
    survey, _ = surveyed(observed(survey_frames(1, 0.1), "free"), "free")
    water = survey.estimate().water
    error = (water.attenuation - KAPPA - 0.1) / water.attenuation_stddev
    assert np.max(np.abs(error)) < 3.0


def test_ambient_light_is_that_of_the_newest_frame():
    survey, alone = surveyed(observed_survey(0, 0.3, exposure=True))
    water = survey.estimate().water
    brightest = np.nanmax(alone.envelope.bright, axis=1)
    # Nothing is much brighter than ambient light, and bright patches are nearly as bright.
    assert (np.abs(np.log(water.ambient_light / brightest)) < 0.2).all()


@pytest.mark.parametrize("frames", [8, 19])
def test_too_few_frames_show_nothing(frames):
    survey, _ = surveyed(observed_survey(0, 0.3)[:frames])
    found = survey.estimate()
    assert found.frames == frames
    assert found.water.status is Status.TOO_FEW_OBSERVATIONS
    assert np.isnan(found.water.attenuation).all()


def test_at_constant_range_no_number_of_frames_shows_the_water():
    survey, _ = surveyed(observed_survey(0, 0.2, frames=25, amplitude=0.02))
    assert survey.estimate().water.status is Status.RANGE_SPREAD_TOO_SMALL


def test_frames_leave_the_window():
    frames = observed_survey(0, 0.3)[:30]
    survey, _ = surveyed(frames, window=24.0)
    found = survey.estimate()
    assert (found.frames, found.duration) == (25, 24.0)


def test_an_estimate_is_made_once_in_a_second_of_the_stamps():
    """And its light is that of each frame."""
    survey, _ = surveyed(observed_survey(0, 0.3)[:30])
    first = survey.estimate()
    _, image, distance = next(survey_frames(0, 0.3))
    image = image // 2
    dim = ESTIMATOR.estimate_view(View.of(image), distance, range_error=RANGE_ERROR)
    survey.add(dim, 29.5)
    second = survey.estimate()
    np.testing.assert_array_equal(second.water.attenuation, first.water.attenuation)
    ratio = second.water.ambient_light / first.water.ambient_light
    np.testing.assert_allclose(ratio, 0.5, atol=0.1)
    np.testing.assert_allclose(
        second.water.ambient_light_stddev / first.water.ambient_light_stddev, ratio)
    survey.add(dim, 30.0)
    assert survey.estimate().frames == 32


def test_of_many_frames_a_part_is_kept_over_the_whole_window():
    survey, _ = surveyed(observed_survey(0, 0.3), max_frames=24)
    found = survey.estimate()
    assert found.frames <= 24
    assert found.duration > 40.0


def test_the_same_ground_seen_again_and_again_says_nothing_new():
    """Each frame thrice, one right after the other: as sure as from each once."""
    frames = observed_survey(0, 0.3)[:40]
    thrice = [(stamp + part / 3, *rest) for stamp, *rest in frames for part in range(3)]
    once, again = (
        surveyed(each)[0].estimate().water.attenuation_stddev
        for each in (frames, thrice))
    np.testing.assert_allclose(again, once, rtol=0.15)


@pytest.mark.parametrize(("before", "after"), [(0.1, 0.5), (0.5, 0.1)])
def test_water_that_changes_within_the_window_is_in_the_standard_deviation(before, after):
    changing = survey_frames(0, 0.0, water=lambda k: before if k < 40 else after)
    found = surveyed(observed(changing))[0].estimate().water
    steady = surveyed(observed_survey(0, 0.3))[0].estimate().water
    assert (found.attenuation_stddev > 1.5 * steady.attenuation_stddev).all()
    error = (found.attenuation - KAPPA - after) / found.attenuation_stddev
    assert np.max(np.abs(error)) < 3.0


@pytest.mark.filterwarnings("error")
def test_a_channel_that_is_saturated_is_refused_and_the_others_are_not():
    frames = []
    for stamp, alone in observed_survey(0, 0.3):
        light = alone.blocks.light.copy()
        light[..., 2] = np.minimum(3.0 * light[..., 2], 1.0)
        frames.append((stamp, replace(alone, blocks=alone.blocks._replace(
            light=light, clipped=np.array([0.0, 0.0, 0.9])))))
    water = surveyed(frames)[0].estimate().water
    assert water.channel_status == (Status.OK, Status.OK, Status.SATURATED)
    assert np.isnan(water.attenuation[2])
    error = (water.attenuation - KAPPA - 0.3)[:2] / water.attenuation_stddev[:2]
    assert np.max(np.abs(error)) < 3.0
    assert np.isnan(water.covariance[4:]).all()


def test_an_empty_window_has_no_newest_frame():
    window = FrameWindow(SurveyConfig())
    assert math.isnan(window.newest) and window.duration == 0.0 and len(window) == 0


def test_frames_that_left_the_window_are_forgotten_also_by_a_frame_that_adds_nothing():
    window = FrameWindow(SurveyConfig(window=10.0))
    for stamp in (0.0, 4.0, 9.0):
        window.add(stamp, stamp)
    window.add(None, 12.0)
    assert window.items == [4.0, 9.0]
    assert (window.newest, window.duration) == (9.0, 5.0)


@given(st.lists(st.floats(0.01, 2.0), min_size=1, max_size=60))
def test_thinned_out_frames_keep_the_first_and_last_and_their_order(gaps):
    window = FrameWindow(SurveyConfig(window=600.0, min_frames=2, max_frames=8))
    stamps = [sum(gaps[:i + 1]) for i in range(len(gaps))]
    for stamp in stamps:
        window.add(stamp, stamp)
    assert len(window) == min(len(stamps), 8)
    assert window.items == sorted(window.items)
    assert window.items[0] == stamps[0] and window.items[-1] == stamps[-1]


def test_the_frame_with_the_closest_neighbours_is_left_out():
    window = FrameWindow(SurveyConfig(window=600.0, min_frames=2, max_frames=4))
    for stamp in (0.0, 10.0, 11.0, 12.0, 30.0):
        window.add(stamp, stamp)
    assert window.items == [0.0, 10.0, 12.0, 30.0]
