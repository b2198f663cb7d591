# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What real cameras do to light, and what disturbs it, from rendered frames to the estimate."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import ReefView

from uw_visibility import FrameResult, Pipeline, PipelineConfig
from uw_visibility.images.vignetting import illumination
from uw_visibility.optics.transfer import from_linear, to_linear
from uw_visibility.status import Status
from uw_visibility_lab.simulation.camera import Pose, Sensor, StereoCamera
from uw_visibility_lab.simulation.frame import Effects
from uw_visibility_lab.simulation.scene import reef
from uw_visibility_lab.simulation.water import Water

CAMERA = StereoCamera(320, 240, 300.0, 0.12)
RIG = CAMERA.rig
POSE = Pose((0.0, 0.0, 1.5), heading=0.05, tilt=0.28, roll=0.03)
ALPHA, DEPTH = 0.2, 4.0
WATER = Water(ALPHA, DEPTH)
# Shot and read noise of 1.5 grey levels at half of the range.
SMALL_CAMERA = Sensor(full_well=15000.0, read_noise=20.0)


@pytest.fixture(scope="module")
def scene():
    return reef(5, 4.0)


@pytest.fixture(scope="module")
def clean(scene):
    return ReefView(CAMERA, scene, POSE, WATER, SMALL_CAMERA).frame()


def process(left, right, **parameters) -> FrameResult:
    config = PipelineConfig.from_parameters({"threads": 2, **parameters})
    return Pipeline(RIG, config).process(left, right)


@pytest.fixture(scope="module")
def undisturbed(clean) -> FrameResult:
    return process(clean.left, clean.right)


def encoded(image, transfer="linear", gain=1.0):
    """The image as another camera would give it."""
    return from_linear(to_linear(image, "linear") * gain, transfer, np.uint8)


def assert_same_water(result, reference, attenuation=0.02, depth=0.3):
    assert result.status is Status.OK
    found, expected = result.visibility, reference.visibility
    assert abs(found.mean_attenuation - expected.mean_attenuation) < attenuation
    assert abs(found.depth - expected.depth) < depth


def test_the_undisturbed_frame_is_assessed_truly(undisturbed):
    assert undisturbed.status is Status.OK
    assert abs(undisturbed.visibility.mean_attenuation - ALPHA) < 0.04
    assert abs(undisturbed.visibility.depth - DEPTH) < 0.3
    np.testing.assert_allclose(undisturbed.stereo.right_gain, 1.0, atol=0.02)


def test_srgb_images_tell_the_same_water(clean, undisturbed):
    left, right = (encoded(image, "srgb") for image in (clean.left, clean.right))
    result = process(left, right, **{"camera.transfer": "srgb"})
    assert_same_water(result, undisturbed)
    light = to_linear(result.left_enhanced, "srgb") - to_linear(undisturbed.left_enhanced, "linear")
    assert np.median(np.abs(light)) < 0.02
    # Taken for linear ones they tell another water, within the deviation.
    water, reference = process(left, right).water, undisturbed.water
    error = np.log(water.attenuation / reference.attenuation)
    assert (error > 0.1).any()
    assert (np.abs(error) < 3.0 * water.attenuation_stddev / water.attenuation).all()


def test_a_white_balance_that_is_known_does_not_change_the_depth(clean, undisturbed):
    white = np.array([1.0, 0.6, 0.75])
    left, right = (encoded(image, gain=white) for image in (clean.left, clean.right))
    result = process(left, right, **{"camera.white_reference": tuple(2 * white)})
    assert_same_water(result, undisturbed)
    assert abs(process(left, right).visibility.depth - DEPTH) > 1.0


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_a_vignette_that_is_known_changes_nothing(clean, undisturbed, transfer):
    coefficients = (-0.6, 0.2, -0.05)
    field = illumination(coefficients, (240, 320), CAMERA.principal_point)[..., np.newaxis]
    left, right = (encoded(image, transfer, field) for image in (clean.left, clean.right))
    camera = {"camera.transfer": transfer}
    assert_same_water(
        process(left, right, **camera, **{"camera.vignetting": coefficients}), undisturbed)


def test_a_brighter_right_camera_gets_its_own_ambient_light(clean, undisturbed):
    gain = np.array([0.8, 0.65, 0.7])
    result = process(clean.left, encoded(clean.right, gain=gain))
    np.testing.assert_allclose(result.stereo.right_gain, gain, rtol=0.02)
    assert_same_water(result, undisturbed, 0.01, 0.15)
    matched = undisturbed.stereo.matched_fraction
    assert result.stereo.matched_fraction > matched - 0.05
    difference = result.right_enhanced.astype(float) - undisturbed.right_enhanced
    assert np.median(np.abs(difference)) < 6


def with_hand(image, centre, shade):
    """The image with a near, blurred thing before the lens."""
    mask = np.zeros(image.shape[:2], np.float32)
    cv2.ellipse(mask, (centre, 150), (60, 45), 20.0, 0, 360, 1.0, -1)
    mask = cv2.GaussianBlur(mask, (0, 0), 6.0)[..., np.newaxis]
    assert 0.08 < mask.mean() < 0.15
    return np.clip(image * (1 - mask) + 255 * mask * shade + 0.5, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("shade", [(0.0, 0.0, 0.0), (0.95, 0.8, 0.7)], ids=["dark", "bright"])
@pytest.mark.parametrize("sides", ["both", "left"])
def test_a_hand_near_the_lens_does_not_pass_for_water(clean, undisturbed, shade, sides):
    left = with_hand(clean.left, 190, np.array(shade))
    # At 0.3 m the disparity is beyond the search.
    right = with_hand(clean.right, 70, np.array(shade)) if sides == "both" else clean.right
    result = process(left, right)
    if result.status is Status.OK:
        assert_same_water(result, undisturbed, 0.045, 0.4)


@pytest.mark.parametrize(("effects", "frames", "tolerance"), [
    pytest.param(Effects(caustics=0.2), 4, 0.04, marks=pytest.mark.long),
    pytest.param(Effects(marine_snow=0.01), 8, 0.035, marks=pytest.mark.long),
    (Effects(marine_snow=0.01, caustics=0.2), 4, 0.06),
], ids=["caustics", "snow", "both"])
def test_noise_caustics_and_snow_do_not_pass_for_water(scene, effects, frames, tolerance):
    errors, depths = [], []
    view = ReefView(CAMERA, scene, POSE, WATER, SMALL_CAMERA, effects)
    for seed in range(frames):
        frame = view.frame(seed, 0.7 * seed)
        result = process(frame.left, frame.right)
        assert result.status is Status.OK
        errors.append(result.visibility.mean_attenuation - ALPHA)
        depths.append(result.visibility.depth - DEPTH)
    assert np.abs(errors).mean() < tolerance
    assert np.abs(depths).mean() < 0.4
