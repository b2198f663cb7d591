# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Contrast normalisation: gradients that attenuation reduced are restored."""

import numpy as np
import pytest

from uw_visibility.compute.threads import Workers
from uw_visibility.optics.lamps import RANGES
from uw_visibility.stereo.contrast import ContrastNormalizer, least_noise_weights

ATTENUATION = np.array([0.5, 0.3, 0.2])
AMBIENT = np.array([0.3, 0.7, 0.8])
SHAPE = (80, 120)
# Texture of single pixels, as here, would otherwise be measured as noise.
NO_NOISE = np.zeros(3)


def stretched(image):
    contrast = ContrastNormalizer(image.shape[:2])
    contrast.stretch(image, Workers(2), NO_NOISE)
    return contrast


def test_a_weak_contrast_is_stretched_to_eight_bits():
    rng = np.random.default_rng(0)
    image = rng.integers(100, 140, (*SHAPE, 3)).astype(np.uint8)
    image[:] = image[..., :1]
    contrast = stretched(image)
    span = np.percentile(contrast.grey, 99.5) - np.percentile(contrast.grey, 0.5)
    assert contrast.gain.max() * span == pytest.approx(255, rel=0.01)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_what_an_image_does_not_show_leaves_the_rest_its_gain(dtype):
    """As the border of a rectified image, or a dead part of one camera's sensor."""
    unit = 1 if dtype == np.uint8 else 257
    image = np.random.default_rng(0).integers(100, 140, (*SHAPE, 3)).astype(dtype) * dtype(unit)
    whole = stretched(image).gain.max()
    image[:, :40] = 0
    assert stretched(image).gain.max() == pytest.approx(whole, rel=0.05)
    assert stretched(np.zeros_like(image)).gain.max() * 256 <= 16


def test_the_gain_of_an_image_without_contrast_stays_limited():
    contrast = stretched(np.full((*SHAPE, 3), 128, np.uint8))
    assert contrast.gain.max() * 256 <= 16


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_and_colour_of_any_depth_agree(dtype):
    rng = np.random.default_rng(1)
    grey = rng.integers(0, 255, SHAPE).astype(np.uint8)
    scaled = grey.astype(dtype) * (1 if dtype == np.uint8 else 256)
    mono = stretched(scaled)
    colour = stretched(np.repeat(scaled[..., None], 3, 2))
    np.testing.assert_allclose(mono.grey, grey.astype(int) * 256, atol=1)
    np.testing.assert_allclose(colour.grey, mono.grey, atol=1)


def test_one_pixel_that_is_kilometres_away_leaves_the_others_their_gain():
    ranges = np.tile(np.linspace(1.0, 6.0, SHAPE[1], dtype=np.float32), (SHAPE[0], 1))
    image = np.full((*SHAPE, 3), 128, np.uint8)
    gains = []
    for farthest in (6.0, 1e5):
        ranges[0, 0] = farthest
        contrast = ContrastNormalizer(SHAPE)
        contrast.restore(image, ranges, ATTENUATION, AMBIENT, Workers(1), NO_NOISE)
        gains.append(contrast.gain[1:])
    np.testing.assert_allclose(gains[1], gains[0], rtol=0.06)


def test_contrast_of_near_and_far_becomes_even():
    """The same stripes at two ranges have the same contrast once restored."""
    stripes = np.where(np.arange(SHAPE[1]) // 4 % 2, 0.8, 0.2)
    ranges = np.full(SHAPE, 1.0, np.float32)
    ranges[40:] = 5.0
    transmission = np.exp(-ATTENUATION * ranges[..., None])
    light = AMBIENT * (stripes[:, None] * transmission + 1 - transmission)
    image = np.round(light * 65535).astype(np.uint16)
    contrast = ContrastNormalizer(SHAPE)
    contrast.restore(image, ranges, ATTENUATION, AMBIENT, Workers(1), NO_NOISE)
    levels = contrast.grey * contrast.gain
    near, far = np.ptp(levels[20]), np.ptp(levels[60])
    assert near == pytest.approx(0.6 * 1.5 * 255, rel=0.02)
    assert far == pytest.approx(near, rel=0.02)


def test_channels_that_are_not_known_are_left_out():
    rng = np.random.default_rng(2)
    image = rng.integers(0, 255, (*SHAPE, 3)).astype(np.uint8)
    attenuation = np.array([np.nan, 0.3, np.nan])
    contrast = ContrastNormalizer(SHAPE)
    ranges = np.full(SHAPE, 2, np.float32)
    contrast.restore(image, ranges, attenuation, AMBIENT, Workers(1), NO_NOISE)
    np.testing.assert_allclose(contrast.grey, image[..., 1].astype(int) * 256, atol=1)


def test_unknown_range_takes_the_gain_of_the_farthest():
    image = np.random.default_rng(3).integers(0, 255, (*SHAPE, 3)).astype(np.uint8)
    ranges = np.full(SHAPE, 2, np.float32)
    ranges[:10] = 4
    ranges[10:20] = np.nan
    ranges[20:30] = np.inf
    # Overflows, and is no part of the sample from which the table is made.
    ranges[9, 9] = 3e38
    contrast = ContrastNormalizer(SHAPE)
    contrast.restore(image, ranges, ATTENUATION, AMBIENT, Workers(1), NO_NOISE)
    np.testing.assert_array_equal(contrast.gain[:30], contrast.gain[0, 0])
    assert contrast.gain[40, 0] < contrast.gain[0, 0]


def test_lamp_lit_contrast_of_the_far_is_raised_and_that_of_the_near_kept():
    """Light of lamps falls faster with range than daylight; gains follow the known light."""
    rng = np.random.default_rng(2)
    ranges = np.full(SHAPE, 2.0, np.float32)
    ranges[40:] = 6.0
    direct = np.exp(-0.3 * RANGES) / RANGES**2 * np.array([[0.2], [0.8], [1.0]])
    light = np.where(ranges < 4, 1.0, (2 / 6) ** 2 * np.exp(-0.3 * 4))[..., None]
    image = (rng.random((*SHAPE, 3)) * 0.8 * light * 255 * 256).astype(np.uint16)
    contrast = ContrastNormalizer(SHAPE)
    contrast.restore_lit(image, ranges, direct, Workers(1), NO_NOISE)
    near, far = contrast.gain[20, 0], contrast.gain[60, 0]
    assert near == pytest.approx(stretched(image[:40]).gain.max(), rel=0.2)
    # Twice the raw contrast's half way, at the median range.
    raised = 2.0 * np.interp(4.0, RANGES, direct[2]) / np.interp(6.0, RANGES, direct[2])
    assert far / near == pytest.approx(raised, rel=0.2)


def test_of_what_is_kilometres_away_the_clearest_channel_counts():
    ranges = np.full((8, 8), 5000.0, np.float32)
    weights = least_noise_weights(ranges, np.array([0.6, 0.2, np.nan]), np.array([0.5, 0.4, 0.6]))
    np.testing.assert_array_equal(weights, [0.0, 1.0, 0.0])
