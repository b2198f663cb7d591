# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Smoothing follows the restored noise, and improves matching."""

import cv2
import numpy as np
import pytest
from scenes import blurred, codes, stereo_pair

from uw_visibility.compute.threads import Workers
from uw_visibility.config.schema import StereoConfig
from uw_visibility.images.noise import noise_stddev
from uw_visibility.stereo.contrast import ContrastNormalizer
from uw_visibility.stereo.denoising import LARGEST, LEAST_NOISE, smooth
from uw_visibility.stereo.elas import Matcher
from uw_visibility.stereo.elas.matcher import settings_in_noise

SHAPE = (96, 160)


def noise_image(seed: int = 0, stddev: float = 600.0) -> np.ndarray:
    random = np.random.default_rng(seed)
    return (30000 + random.normal(0, stddev, SHAPE)).astype(np.uint16)


def gain_of(restored: float, stddev: float = 600.0) -> np.ndarray:
    """The gain that turns noise of a standard deviation into the restored noise."""
    return np.full(SHAPE, restored / stddev, np.float32)


def test_without_noise_nothing_is_changed() -> None:
    grey = noise_image()
    smoothed = grey.copy()
    restored = smooth(smoothed, gain_of(0.99 * LEAST_NOISE), 600.0, Workers(1))
    assert restored == pytest.approx(0.99 * LEAST_NOISE, rel=1e-5)
    np.testing.assert_array_equal(smoothed, grey)


@pytest.mark.parametrize("restored", [2.0, 8.0, 30.0])
def test_an_even_gain_smooths_by_one_gaussian(restored: float) -> None:
    """The scale is 0.25 px times the power 0.7 of the noise."""
    grey = noise_image()
    expected = cv2.GaussianBlur(grey, (0, 0), min(0.25 * restored**0.7, LARGEST))
    smooth(grey, gain_of(restored), 600.0, Workers(1))
    np.testing.assert_allclose(grey.astype(int), expected, atol=1)


@pytest.mark.parametrize("restored", [8.0, 200.0])
def test_what_memory_held_before_does_not_show(
    restored: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise beyond the largest scale is smoothed by that one alone."""

    def not_numbers(shape: tuple[int, ...], dtype: type = float) -> np.ndarray:
        return np.full(shape, np.nan, dtype)

    grey = noise_image()
    gain = gain_of(restored) * np.linspace(1.0, 1.1, SHAPE[1], dtype=np.float32)
    scale = min(0.25 * (1.05 * restored) ** 0.7, LARGEST)
    expected = cv2.GaussianBlur(grey, (0, 0), scale)
    # The kernel is compiled before.
    smooth(grey.copy(), gain, 600.0, Workers(1))
    with monkeypatch.context() as patch:
        patch.setattr(np, "empty", not_numbers)
        smooth(grey, gain, 600.0, Workers(1))
    assert abs(grey.astype(int) - expected).max() < 0.5 * np.std(noise_image())


def test_each_pixel_is_smoothed_as_its_own_noise_asks_for() -> None:
    grey = noise_image(1)
    gain = gain_of(1.5)
    gain[:, 80:] *= 10
    smoothed = grey.copy()
    smooth(smoothed, gain, 600.0, Workers(1))
    near, far = np.s_[20:-20, 20:60], np.s_[20:-20, 100:140]
    alone = grey.copy()
    smooth(alone, gain_of(15.0), 600.0, Workers(1))
    # The image is interpolated between the computed scales.
    assert np.std(smoothed[far]) == pytest.approx(np.std(alone[far]), rel=0.08)
    assert 0.5 * np.std(grey[near]) < np.std(smoothed[near]) < np.std(grey[near])
    assert np.std(smoothed[far]) < 0.4 * np.std(smoothed[near])


def correct_share(left: np.ndarray, right: np.ndarray, noise: float, disparity: int) -> float:
    """Share of pixels that are matched correctly when the matcher is given the noise."""
    config = StereoConfig(max_disparity=32)
    matcher = Matcher(SHAPE, (0, 32), config, Workers(1))
    views = []
    for image in (left, right):
        contrast = ContrastNormalizer(SHAPE)
        contrast.stretch(image, Workers(1), np.full(3, noise))
        views.append(contrast)
    for side, view in enumerate(views):
        matcher.describe_view(side, view)
    found = matcher.dense_disparity(matcher.support_points()).disparity
    return float(np.mean(np.abs(found[:, 40:] - disparity) <= 1))


def test_noisy_pairs_are_matched_better_than_as_they_are(
) -> None:
    wide = blurred(np.random.default_rng(3).random((96, 172)), 2.0) * 800 / 255
    wide = 120 / 255 + 0.5 * (wide - wide.mean())
    random = np.random.default_rng(4)
    left, right = (
        codes(np.repeat(part[..., None], 3, 2) + random.normal(0, 20 / 255, (*SHAPE, 3)))
        for part in stereo_pair(wide, 12)
    )
    as_they_are = correct_share(left, right, 0.0, 12)
    smoothed = correct_share(left, right, 20.0, 12)
    assert smoothed > as_they_are + 0.06


def test_noise_alone_is_not_matched() -> None:
    random = np.random.default_rng(5)
    left, right = (
        np.clip(100 + random.normal(0, 3, (*SHAPE, 3)) + 0.5, 0, 255).astype(np.uint8)
        for _ in range(2)
    )
    matcher = Matcher(SHAPE, (0, 32), StereoConfig(max_disparity=32), Workers(1))
    views = []
    for image in (left, right):
        contrast = ContrastNormalizer(SHAPE)
        contrast.stretch(image, Workers(1), noise_stddev(image))
        views.append(contrast)
    for side, view in enumerate(views):
        matcher.describe_view(side, view)
    found = matcher.dense_disparity(matcher.support_points()).disparity
    assert np.isfinite(found).mean() < 0.05


def test_settings_are_the_configured_ones_without_noise_and_wider_in_it() -> None:
    config = StereoConfig()
    assert settings_in_noise(config, LEAST_NOISE) is config
    noisy = settings_in_noise(config, 5.0)
    assert noisy.smoothing_radius > config.smoothing_radius
    assert noisy.left_right_tolerance < config.left_right_tolerance
    assert noisy.gap_width > config.gap_width
    assert noisy.segment_difference < config.segment_difference
    off = settings_in_noise(StereoConfig(smoothing_radius=0, gap_width=0), 5.0)
    assert off.smoothing_radius == off.gap_width == 0
