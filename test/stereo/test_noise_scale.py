# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""A noisy image is matched at the finest scale that shows most of the coarsest one's scene."""

import numpy as np
import pytest
from scenes import blurred

from uw_visibility.stereo.noise_scale import matching_scale, shown

SHAPE = (480, 640)
SCALES = (1, 2, 4)
EVEN = (1 / 3, 1 / 3, 1 / 3)
NOISE = np.full(3, 2.0)


def picture(contrast: float, size: float, dtype: type = np.uint8, noise: float = 2.0) -> np.ndarray:
    """Texture of a standard deviation in codes and of a size in px, in noise of a few codes."""
    generator = np.random.default_rng(7)
    fine = blurred(generator.normal(size=SHAPE), size)
    image = 100.0 + contrast * fine[..., np.newaxis] / fine.std()
    image = image + generator.normal(0.0, noise, (*SHAPE, 3))
    return np.round(image * (1 if dtype is np.uint8 else 257)).astype(dtype)


def test_strong_texture_is_matched_as_it_is() -> None:
    assert matching_scale(picture(8.0, 1.5), NOISE, EVEN, SCALES) == 1


def test_the_fainter_the_coarser() -> None:
    scales = [matching_scale(picture(c, 6.0), NOISE, EVEN, SCALES) for c in (20.0, 3.0, 0.6)]
    assert scales == [1, 2, 4]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_eight_and_sixteen_bits_choose_alike(dtype: type) -> None:
    code = 1 if dtype is np.uint8 else 257
    assert matching_scale(picture(3.0, 6.0, dtype), code * NOISE, EVEN, SCALES) == 2


@pytest.mark.parametrize("noise", [np.zeros(3), np.full(3, 0.3)])
def test_without_noise_it_is_the_finest(noise: np.ndarray) -> None:
    assert matching_scale(picture(1.2, 6.0, noise=0.0), noise, EVEN, SCALES) == 1
    assert matching_scale(picture(1.2, 6.0), noise, EVEN, (2, 4)) == 2


@pytest.mark.parametrize("noise", [1.0, 2.0, 4.0])
def test_open_water_asks_for_no_other_scale(noise: float) -> None:
    """Neither open water alone, nor around a reef with a veil that is brighter above."""
    generator = np.random.default_rng(3)
    veil = np.linspace(130.0, 100.0, SHAPE[0])[:, np.newaxis, np.newaxis]
    image = veil + generator.normal(0.0, noise, (*SHAPE, 3))
    deviation = np.full(3, 0.9 * noise)
    alone = np.round(image).astype(np.uint8)
    assert matching_scale(alone, deviation, EVEN, SCALES) == 1
    reef = np.s_[320:, 200:]
    image[reef] += 12.0 * noise * blurred(generator.normal(size=SHAPE), 1.5)[reef][..., np.newaxis]
    beside = np.round(image).astype(np.uint8)
    assert matching_scale(beside, deviation, EVEN, SCALES) == 1


def test_a_channel_without_weight_adds_no_noise() -> None:
    image = picture(8.0, 1.5)
    red = np.random.default_rng(0).normal(100.0, 30.0, SHAPE).clip(0, 255)
    image[..., 0] = red.astype(np.uint8)
    noise = np.array([30.0, 2.0, 2.0])
    assert matching_scale(image, noise, (0.0, 0.5, 0.5), SCALES) == 1
    assert matching_scale(image, noise, EVEN, SCALES) > 1


def test_grey_images_need_no_weights() -> None:
    assert matching_scale(picture(3.0, 6.0)[..., 0], NOISE[:1], EVEN, SCALES) in (2, 4)


def test_what_shows_more_than_noise_is_told_by_place() -> None:
    image = picture(3.0, 6.0)
    image[:, :320] = picture(0.0, 6.0)[:, :320]
    mask = shown(image, NOISE, EVEN, 4)
    assert mask.shape == SHAPE
    assert mask[:, 336:].mean() > 0.9
    assert mask[:, :304].mean() < 0.1
