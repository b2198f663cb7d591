# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""The airlight's bound of range, against the light model it follows from."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import in_water, patches

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import PipelineConfig
from uw_visibility.optics.spectra import clear_water_attenuation, load_response
from uw_visibility.pipeline.pipeline import Pipeline
from uw_visibility.status import Status
from uw_visibility.stereo.airlight import Airlight
from uw_visibility.stereo.rig import StereoRig
from uw_visibility.water.estimate import WaterEstimate
from uw_visibility_lab.evaluation.degrade import load_scene
from uw_visibility_lab.evaluation.metrics import correct_fraction

SHAPE = (80, 120)
RIG = StereoRig(600.0, 0.1, (59.5, 39.5))
ATTENUATION = np.array([0.45, 0.3, 0.25])
AMBIENT = np.array([0.5, 0.7, 0.8])
NO_POINTS = np.empty((0, 3), np.float32)


def water(attenuation=ATTENUATION, ambient=AMBIENT, deviation=0.0):
    covariance = np.tile(np.diag([deviation**2, 0.0]), (3, 1, 1))
    return WaterEstimate(
        Status.OK, np.array(attenuation), np.array(ambient), covariance, 1, 1, (Status.OK,) * 3
    )


def seen(radiance, disparity, transfer="linear", dtype=np.uint8):
    ranges = RIG.range_from_disparity(disparity)
    return in_water(radiance, ranges, ATTENUATION, AMBIENT, dtype=dtype, transfer=transfer)


def scene(darkest=0.0, seed=0):
    rng = np.random.default_rng(seed)
    disparity = np.tile(np.linspace(12, 40, SHAPE[1]), (SHAPE[0], 1)).astype(np.float32)
    # Patches, since an image of noise alone is taken for a noisy one.
    return patches(rng.uniform(darkest, 1.0, (8, 12, 3)), 10), disparity


def airlight(transfer="linear", threads=1):
    return Airlight(SHAPE, RIG, 64, transfer, Workers(threads))


def allowed(prior, disparity):
    """Whether the true disparity lies within the bound, at each pixel."""
    at = np.floor(disparity).astype(int) + 1
    return prior.thickness[at] <= prior.farthest


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_no_true_disparity_is_excluded(transfer, dtype):
    radiance, disparity = scene()
    image = seen(radiance, disparity, transfer, dtype)
    prior = airlight(transfer).prior(image, water(), NO_POINTS)
    assert allowed(prior, disparity).mean() > 0.999


def test_a_black_surface_cannot_be_much_farther_than_it_is():
    _, disparity = scene()
    image = seen(np.zeros((*SHAPE, 3)), disparity, dtype=np.uint16)
    prior = airlight().prior(image, water(), NO_POINTS)
    assert allowed(prior, disparity).all()
    assert not allowed(prior, 0.9 * disparity).any()


def test_what_is_as_bright_as_ambient_light_has_no_bound():
    _, disparity = scene()
    prior = airlight().prior(seen(np.ones((*SHAPE, 3)), disparity), water(), NO_POINTS)
    assert np.isinf(prior.farthest).all()


def test_doubt_about_the_water_moves_the_bound_out():
    _, disparity = scene()
    image = seen(np.full((*SHAPE, 3), 0.1), disparity)
    sure = airlight().prior(image, water(), NO_POINTS).farthest.copy()
    doubtful = airlight().prior(image, water(deviation=0.1), NO_POINTS).farthest
    assert np.all(doubtful > 1.1 * sure)


def test_water_that_is_hardly_known_counts_little():
    radiance, disparity = scene()
    image = seen(radiance, disparity)
    trusts = [
        airlight().prior(image, water(deviation=s), NO_POINTS).trust for s in (0.0, 0.01, 0.1)
    ]
    assert trusts[0] == 1
    assert trusts[1] > 0.95
    assert trusts[2] < 0.2


def matches(disparity):
    v, u = np.mgrid[2 : SHAPE[0] : 4, 2 : SHAPE[1] : 4]
    return np.column_stack((u.ravel(), v.ravel(), disparity[v, u].ravel())).astype(np.float32)


def test_matches_widen_a_bound_that_contradicts_them():
    """Water that is clearer than believed: without matches, true ranges are excluded."""
    radiance, disparity = scene()
    image = seen(radiance, disparity)
    wrong = water(attenuation=1.3 * ATTENUATION)
    assert not allowed(airlight().prior(image, wrong, NO_POINTS), disparity).all()
    prior = airlight().prior(image, wrong, matches(disparity))
    assert allowed(prior, disparity).mean() > 0.99


def test_water_that_the_matches_contradict_bounds_nothing():
    radiance, disparity = scene()
    wrong = water(attenuation=4 * ATTENUATION)
    assert airlight().prior(seen(radiance, disparity), wrong, matches(disparity)) is None


def test_a_channel_that_is_not_known_is_left_out():
    radiance, disparity = scene()
    image = seen(radiance, disparity)
    image[..., 0] = 0
    blind = water(attenuation=[np.nan, 0.3, 0.25])
    assert allowed(airlight().prior(image, blind, NO_POINTS), disparity).mean() > 0.999
    none = replace(blind, attenuation=np.full(3, np.nan))
    assert airlight().prior(image, none, NO_POINTS) is None


def test_threads_do_not_change_a_bit():
    radiance, disparity = scene(seed=3)
    image = seen(radiance, disparity)
    one, three = (airlight(threads=n).prior(image, water(), matches(disparity)) for n in (1, 3))
    np.testing.assert_array_equal(one.farthest, three.farthest)
    np.testing.assert_array_equal(one.thickness, three.thickness)


@pytest.mark.parametrize("name", ["art", "dolls", "moebius"])
def test_more_is_right_with_it_than_without(shared_data, name):
    """On views that are exchanged and mirrored, in water that none of its numbers were seen in."""
    scene = load_scene(shared_data / "middlebury" / name)
    mirrored = replace(
        scene, left=scene.right[:, ::-1].copy(), right=scene.left[:, ::-1].copy(),
        disparity_left=scene.disparity_right[:, ::-1].copy(),
        disparity_right=scene.disparity_left[:, ::-1].copy(),
    )
    kappa = clear_water_attenuation(load_response("nikon_d5100"))
    rig = scene.rig
    right = dict.fromkeys((0.0, 50.0), 0.0)
    for strength in right:
        pipeline = Pipeline(rig, PipelineConfig.from_parameters(
            {"stereo.max_disparity": 79, "stereo.airlight_prior": strength, "threads": 1}))
        for attenuation in (0.15, 0.25):
            disparity = pipeline.process(*mirrored.degraded(attenuation, 3.0, kappa)).disparity
            right[strength] += correct_fraction(disparity, mirrored.disparity_left) / 2
    # Of one scene it may be a matter of a pixel in a thousand.
    assert right[50.0] > right[0.0] - {"art": 0.001}.get(name, 0.0)
