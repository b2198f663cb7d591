# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""What cameras do beside their noise, each against its closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from uw_visibility.errors import InputError
from uw_visibility.optics.transfer import from_linear
from uw_visibility_lab.simulation.camera import NOISELESS, CameraEffects, Sensor

RANDOM = np.random.default_rng(3)
LIGHT = RANDOM.uniform(0.1, 0.6, (40, 60, 3)).astype(np.float32)
SMOOTH = np.linspace(0.1, 0.6, 40 * 60 * 3).reshape(3, 40, 60).transpose(1, 2, 0).astype(np.float32)


def record(effects: CameraEffects, light=LIGHT, sensor=NOISELESS) -> np.ndarray:
    random = np.random.default_rng(0)
    return effects.record(light, sensor, random, effects.gains(light))


def codes(light: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(255.0 * light), 0, 255)


def test_the_default_is_the_sensor_alone() -> None:
    sensor = Sensor()
    np.testing.assert_array_equal(
        record(CameraEffects(), sensor=sensor),
        np.clip(np.rint(sensor.read(LIGHT, np.random.default_rng(0))), 0, 255))


def test_srgb() -> None:
    found = record(CameraEffects(transfer="srgb"))
    np.testing.assert_allclose(found, from_linear(LIGHT, "srgb", np.uint8), atol=1)


def test_white_balance_multiplies_and_saturates() -> None:
    found = record(CameraEffects(white_balance=(1.5, 1.0, 3.0)))
    np.testing.assert_allclose(found, codes(LIGHT * np.float32([1.5, 1.0, 3.0])), atol=1)
    assert (found[..., 2] == 255).any()


def test_automatic_white_balance_makes_the_means_equal_and_follows_the_frame() -> None:
    effects = CameraEffects(automatic_white_balance=True)
    blue = LIGHT * np.float32([0.4, 0.8, 1.0])
    means = record(effects, blue).mean(axis=(0, 1))
    np.testing.assert_allclose(means, means[1], rtol=0.01)
    assert effects.gains(blue)[0] > effects.gains(LIGHT)[0]
    # Where red is gone, its gain is limited.
    assert effects.gains(LIGHT * np.float32([0.01, 1.0, 1.0]))[0] == 4.0


def test_vignetting_falls_with_the_square_of_the_radius() -> None:
    found = record(CameraEffects(vignetting=0.4), np.full((41, 61, 3), 0.5, np.float32))
    assert (found[20, 30] == codes(0.5)).all()
    assert (found[0, 0] == codes(0.5 * 0.6)).all()
    # Halfway to the corner a quarter of it is lost.
    assert (found[10, 15] == codes(0.5 * 0.9)).all()


def test_the_mosaic_keeps_one_colour_of_each_pixel() -> None:
    found = record(CameraEffects(bayer=True))
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        kept = (slice(2 + row, -2, 2), slice(2 + column, -2, 2), channel)
        np.testing.assert_allclose(found[kept], codes(LIGHT)[kept], atol=1)
        lost = (*kept[:2], (channel + 1) % 3)
        assert np.abs(found[lost] - codes(LIGHT)[lost]).mean() > 5.0
    # What is smooth is interpolated well.
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(
        record(CameraEffects(bayer=True), SMOOTH)[inner], codes(SMOOTH)[inner], atol=2)


def test_jpeg_loses_more_at_less_quality() -> None:
    grey = LIGHT[..., :1].repeat(3, axis=2)
    errors = [
        np.abs(record(CameraEffects(jpeg=quality), grey) - codes(grey)).mean()
        for quality in (95, 40)
    ]
    assert 0.0 < 2.0 * errors[0] < errors[1]


def test_gaussian_noise_is_as_wide_as_told_at_any_light() -> None:
    sensor = Sensor.gaussian(3.0)
    for level in (0.2, 0.8):
        light = np.full((100, 100, 3), level, np.float32)
        noise = record(CameraEffects(), light, sensor).astype(float)
        assert noise.std() == pytest.approx(3.0, rel=0.03)
        assert noise.mean() == pytest.approx(255 * level, abs=0.2)


@pytest.mark.parametrize("changed", [
    {"transfer": "rec709"}, {"white_balance": (0.0, 1.0, 1.0)}, {"vignetting": 1.0},
    {"jpeg": 101},
])
def test_what_no_camera_does_is_refused(changed: dict) -> None:
    with pytest.raises(InputError):
        replace(CameraEffects(), **changed)
