# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Estimates from whole images: closed forms, refusals, robustness."""

import threading

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scenes import KAPPA

from uw_visibility.config.schema import WaterConfig
from uw_visibility.images.view import View
from uw_visibility.status import Status
from uw_visibility.water.daylight.estimation import WaterEstimator
from uw_visibility_lab.evaluation.degrade import load_scene
from uw_visibility_lab.evaluation.fits import fit_plain


def estimator(**settings):
    """One light for veil and scene; see test_coverage for the posterior."""
    return WaterEstimator(WaterConfig(**({"veil": "paper"} | settings)), KAPPA)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("alpha", [0.0, 0.15, 0.4])
def test_perfect_patches_give_the_water(make_view, dtype, alpha):
    view = make_view(alpha)
    found = estimator().estimate_view(View.of(view.codes(dtype)), view.range, range_error=0.0)
    assert found.status is Status.OK
    assert found.channel_status == (Status.OK,) * 3
    # The posterior, which presumes less, draws clear water's.
    np.testing.assert_allclose(found.attenuation, view.attenuation, atol=0.036)
    # In clear water no light shows its level.
    off = np.abs(found.ambient_light - view.ambient_light) / view.ambient_light
    assert (off < (0.35 if alpha == 0.0 else 0.05)).all()
    off = np.abs(found.attenuation - view.attenuation)
    assert (off < 2.0 * found.attenuation_stddev).all()
    assert (found.ambient_light_stddev >= 0).all()
    assert found.bins >= 20
    assert found.iterations >= 1


def test_encoded_images_are_decoded(make_view):
    view = make_view()
    encoded = np.where(view.irradiance <= 0.0031308, 12.92 * view.irradiance,
                       1.055 * view.irradiance ** (1 / 2.4) - 0.055)
    image = (encoded * 255 + 0.5).astype(np.uint8)
    found = estimator().estimate_view(View.of(image, "srgb"), view.range, range_error=0.0)
    np.testing.assert_allclose(found.attenuation, view.attenuation, atol=0.02)
    wrong = estimator().estimate_view(View.of(image), view.range, range_error=0.0)
    assert not np.allclose(wrong.attenuation, view.attenuation, atol=0.05)


def test_unknown_ranges_and_masked_pixels_do_not_matter(make_view):
    view = make_view()
    image, distance = view.codes(), view.range.copy()
    image[:80] = 3
    distance[:40] = np.nan
    valid = np.ones(distance.shape, dtype=bool)
    valid[40:80] = False
    found = estimator().estimate_view(View.of(image, valid=valid), distance, range_error=0.0)
    np.testing.assert_allclose(found.attenuation, view.attenuation, atol=0.03)


def test_a_grey_image_has_one_attenuation(make_view):
    view = make_view()

    def estimate(grey, ranges):
        view = View.of(np.ascontiguousarray(grey))
        return estimator().estimate_grey_view(view, ranges, range_error=0.0)

    for channel in (1, 2):
        found = estimate(view.codes()[..., channel], view.range)
        assert found[0] == pytest.approx(view.attenuation[channel], abs=0.02)
        assert found[1] == pytest.approx(view.ambient_light[channel], rel=0.05)
    grey = view.codes()[..., 1]
    assert estimate(grey, np.full_like(view.range, 3)) is None
    assert estimate(np.zeros_like(grey), view.range) is None
    assert estimate(np.full_like(grey, 255), view.range) is None


def test_one_estimator_serves_many_threads(make_view):
    views = [make_view(alpha) for alpha in (0.05, 0.1, 0.2, 0.3)]
    shared = estimator()
    alone = [shared.estimate_view(
        View.of(v.codes()), v.range, range_error=0.0).attenuation for v in views]
    found = [None] * 8

    def work(index):
        view = views[index % 4]
        found[index] = shared.estimate_view(
            View.of(view.codes()), view.range, range_error=0.0).attenuation

    threads = [threading.Thread(target=work, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for index in range(8):
        np.testing.assert_array_equal(found[index], alone[index % 4])


def status_of(image, distance, **settings):
    found = estimator(**settings).estimate_view(View.of(image), distance, range_error=0.0)
    if found.status is not Status.OK:
        refused = np.array([s is not Status.OK for s in found.channel_status])
        assert np.isnan(found.attenuation[refused]).all()
        assert np.isnan(found.ambient_light[refused]).all()
        assert np.isnan(found.covariance[np.repeat(refused, 2)]).all()
        assert np.isfinite(found.attenuation[~refused]).all()
    return found.status


class TestRefusals:
    def test_no_colour(self, make_view):
        view = make_view()
        grey = view.codes()[:, :, 1].copy()
        assert status_of(grey, view.range) is Status.NO_COLOUR
        three = np.repeat(grey[..., np.newaxis], 3, axis=2)
        assert status_of(three, view.range) is Status.NO_COLOUR

    def test_no_ranges(self, make_view):
        view = make_view()
        unknown = np.full_like(view.range, np.nan)
        assert status_of(view.codes(), unknown) is Status.TOO_FEW_OBSERVATIONS
        unknown[100:110, 100:110] = view.range[100:110, 100:110]
        assert status_of(view.codes(), unknown) is Status.TOO_FEW_OBSERVATIONS

    def test_a_flat_wall(self, make_view):
        view = make_view(nearest=3.0, farthest=3.05)
        assert status_of(view.codes(), view.range) is Status.RANGE_SPREAD_TOO_SMALL
        same = np.full_like(view.range, 3)
        assert status_of(view.codes(), same) is Status.RANGE_SPREAD_TOO_SMALL

    def test_all_black(self, make_view):
        view = make_view()
        assert status_of(np.zeros_like(view.codes()), view.range) is Status.TOO_DARK

    def test_too_dark_for_one_channel(self, make_view):
        view = make_view(alpha=0.2, depth=12.0)
        found = estimator().estimate_view(View.of(view.codes()), view.range, range_error=0.0)
        assert found.channel_status[0] is Status.TOO_DARK
        assert found.channel_status[2] is Status.OK
        # Water took the red: what green and blue say stands.
        assert found.status is Status.OK
        assert np.isnan(found.attenuation[0])
        # 17 code values of blue are left.
        off = abs(found.attenuation[2] - view.attenuation[2])
        assert off < 0.06
        assert off < 2.0 * found.attenuation_stddev[2]

    def test_saturated(self, make_view):
        view = make_view()
        white = np.full_like(view.codes(), 255)
        white[0, 0] = 254, 255, 255
        assert status_of(white, view.range) is Status.SATURATED
        image = view.codes()
        image[..., 2] = 255
        found = estimator().estimate_view(View.of(image), view.range, range_error=0.0)
        assert found.channel_status == (Status.OK, Status.OK, Status.SATURATED)


def test_dark_scenes_near_by_are_refused(make_view):
    """Everything is about as dark, near, in clear water: nothing tells how much light there is."""
    view = make_view(alpha=0.0, nearest=0.5, farthest=1.0, darkest=0.1, brightest=0.11)
    found = estimator(veil="free").estimate_view(
        View.of(view.codes(np.uint16)), view.range, range_error=0.0)
    assert found.status is Status.ATTENUATION_UNCERTAIN


@pytest.mark.parametrize("value", [0, 1, 77, 254, 255])
def test_a_constant_image_is_refused(make_view, value):
    view = make_view()
    image = np.full_like(view.codes(), value)
    assert status_of(image, view.range) is not Status.OK
    image[..., 0] = 30
    assert status_of(image, view.range) is not Status.OK


pixels = st.integers(0, 255)


@given(
    image=arrays.arrays(np.uint8, (40, 50, 3), elements=pixels, fill=pixels),
    distance=arrays.arrays(
        np.float32, (40, 50), elements=st.floats(width=32), fill=st.floats(width=32)),
)
@settings(max_examples=60, deadline=None)
def test_whatever_comes_in_no_unannounced_nan_comes_out(image, distance):
    found = estimator().estimate_view(View.of(image), distance, range_error=0.0)
    ok = np.array([s is Status.OK for s in found.channel_status])
    assert np.isfinite(found.attenuation[ok]).all()
    both = np.repeat(ok, 2)
    assert np.isfinite(found.covariance[np.ix_(both, both)]).all()
    assert np.isnan(found.attenuation[~ok]).all()
    assert (found.status is Status.OK) == ok.all()


SCENES = ("aloe", "art", "dolls", "moebius")


@pytest.fixture(scope="module")
def scenes(shared_data):
    return [load_scene(shared_data / "middlebury" / name) for name in SCENES]


@pytest.mark.long
def test_with_exact_range_one_light_improves_on_the_papers_plain_fit(scenes):
    plain, better = [], []
    for scene in scenes:
        distance = scene.rig.range_from_disparity(scene.disparity_left)
        for alpha in (0.0, 0.1, 0.2, 0.3):
            image, _ = scene.degraded(alpha, 2.0, KAPPA)
            estimate = estimator().estimate_view(View.of(image), distance, range_error=0.0)
            assert estimate.status is Status.OK, (scene.name, alpha, estimate.channel_status)
            better.append(np.mean(estimate.attenuation - KAPPA) - alpha)
            plain.append(np.mean(fit_plain(image, distance, KAPPA).attenuation - KAPPA) - alpha)
    plain, better = np.abs(plain), np.abs(better)
    assert plain.mean() < 0.05
    assert better.mean() <= 0.0105
    assert better.max() <= 0.04
    assert better.mean() < 0.3 * plain.mean()


def test_ranges_that_a_window_carried_over_edges_do_not_mislead(make_view):
    """A dark thing near by, whose range at its border is that of what lies behind."""
    view = make_view(alpha=0.2, nearest=3.0)
    image, distance = view.codes(), view.range.copy()
    near = np.zeros(distance.shape, dtype=bool)
    for row in range(30, 330, 40):
        near[row:row + 20, 40:300] = True
    airlight = view.ambient_light * (1 - np.exp(-view.attenuation * 1.5))
    image[near] = airlight * 255 + 0.5
    distance[near] = 1.5
    eroded = cv2.erode(near.astype(np.uint8), np.ones((7, 7))) > 0
    distance[near & ~eroded] = view.range[near & ~eroded]
    found = estimator().estimate_view(View.of(image), distance, range_error=0.001)
    np.testing.assert_allclose(found.attenuation, view.attenuation, atol=0.03)


@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.35])
def test_noise_does_not_pull_the_envelope_down(make_view, alpha):
    """Far away only ambient light and noise are left; they must not count as dark."""
    view = make_view(alpha=alpha, farthest=20.0, size=(480, 640), planes=40)
    rng = np.random.default_rng(0)
    noisy = view.irradiance * 255 + rng.normal(0, 1.7, view.irradiance.shape)
    image = np.clip(noisy + 0.5, 0, 255).astype(np.uint8)
    found = estimator().estimate_view(View.of(image), view.range, range_error=0.0)
    np.testing.assert_allclose(found.attenuation, view.attenuation, atol=0.02, rtol=0.05)
    assert (np.abs(found.attenuation - view.attenuation) < 3 * found.attenuation_stddev).all()


def test_a_few_bins_of_wrong_ranges_do_not_mislead(make_view):
    view = make_view(alpha=0.2)
    image, distance = view.codes(), view.range.copy()
    # Black at 1 m, taken to be at 5 m: darker than black can be.
    wrong = np.abs(distance - 5) < 0.3
    wrong[:300] = False
    image[wrong] = view.ambient_light * (1 - np.exp(-view.attenuation)) * 255
    found = estimator().estimate_view(View.of(image), distance, range_error=0.0)
    off = np.abs(found.attenuation - view.attenuation)
    assert (off < 2.5 * found.attenuation_stddev).all()


def test_the_deviation_grows_where_nothing_is_black(make_view):
    black, grey = make_view(), make_view(darkest=0.25, seed=1)
    first = estimator().estimate_view(View.of(black.codes()), black.range, range_error=0.0)
    second = estimator().estimate_view(View.of(grey.codes()), grey.range, range_error=0.0)
    assert second.attenuation_stddev.mean() > 1.3 * first.attenuation_stddev.mean()


def test_a_bound_does_not_make_an_estimate_sure(make_view):
    """Black is blacker than clear water allows: attenuation is held at that of clear water."""
    view = make_view(alpha=0.0, nearest=0.45, farthest=0.6)
    dimmed = (view.codes() * 0.9).astype(np.uint8)
    dimmed[view.codes() == view.codes().max()] = 230
    found = estimator().estimate_view(View.of(dimmed), view.range, range_error=0.005)
    assert (found.attenuation_stddev[found.attenuation < KAPPA] > 0.03).all()


@pytest.mark.parametrize("seed", range(3))
def test_the_estimate_survives_noise_and_marine_snow(make_view, seed):
    view = make_view(alpha=0.15, seed=seed)
    rng = np.random.default_rng(seed)
    noisy = 255 * view.irradiance + rng.normal(0, 1.5, view.irradiance.shape)
    seeds = (rng.random(view.range.shape) < 0.0025).astype(np.uint8)
    flakes = cv2.dilate(seeds, np.ones((2, 2))) > 0
    noisy[flakes] += 60
    image = np.clip(noisy + 0.5, 0, 255).astype(np.uint8)
    found = WaterEstimator(WaterConfig(), KAPPA).estimate_view(
        View.of(image), view.range, range_error=0.0)
    assert found.status is Status.OK
    error = np.log(found.attenuation / view.attenuation)
    assert (np.abs(error) < 1.5 * found.attenuation_stddev / found.attenuation).all()
    assert abs(np.mean(found.attenuation - view.attenuation)) < 0.035
