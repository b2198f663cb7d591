# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Where a camera looks, and what its sensor adds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility_lab.simulation.camera import NOISELESS, CameraEffects, Pose, Sensor, StereoCamera


def test_optical_axes_of_a_level_camera() -> None:
    # Ahead is x, the image's right is the world's -y, its lower edge is down.
    axes = Pose((0.0, 0.0, 0.0)).rotation()
    np.testing.assert_allclose(axes, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)


def test_tilt_looks_down_heading_to_the_left_and_roll_lowers_the_right() -> None:
    assert Pose((0, 0, 0), tilt=0.3).rotation()[2, 2] == pytest.approx(-math.sin(0.3))
    assert Pose((0, 0, 0), heading=0.3).rotation()[1, 2] == pytest.approx(math.sin(0.3))
    assert Pose((0, 0, 0), roll=0.3).rotation()[2, 0] == pytest.approx(-math.sin(0.3))
    rotation = Pose((0, 0, 0), 0.4, 0.3, 0.2).rotation()
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_noise_is_shot_and_read_noise() -> None:
    sensor = Sensor(full_well=10000.0, read_noise=30.0)
    for level in (0.1, 0.6):
        flat = np.full((300, 300, 3), level, np.float32)
        grey = np.rint(sensor.read(flat, np.random.default_rng(1)))
        expected = 255.0 * math.sqrt(level / 10000.0 + (30.0 / 10000.0) ** 2)
        assert grey.mean() == pytest.approx(255.0 * level, abs=0.05)
        # Rounding adds a variance of 1/12.
        assert grey.std() == pytest.approx(math.hypot(expected, math.sqrt(1 / 12)), rel=0.02)


def test_without_noise_there_is_rounding_and_saturation() -> None:
    light = np.array([[[0.0, 100.4 / 255, 1.7]]], np.float32)
    effects = CameraEffects()
    exposed = effects.record(light, NOISELESS, np.random.default_rng(0), effects.gains(light))
    np.testing.assert_array_equal(exposed, [[[0, 100, 255]]])


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ({"width": 4}, "image size"),
        ({"focal_length": 0.0}, "focal length"),
        ({"baseline": -0.1}, "baseline"),
        ({"baseline": math.nan}, "baseline"),
    ],
)
def test_what_is_no_camera_is_refused(arguments: dict[str, float], what: str) -> None:
    with pytest.raises(InputError, match=what):
        StereoCamera(**arguments)
